# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Identification (from a recording to a parameter file) and validation (accuracy of a model), in one call each.

The commands ``hysteresis identify`` and ``hysteresis validate`` call :func:`identify` and :func:`validate`. With
``--model auto``, all models whose hysteresis is a separate, invertible block are compared on held-out thirds of the
recording.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypedDict, Unpack

import numpy as np
import scipy

from hysteresis_ros.configuration import Configuration, Parameters, parse_configuration, save_parameter_file
from hysteresis_ros.errors import HysteresisError, IdentificationError, shortened
from hysteresis_ros.executors import one_thread
from hysteresis_ros.identification import registry
from hysteresis_ros.identification.data import IdentificationData, clipped_samples
from hysteresis_ros.identification.dynamics import modes_at_bounds, with_fast_dynamics
from hysteresis_ros.identification.parameter_file import (
    file_text,
    identification_section,
    load_chain,
    model_warnings,
)
from hysteresis_ros.identification.plant_model import Identification, PlantModel
from hysteresis_ros.identification.prediction import (
    InverseValidation,
    at_rate,
    input_repeated,
    judge,
    predict,
    predict_after,
)
from hysteresis_ros.identification.preprocessing import automatic_skip, wiped_out
from hysteresis_ros.identification.reading import Columns, Reading, read_data
from hysteresis_ros.identification.recording_summary import (
    LEVELS,
    RecordingSummary,
    refuse,
    refuse_falling,
    trial_error,
    white_noise,
)
from hysteresis_ros.identification.response_check import ResponseCheck, check_response, sound_data
from hysteresis_ros.identification.safe_motion import largest_change
from hysteresis_ros.identification.sensor_zero import zero_warnings
from hysteresis_ros.identification.separation import (
    NOT_REPEATED,
    REPEATED,
    Start,
    begins_at_zero,
    requested,
    start_of_prediction,
    without_memory,
)
from hysteresis_ros.identification.thresholds import FREER_MODEL, NO_PRIOR, NOTABLE_AMBIGUITY
from hysteresis_ros.identification.validation import Validation
from hysteresis_ros.models.hysteresis import MODELS
from hysteresis_ros.units import figure_name, readable, shown_in

#: Held-out fraction of the recording: first at its end, then at its beginning.
HELD_OUT_PART = 1.0 / 3.0
#: Smallest number of samples in a comparison.
FEWEST_COMPARED = 50
#: Model that is preferred if the recording does not determine smaller loops, unless another model is much better.
PRIOR_MODEL = "prandtl_ishlinskii"
#: Models with more freedom than the others.
FREER_MODELS = ("generalised_play",)
#: A model whose error on the first held-out part exceeds this multiple of the smallest error is not fitted again,
#: except :data:`PRIOR_MODEL`.
BEHIND = 1.5


def choose_model(data: IdentificationData, linear: str | None, progress=None, **conditions):
    """Return the name of the model that predicts held-out data best, and the RMS errors of all models.

    Each model is fitted to the first two thirds and predicts the samples of the last third whose voltage is within the
    range of the fit; a constant offset is removed. Models whose error is at most 1.5 times the smallest error are then
    also fitted to the last two thirds, and predict the first third. For the other models the error on the last third is
    returned. Models that cannot be fitted are skipped. A model with more freedom must be better by three per cent. If
    the recording does not determine loops smaller than its own
    (:class:`~hysteresis_ros.identification.prandtl_ishlinskii.Ambiguity`), held-out data cannot distinguish the models.
    Then :data:`PRIOR_MODEL` is chosen, unless another model has at most half of its error.
    """
    refuse_falling(data)
    # the separation for a static model uses the fits of the models before it in this list
    ahead = sorted(MODELS, key=lambda name: (name != PRIOR_MODEL, name not in FREER_MODELS, name != "preisach"))
    ahead = [name for name in ahead if MODELS[name].block.invertible]
    squares: dict[str, list[np.ndarray]] = {}
    ambiguities: dict[str, float] = {}
    reasons: list[str] = []
    edge, known = round(HELD_OUT_PART * len(data)), wiped_out(data.input) or 0
    for number, (first, last, rest) in enumerate(
        [(0, len(data) - edge, slice(len(data) - edge, None)), (edge, len(data), slice(known, edge))]
    ):
        shared: dict = {}
        for name in list(ahead):
            if progress is not None:
                progress(number, f"{name} on held-out block {number + 1} of 2")
            try:
                error, ambiguity = held_out_squares(
                    data, name, slice(first, last), rest, separations=shared, linear=linear, **conditions
                )
            except HysteresisError as problem:
                reasons.append(f"{name}: {' '.join(str(problem).split())}")
                ahead.remove(name)
                squares.pop(name, None)
                continue
            ambiguities[name] = max(ambiguities.get(name, 0.0), ambiguity)
            if error.size >= FEWEST_COMPARED:
                squares.setdefault(name, []).append(error)
        found = {name: float(np.sqrt(np.mean(np.concatenate(parts)))) for name, parts in squares.items()}
        if number == 0:
            least = min(found.values(), default=math.inf)
            ahead = [name for name in ahead if name == PRIOR_MODEL or not found.get(name, 0.0) > BEHIND * least]
    ahead = [name for name in ahead if name in found]
    if not ahead:
        reasons.append("too few samples remain for a comparison of models")
        raise IdentificationError(
            f"model {registry.AUTO}: no model can be fitted to two thirds of this data; {reasons[0]}"
        )
    best = min(ahead, key=lambda name: found[name] / (FREER_MODEL.bound(1.0) if name in FREER_MODELS else 1.0))
    unsettled = ambiguities.get(PRIOR_MODEL, 0.0) > NOTABLE_AMBIGUITY * data.stroke
    if unsettled and best != PRIOR_MODEL and found[best] > NO_PRIOR.bound(found[PRIOR_MODEL]):
        best = PRIOR_MODEL
    return best, found


def held_out_squares(data: IdentificationData, model: str, fitted: slice, rest: slice, **request):
    """Return the squared errors [m²] of a model on held-out samples within the range of the fit, and its ambiguity [m].

    ``fitted`` and ``rest`` select the fitted and the held-out samples.
    """
    fit = registry.identify(data.part(fitted.start, fitted.stop), model, **request)
    predicted = predict(fit.chain, data.input, data.sample_time, measured=data.output)
    voltage = data.input[fitted]
    inside = (data.input[rest] >= voltage.min()) & (data.input[rest] <= voltage.max())
    error = (data.output - predicted)[rest][inside]
    error -= error.mean() if error.size else 0.0
    return error**2, fit.numbers.get("ambiguity_rms_m", 0.0)


#: Treatments of the constant offset of a sensor.
OFFSETS = ("kept", "free")
#: RMS error [% of the stroke] above which a warning recommends another model.
LEFT = 2.0
#: A warning states the RMS error in the omitted beginning if it exceeds this multiple of the predicted error.
BEGINNING = 2.0
NOT_CONVERGED = "the fit did not converge: this is the best point it found"
CONSTANT_REMOVED = "a constant was removed from the output, because the zero of the sensor is not known"


class Conditions(TypedDict, total=False):
    """Conditions for the comparison of a model with a recording."""

    #: Number of samples at the beginning that do not count in the error; the model still simulates them. By default,
    #: :func:`identify` and :func:`validate` omit the samples until the voltage has been near both ends of its range,
    #: unless ``initial`` defines the voltage history.
    skip: int | None
    offset: str  #: ``kept``, or ``free``: one constant is removed, for a sensor without absolute zero.
    #: Assumed input between the samples: ``zoh`` (held, as by the nodes), ``linear`` or ``bandlimited``. Default:
    #: ``zoh`` for an identification; for a validation, the assumption of the identification.
    intersample: str | None
    #: Initial state: ``zero`` (at rest at 0 V), ``periodic`` (the input was periodic before) or ``estimate``. The
    #: default depends on the model.
    initial: str | None


@dataclass(frozen=True, eq=False)
class Fast:
    """A recording of small and fast movements that starts from rest at 0 V."""

    data: IdentificationData  #: Recording at the sample rate of the axis.
    skip: int  #: Number of samples omitted at the beginning, for example the ramp to the operating point.


@dataclass(frozen=True, eq=False)
class Compared:
    """A model compared with a recording.

    Parameters
    ----------
    data : IdentificationData
        The measurement.
    plant : PlantModel
        The model: hysteresis, creep, dynamics, and the inverse for a compensator.
    predicted : ndarray, shape (N,)
        Displacement of the model [m].
    validation : Validation
        Errors, and tests of the residual.
    inverse : InverseValidation or None
        Voltage that the inverse computes from the displacement; None without an inverse.
    figures : dict
        Figures by names with units: ``rmse_m``, ``rmse_percent_of_stroke``, ``fit_percent``, ``inverse_rmse_v`` and
        more; values that are not finite are None. ``--json`` prints them.
    warnings : tuple of str
        Sentences about uncertainties.
    recording : RecordingSummary, optional
        What the recording showed before the fit, as lines to print.
    """

    data: IdentificationData
    plant: PlantModel
    predicted: np.ndarray
    validation: Validation
    inverse: InverseValidation | None
    figures: dict
    warnings: tuple[str, ...]
    #: What the recording showed before the fit: units, direction, saturation, drift, repetition, content.
    recording: RecordingSummary | None = field(default=None, kw_only=True)

    def predict(
        self,
        voltage,
        sample_time: float | None = None,
        *,
        intersample: str | None = None,
        initial: str | None = None,
        measured=None,
    ) -> np.ndarray:
        """Predict the displacement under another voltage.

        Parameters
        ----------
        voltage : array_like, shape (N,)
            [V]
        sample_time : float, optional
            [s]; by default the sample time of the recording from which the model was identified.
        intersample : str, optional
            The input between its samples: ``zoh``, ``linear`` or ``bandlimited``; by default as in the identification.
        initial : str, optional
            The state at the start: ``zero``, ``periodic`` or ``estimate``; the default depends on the model.
        measured : array_like, shape (N,), optional
            Displacement [m] from which ``initial = "estimate"`` estimates the voltage history before the first sample.

        Returns
        -------
        ndarray, shape (N,)
            Displacement [m], with the zero of the sensor.

        Raises
        ------
        IdentificationError
            The dynamics are not known at this sample time, or a condition does not suit the model.
        """
        step = self.plant.sample_time if sample_time is None else sample_time
        return predict(self.plant, voltage, step, intersample, initial, measured)

    def score(self, data, *, inverse: bool = True, **conditions: Unpack[Conditions]) -> Compared:
        """Compare the model with another recording.

        Parameters
        ----------
        data : path-like, Recording, Reading or IdentificationData
            A recording that was not used for the identification.
        inverse : bool
            Whether to validate the inverse too.
        **conditions
            See :class:`Conditions`.

        Returns
        -------
        Compared
            Prediction, errors, figures and warnings.

        Raises
        ------
        IdentificationError, DataError
            The recording cannot be read or compared.
        """
        return validate(self, data, inverse=inverse, **conditions)


@dataclass(frozen=True, eq=False)
class Identified(Compared):
    """Result of :func:`identify`: a :class:`Compared` with the parameter file and details of the fit.

    Parameters
    ----------
    data : IdentificationData
        The measurement.
    plant : PlantModel
        The model: hysteresis, creep, dynamics, and the inverse for a compensator.
    predicted : ndarray, shape (N,)
        Displacement of the model [m].
    validation : Validation
        Errors, and tests of the residual.
    inverse : InverseValidation or None
        Voltage that the inverse computes from the displacement; None without an inverse.
    figures : dict
        Figures by names with units, as in :class:`Compared`.
    warnings : tuple of str
        Sentences about uncertainties.
    recording : RecordingSummary, optional
        What the recording showed before the fit, as lines to print.
    identification : Identification
        The result with deviations, assumptions and, for iterative searches, the parameters after each iteration.
    text : str
        The parameter file: a complete axis, as plant, compensator and controller load it.
    response : ResponseCheck, optional
        Uncertainty of the frequency response; None for a model with dynamics inside its hysteresis.
    """

    identification: Identification
    text: str
    response: ResponseCheck | None = None

    @property
    def parameters(self) -> Parameters:
        """Parameters of the hysteresis."""
        return self.plant.hysteresis.chosen

    @property
    def converged(self) -> bool:
        """Whether the fit converged; if not, the result is the best point found."""
        return self.identification.converged

    @property
    def reason(self) -> str:
        """Reason why the result is not reliable; empty if the fit converged."""
        return "" if self.converged else NOT_CONVERGED

    def to_axis(self) -> Configuration:
        """Return the parameters of an axis with this model, as in the parameter file.

        Returns
        -------
        Configuration
            Plant, compensator, controller, reference, and the section about the origin of the numbers.
        """
        return parse_configuration(self.text, "the identified model")

    def save(self, path) -> None:
        """Write the parameter file completely or not at all.

        Parameters
        ----------
        path : path-like
            A ``.yaml`` or ``.yml`` file; an existing file is replaced.

        Raises
        ------
        IdentificationError
            The file has another suffix, or cannot be written.
        """
        save_parameter_file(path, self.text, IdentificationError)


def identify(
    source,
    model: str = registry.USUAL,
    *,
    linear: str | None = None,
    options: dict | None = None,
    inverse: str | None = None,
    fast: Fast | None = None,
    progress=None,
    **conditions: Unpack[Conditions],
) -> Identified:
    """Identify a model from a recording."""
    given = _checked(conditions)
    if not isinstance(options or {}, Mapping):
        raise IdentificationError(f"options = {shortened(options)}: must be a dictionary, such as {{'play_count': 20}}")
    chosen = registry.parse_options(model, [f"{name}={value}" for name, value in (options or {}).items()])
    reading = read_data(source)
    with shown_in(reading.data.input_unit, reading.data.output_unit), one_thread():
        return _identified(
            reading, model, given, linear=linear, chosen=chosen, inverse=inverse, fast=fast, progress=progress
        )


def _identified(reading: Reading, model, given: Conditions, *, linear, chosen, inverse, fast, progress) -> Identified:
    """Report the summary of a recording, and return its identification."""
    recording = reading.summary
    for label, text in recording.lines if progress is not None else ():
        progress(0, f"{label}: {text}")
    if model == registry.AUTO or registry.find_model(model).block.invertible:
        refuse(recording)
    data = within_saturation(reading.data, recording)
    if progress is not None:
        progress(0, f"model {model}")
    skip = _averaged(given.get("skip"), data)
    # averaged samples: the input moves between them, even if it was held between the original samples
    intersample, initial = given.get("intersample") or ("zoh" if data.factor == 1 else "linear"), given.get("initial")
    tried: dict[str, float] = {}
    if model == registry.AUTO:
        model, tried = choose_model(data, linear, progress, intersample=intersample, initial=initial)
    result = registry.identify(
        data,
        model,
        linear=linear,
        options=chosen,
        inverse=inverse,
        skip=skip,
        intersample=intersample,
        initial=initial,
        progress=progress,
    )
    others = {f"held_out_{name}_rmse_m": error for name, error in tried.items()}
    result = replace(result, numbers={**result.numbers, **others})
    if result.skipped is not None:
        skip = result.skipped
    elif skip is None:
        skip = automatic_skip(data) if result.chain.invertible else 0
    saturation = None if data is reading.data else data.input_range
    result = replace(result, chain=replace(result.chain, saturation=saturation))
    read = (*reading.report.warnings, *data.warnings[len(reading.data.warnings) :])
    found = _finished(result, reading.data, skip, given.get("offset") == "free", read, fast)
    return replace(found, recording=recording)


@dataclass(frozen=True)
class HysteresisEstimator:
    """An estimator of one model for any recording.

    Parameters
    ----------
    model : str
        Name of the model, ``usual`` or ``auto``.
    linear : str, optional
        Dynamics that may follow the hysteresis; ``auto`` by default.
    options : dict, optional
        Options of the model.
    inverse : str, optional
        Type of the compensator's inverse; by default the first type that the model offers.
    conditions : dict
        See :class:`Conditions`.
    """

    model: str = registry.USUAL
    linear: str | None = None
    options: dict | None = None
    inverse: str | None = None
    conditions: Conditions = field(default_factory=Conditions)

    def fit(self, data) -> Identified:
        """Identify the model from a recording.

        Parameters
        ----------
        data : path-like, Recording, Reading or IdentificationData
            Voltage and displacement.

        Returns
        -------
        Identified
            The model with ``predict``, ``score`` and ``to_axis``.

        Raises
        ------
        IdentificationError, DataError
            The recording cannot be read, or no model fits it.
        """
        return identify(
            data, self.model, linear=self.linear, options=self.options, inverse=self.inverse, **self.conditions
        )


def _finished(
    result: Identification, data: IdentificationData, skip: int, free: bool, read, fast: Fast | None
) -> Identified:
    """Return an identification with its validation, file and figures; ``read``: warnings from reading data."""
    if free:
        plant = replace(result.chain, offset=0.0)
        result = replace(result, chain=plant, assumptions=(*result.assumptions, CONSTANT_REMOVED))
    drift = result.drift * data.sample_time * np.arange(len(data))
    still = replace(data, output=data.output - drift)
    predicted = predict(result.chain, still.input, still.sample_time, measured=still.output)
    fitted = result.fitted
    shown = as_sensed(data, predicted + drift) - drift
    found, back, figures, judged = judge(result.chain, still, shown, skip=skip, free_offset=free, fitted=fitted)
    figures = {**figures, "noise_rms_m": white_noise(data.output - predicted - drift) * np.sqrt(data.factor)}
    notes = [*read, *result.warnings, *model_warnings(result), *judged, *modes_at_bounds(result.chain.linear_part)]
    if result.skipped:
        omitted = (still.output - predicted)[: result.skipped] - (found.offset if free else 0.0)
        beginning = float(np.sqrt(np.mean(omitted**2)))
        notes += _beginning_notes(data, beginning, result.numbers.get("predicted_rmse_m"), found.rmse)
        result = replace(result, numbers={**result.numbers, "beginning_rmse_m": beginning})
    if result.drift:
        sensed = as_sensed(data, predicted)
        whole = judge(result.chain, data, sensed, skip=skip, free_offset=free, inverse=False)[0].rmse
        result = replace(result, numbers={**result.numbers, "rmse_with_drift_m": whole})
        notes.append(
            f"the RMS error of {readable(found.rmse, 'm')} is that after removal of the drift; the model does not "
            f"drift, so its RMS error on the recording itself is {readable(whole, 'm')}"
        )
    notes += () if free else zero_warnings(data, result.chain)
    if found.rmse_percent_of_stroke > LEFT:
        notes.append(
            f"{result.model} has an RMS error of {found.rmse_percent_of_stroke:.2g} % of the stroke: another model may "
            "fit better (--model auto), or something else moves the output too, such as relaxation or noise"
        )
    if fast is not None:
        result = _with_fast(result, fast)
    judged_on = fast or Fast(sound_data(data, predicted + drift, skip), skip)
    checked = check_response(result.chain, judged_on.data, judged_on.skip)
    notes += checked.warnings if checked else ()
    if not result.converged:
        notes.insert(0, NOT_CONVERGED)
    chain = result.chain if fast else _at_recorded_rate(result.chain, data)
    result = replace(result, chain=chain, warnings=tuple(dict.fromkeys(notes)))
    section = identification_section(result, data, figures, skip, checked.entries if checked else None)
    excited = max(largest_change(one.input, one.sample_time) for one in (data, fast.data if fast else data))
    text = file_text(result, section, excited)
    named = {"model": result.model, "linear": result.linear, **figures, **result.numbers, "converged": result.converged}
    named |= checked.figures if checked else {}
    named |= {"sensor_zero_m": result.chain.offset} | ({"start": result.start} if result.start else {})
    named = {figure_name(name, result.chain.units): value for name, value in named.items()}
    compared = Compared(data, result.chain, predicted + drift, found, back, finite(named), result.warnings)
    return Identified(**vars(compared), identification=result, text=text, response=checked)


def _beginning_notes(
    data: IdentificationData, beginning: float, predicted: float | None, rmse: float
) -> tuple[str, ...]:
    """Return a warning if the RMS error in the omitted beginning is far above the predicted error, or else the fit's.

    Units: all errors [m].
    """
    expected, name = (predicted, "predicted error") if predicted else (rmse, "RMS error of the fit")
    if beginning <= BEGINNING * expected:
        return ()
    text = (
        f"the {name} of {readable(expected, 'm')} holds after the voltage has been near both ends of its "
        f"range; in the omitted beginning of this recording the error is {readable(beginning, 'm')} RMS"
    )
    if begins_at_zero(data.input):
        text += "; --initial zero fits the beginning too, if the actuator had no remanence then"
    return (text,)


def _with_fast(result: Identification, fast: Fast) -> Identification:
    """Return an identification with the dynamics of a fast recording."""
    chain, gain = with_fast_dynamics(result.chain, fast.data, fast.skip)
    numbers, words = chain.continuous.described()
    kept = {name: value for name, value in result.numbers.items() if not name.startswith(("lag_", "delay_", "mode_"))}
    numbers |= {**kept, "small_gain_over_model": gain}
    return replace(result, chain=chain, linear=", ".join(words) or "none", numbers=numbers)


def validate(
    parameters,
    source,
    *,
    namespace: str = "",
    inverse: bool = True,
    **conditions: Unpack[Conditions],
) -> Compared:
    """Simulate a plant under a recorded voltage, and compare with the measurement.

    ``parameters`` is a parameter file, or the result of :func:`identify` or :func:`validate`.
    """
    given = _checked(conditions)
    reading = read_data(source, Columns(whole=True))
    data = reading.data
    if isinstance(parameters, Compared):
        plant, identified_from = parameters.plant, parameters.figures.get("identified_from", parameters.data.source)
    else:
        plant, section = load_chain(parameters, namespace)
        identified_from = section.get("source")
        if "input" not in section:  # the file does not state the units of its recording
            plant = replace(plant, units=(data.input_unit, data.output_unit))
    if (data.input_unit, data.output_unit) != plant.units:
        raise IdentificationError(
            f"the recording is in {data.input_unit} and {data.output_unit}, but the model was identified in "
            f"{plant.units[0]} and {plant.units[1]}; choose other columns (--input, --output)"
        )
    with shown_in(*plant.units):
        return _validated(plant, identified_from, reading, inverse, given)


def _validated(plant: PlantModel, identified_from, reading: Reading, inverse: bool, given: Conditions) -> Compared:
    """Return the comparison of a plant with a recording."""
    data = reading.data
    if plant.invertible:
        plant = at_rate(plant, data.sample_time)
    start, predicted = _predicted(plant, data, given)
    skip, free = start.skip, given.get("offset") == "free"
    shown = as_sensed(data, predicted)
    found, back, figures, judged = judge(plant, data, shown, skip=skip, free_offset=free, inverse=inverse)
    notes = [*reading.report.warnings, *_beyond(plant, data), *judged]
    figures = {
        "model": plant.hysteresis.type,
        **figures,
        "largest_autocorrelation": found.autocorrelation.largest,
        "autocorrelation_bound": found.autocorrelation.bound,
        "lags_outside": found.autocorrelation.outside,
        "start": start.note,
    }
    figures = {figure_name(name, plant.units): value for name, value in figures.items()}
    figures = {**finite(figures), "identified_from": identified_from, "data": data.source}
    return Compared(data, plant, predicted, found, back, figures, tuple(notes), recording=reading.summary)


def _predicted(plant: PlantModel, data: IdentificationData, given: Conditions) -> tuple[Start, np.ndarray]:
    """Return the assumed beginning of a recording, and the prediction of the plant from there."""
    held, initial, skip = given.get("intersample"), given.get("initial"), _averaged(given.get("skip"), data)
    free = skip is None and initial is None
    start = requested(initial, skip)
    if free and not plant.invertible:
        start = REPEATED if input_repeated(plant, data, held) else NOT_REPEATED
        initial = start.kind
    predicted = predict(plant, data.input, data.sample_time, held, initial, measured=data.output)
    if free and plant.invertible:
        first, after = automatic_skip(data), partial(predict_after, plant, data.input, held)
        rested = plant.initial == "zero" and plant.hysteresis.type != "proportional"  # a gain remembers nothing
        start = start_of_prediction(data, first, after) if rested else without_memory(data, first)
    return start, predicted


def within_saturation(data: IdentificationData, recording: RecordingSummary) -> IdentificationData:
    """Return the data with its input limited to the range that the output follows; add a warning if it is."""
    low, high = recording.saturation
    limits = [-np.inf if low is None else low, np.inf if high is None else high]
    width = 1.5 * float(np.ptp(data.input)) / LEVELS
    for place, level in enumerate(limits):
        if math.isfinite(level):

            def error(value: float, place: int = place) -> float:
                return trial_error(data, (value, limits[1]) if place == 0 else (limits[0], value))

            found = scipy.optimize.minimize_scalar(
                error, bounds=(level - width, level + width), method="bounded", options={"maxiter": 12}
            )
            limits[place] = float(found.x)
    if not np.isfinite(limits).any():
        return data
    words = [
        f"{side} {readable(limit, data.input_unit)}"
        for side, limit in zip(("below", "above"), limits, strict=True)
        if math.isfinite(limit)
    ]
    warning = (
        f"the output stays level {' and '.join(words)}: an amplifier or the actuator saturates there; the fit and the "
        "limits of the file end there"
    )
    return replace(data, input=np.clip(data.input, limits[0], limits[1]), warnings=(*data.warnings, warning))


def as_sensed(data: IdentificationData, predicted: np.ndarray) -> np.ndarray:
    """Return the prediction, shape (N,), clipped at the levels at which the sensor clipped the recording."""
    clipped = clipped_samples(data.output, data.input)
    ends = [float(end) if np.any(clipped & (data.output == end)) else math.inf for end in _extremes(data.output)]
    return np.clip(predicted, -math.inf if math.isinf(ends[0]) else ends[0], ends[1])


def _extremes(values: np.ndarray) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _averaged(skip: int | None, data: IdentificationData) -> int | None:
    """Return the number of averaged samples that cover the first ``skip`` samples of the recording."""
    return None if skip is None else -(-max(skip - data.first, 0) // data.factor) if data.factor > 1 else skip


def _at_recorded_rate(chain: PlantModel, data: IdentificationData) -> PlantModel:
    """Return the chain at the sample rate before averaging, if possible."""
    recorded = data.sample_time / data.factor
    if data.factor == 1 or (chain.linear_part is None and chain.transfer_function is None and chain.dynamics.order):
        return chain
    part = chain.linear_part
    fast = part is not None and part.lag + part.delay < 0.5 * recorded
    return replace(at_rate(chain, recorded), synchronous=chain.synchronous and fast)


def _checked(conditions: Conditions) -> Conditions:
    """Return the conditions; raise IdentificationError for unknown ones."""
    known = Conditions.__annotations__
    unknown = [name for name in conditions if name not in known]
    if unknown:
        raise IdentificationError(f"{', '.join(unknown)}: unknown condition; there are {', '.join(known)}")
    skip = conditions.get("skip")
    if skip is not None and (isinstance(skip, bool) or not isinstance(skip, (int, np.integer))):
        raise IdentificationError(f"skip = {shortened(skip)}: must be a whole number of samples, or None: automatic")
    conditions = {**conditions, **({} if skip is None else {"skip": int(skip)})}
    offset = conditions.get("offset", "kept")
    if offset not in OFFSETS:
        raise IdentificationError(f"offset = {offset!r}: must be one of {', '.join(OFFSETS)}")
    return conditions


def _beyond(plant: PlantModel, data: IdentificationData):
    """Yield a warning if the voltage leaves the range of the identification."""
    low, high = data.input_range
    margin = 0.01 * (plant.voltage_high - plant.voltage_low)
    if low < plant.voltage_low - margin or high > plant.voltage_high + margin:
        yield (
            f"the voltage runs from {low:.4g} to {high:.4g} {plant.units[0]}, beyond the {plant.voltage_low:.4g} … "
            f"{plant.voltage_high:.4g} {plant.units[0]} of the identification: extrapolated"
        )


def finite(figures: dict) -> dict:
    """Return figures for JSON, in which values that are not finite become None."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in figures.items()
    }
