# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""From recordings of a stage to its parameter file: structure, hysteresis, decoupling, controllers.

1. Response matrix G [m/V] of the realisations that are not held out; by the local polynomial method if the inputs do
   not repeat. A response matrix that was measured separately, if given, replaces G in the following steps.
2. ``hammerstein``: a stable state space of G without feedthrough, after a delay of whole samples. Order and delay are
   chosen by the error on the held-out realisations. Each column of its input matrix is divided by the static gain from
   the actuator to its own sensor, so that the inputs of the structure are displacements [m]. The hysteresis of each
   actuator is identified from loops in which this actuator moves alone. ``internal``: one structure that contains the
   hysteresis, fitted to all levels.
3. Decoupling: the inverse of the static gain. The linear model of each axis is fitted to the decoupled response of the
   axis and gets the measured uncertainty.
4. Controllers: designed for these models and the measured noise.
"""

from __future__ import annotations

import contextlib
import datetime
import os
import pathlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hysteresis_ros.configuration import (
    STAGE,
    Configuration,
    dump_configuration,
    parse_configuration,
    save_parameter_file,
)
from hysteresis_ros.control.coupling import lost_direction, relative_gain_array, static_decoupling
from hysteresis_ros.control.linearisation import whole_loop
from hysteresis_ros.control.margins import REQUIRED, loop_of, plant_state_space
from hysteresis_ros.designs.controller import AxisDesign, DesignRequest
from hysteresis_ros.designs.coupled import (
    Uncertainties,
    controllers_file,
    design_controllers,
    stage_lines,
    with_designs,
)
from hysteresis_ros.designs.measured import entries
from hysteresis_ros.designs.stage_frequency_response import (
    correlated_by_name,
    decoupled_responses,
    level_responses,
    load_stage_response,
    response_without_periods,
)
from hysteresis_ros.designs.stage_stability import require_stable
from hysteresis_ros.errors import ConfigurationError, HysteresisError, IdentificationError, ParameterError, Problem
from hysteresis_ros.identification import workflow
from hysteresis_ros.identification.coupled import StructureData, StructureEstimator
from hysteresis_ros.identification.data import DataError, IdentificationData
from hysteresis_ros.identification.frequency_response import (
    Analysis,
    FrequencyResponse,
    ResponseMatrix,
)
from hysteresis_ros.identification.linear_systems import FitError, LinearModel
from hysteresis_ros.identification.parameter_file import SECTION, block_mapping, rate_of
from hysteresis_ros.identification.response_check import LOWEST, measured_plant
from hysteresis_ros.identification.safe_motion import largest_change, with_comments, with_safe_motion
from hysteresis_ros.identification.stage_data import StageReading, loops_of, without_drift
from hysteresis_ros.identification.subspace import refine_on_response, subspace_model
from hysteresis_ros.loop.stage import Stage
from hysteresis_ros.loop.stage_parameters import HAMMERSTEIN, INTERNAL, StageParameters
from hysteresis_ros.models.compensator import USED, CompensatorParameters, returned_commands
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.models.linear_algebra import product
from hysteresis_ros.models.structure import Structure, StructureParameters
from hysteresis_ros.units import readable

#: Tried orders of a structure.
ORDERS = (2, 4, 6, 8, 12, 16)
#: Largest tried delay before a structure [samples].
MOST_DELAY = 3
#: Tried orders of the model of an axis.
AXIS_ORDERS = (2, 4, 6)
#: A lower order of the model of an axis suffices if its error is at most this multiple of the smallest error.
AXIS_ENOUGH = 1.2
#: An axis is modelled as a pure delay if the RMS error of this fit, as a fraction of the gain, is at most this.
PURE_DELAY = 1e-3
#: A structure is refined only if its error before the refinement is at most this factor times the smallest error.
WORTH = 10.0
#: A lower order of the structure suffices if its error is at most this factor times the smallest error, because further
#: states would only describe creep and hysteresis of the actuators.
STRUCTURE_ENOUGH = 1.1
#: Number of refinement steps on the response for each tried order.
STEPS = 15
#: Number of refinement steps on the response for the chosen order.
LAST_STEPS = 100
#: Largest modulus of a pole of a structure.
RADIUS = 1.0 - 1e-5
#: Real poles slower than this multiple of the lowest line count as creep and are not part of the structure.
CREEPING = 10.0
#: A slow loop is attributed to the measured response if the relative uncertainty of the response exceeds this value
#: near the bandwidth.
UNSURE = 0.5
#: Highest frequency at which the uncertainty counts for this, as a multiple of the bandwidth.
NEAR = 2.0
_HEADER = """\
# A stage of coupled axes, identified by `hysteresis identify`; a ROS 2 parameter file. SI units.
# /identification is not a node: it states where the numbers come from.
"""


@dataclass(frozen=True)
class StageRequest:
    """Options of an identification of a stage.

    Parameters
    ----------
    type : str, optional
        ``hammerstein`` or ``internal``; by default ``internal`` for recordings at several levels without loops.
    axes : tuple of str
        Names of the axes; by default the names in ``into`` or in the recording, or else x, y, z.
    order : int, optional
        Even order of the structure; by default the lowest order whose prediction error is close to the smallest one.
    held_out : int
        Number of realisations of each level that are held out to validate the models.
    model : str
        Hysteresis model for the loops.
    plays, hystereses : int
        For type ``internal``: number of plays of each hysteresis, and number of hystereses of each actuator.
    steps : int
        For type ``internal``: number of steps of the last search.
    controller : str
        Controller to design; ``none`` for an open loop.
    damping : str, optional
        Damping to design; by default integral resonant control, if it helps.
    noise : float, optional
        RMS noise of the sensors [m] for the design; by default the measured noise.
    resting_noise : tuple of float
        RMS noise of each sensor [m], measured at rest. If empty, the noise is estimated from the recording; the
        estimate includes every irregularity of the excitation.
    response : path-like, optional
        For type ``hammerstein``: the response matrix that ``hysteresis frf`` wrote for the stage (NPZ). The structure
        and the models of the axes are fitted to this matrix, and the designs use its frequency bands. The recording
        still determines the ranges, the noise and, with its held-out realisations, the order.
    progress : callable, optional
        Called as ``progress(text)``.
    """

    type: str | None = None
    axes: tuple[str, ...] = ()
    order: int | None = None
    held_out: int = 1
    model: str = "prandtl_ishlinskii"
    plays: int = 8
    hystereses: int = 2
    steps: int = 20
    controller: str = "pid"
    damping: str | None = None
    noise: float | None = None
    resting_noise: tuple[float, ...] = ()
    response: str | os.PathLike | None = None
    progress: Callable[[str], None] | None = field(default=None, compare=False)

    def checked(self) -> StageRequest:
        """Return the request, or raise an IdentificationError if an option cannot be used."""
        for name, value, allowed, wrong in (
            ("type", self.type, f"must be {HAMMERSTEIN} or {INTERNAL}", self.type not in (None, HAMMERSTEIN, INTERNAL)),
            (
                "order",
                self.order,
                "must be an even number ≥ 2",
                self.order is not None and (self.order < 2 or self.order % 2),
            ),
            ("held_out", self.held_out, "must be ≥ 0", self.held_out < 0),
            ("plays", self.plays, "must be ≥ 0", self.plays < 0),
            ("plays", self.plays, "must be ≥ 1 with type internal", self.plays == 0 and self.type == INTERNAL),
            ("noise", self.noise, "must be > 0 m", self.noise is not None and not self.noise > 0.0),
        ):
            if wrong:
                raise IdentificationError(str(Problem(name, value, allowed)))
        return self


@dataclass(frozen=True, eq=False)
class _Plant:
    """The identified plant."""

    type: str
    structure: StructureParameters
    delay: int  #: Delay of each actuator in whole samples.
    gain: np.ndarray  #: shape (n, n); Static gain from voltages to outputs for small motions [m/V].
    #: For each actuator; None: the actuator is proportional, or (type internal) its hysteresis is in the structure.
    hysteresis: tuple[workflow.Identified | None, ...]
    small: tuple[float, ...]  #: Gains of the actuators for small motions [m/V]; 1 for type internal.


#: If the gain of the held-out data is more than this factor times the gain of the written file, a design considers both
#: gains. A gain that is smaller by more than this factor is only reported.
DEVIATING = 1.1


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A held-out realisation in steady state, minus its mean, and its prediction."""

    time: np.ndarray  #: shape (N,) [s]
    measured: np.ndarray  #: shape (N, q) [m]
    predicted: np.ndarray  #: shape (N, q) [m]; Prediction of the whole parameter file.

    @property
    def errors(self) -> np.ndarray:
        """RMS error of each output [m]."""
        return np.sqrt(np.mean((self.predicted - self.measured) ** 2, axis=0))

    @property
    def motion(self) -> np.ndarray:
        """RMS motion of each output [m]."""
        return np.sqrt(np.mean(self.measured**2, axis=0))

    @property
    def gains(self) -> np.ndarray:
        """Factor on the prediction of each output that fits it best to the measurement; 1 without motion."""
        square = np.sum(self.predicted**2, axis=0)
        return np.where(
            square > 0.0, np.sum(self.predicted * self.measured, axis=0) / np.where(square, square, 1.0), 1.0
        )

    @property
    def shapes(self) -> np.ndarray:
        """RMS error of each output [m] after multiplication of the prediction by ``gains``."""
        return np.sqrt(np.mean((self.gains * self.predicted - self.measured) ** 2, axis=0))


@dataclass(frozen=True, eq=False)
class IdentifiedStage:  # numpydoc ignore=PR02
    """An identified stage.

    Parameters
    ----------
    text : str
        The parameter file of the stage, which ``simulate``, ``design`` and ``up`` accept.
    parameters : StageParameters
        Parameters in the text. With ``into``, the parameters of the identified stage, because the text keeps the plant
        of ``into``.
    responses : tuple of ResponseMatrix
        Response matrix [m/V] of each level, the lowest level first, with separate noise and distortion.
    axes : tuple of Analysis
        Response of each axis to its decoupled command.
    structure : ndarray, shape (F, n, n)
        Response of the identified linear part at the lines of the lowest level [m/V].
    loops : tuple of Identified or None
        Hysteresis of each actuator; None without loops.
    held_out : HeldOut or None
        Held-out data, and their prediction by the written file.
    designs : dict
        Designed controllers by the names of the axes.
    figures : dict
        Figures; their names contain the units.
    warnings : tuple of str
        Sentences about uncertain results.
    """

    text: str
    parameters: StageParameters
    responses: tuple[ResponseMatrix, ...]
    axes: tuple[Analysis, ...]
    structure: np.ndarray
    loops: tuple[workflow.Identified | None, ...]
    held_out: HeldOut | None
    designs: dict[str, AxisDesign]
    figures: dict
    warnings: tuple[str, ...]

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

    def lines(self) -> list[str]:
        """Return the printed report.

        Returns
        -------
        list of str
        """
        return _lines(self)


def identify_stage(
    reading: StageReading,
    data: StructureData | None,
    request: StageRequest | None = None,
    loops: StageReading | None = None,
    into: Configuration | None = None,
) -> IdentifiedStage:
    """Identify a stage.

    Parameters
    ----------
    reading : StageReading
        The recordings of the excitation.
    data : StructureData or None
        Realisations in the recordings; None if the inputs do not repeat.
    request : StageRequest, optional
        Options of the identification.
    loops : StageReading, optional
        A recording in which each actuator moves alone through its range.
    into : Configuration, optional
        A stage that keeps its plant and receives all other parameters from the identification.

    Returns
    -------
    IdentifiedStage
        The stage.

    Raises
    ------
    IdentificationError, DataError, ParameterError, ConfigurationError
        The data or the request cannot be used; the message states what is allowed.
    """
    request = (request or StageRequest()).checked()
    names = _names(reading, request, into)
    if loops is not None and (loops.inputs, loops.outputs) != (reading.inputs, reading.outputs):
        raise DataError("columns", f"{loops.source}: has other inputs or outputs than {reading.source}")
    kind = _kind(data, request, loops)
    responses, judged, noise = _responses(reading, data, request, names)
    warnings = [text for one in responses for text in one.response.warnings]
    for one in (reading, loops):
        if one is not None and one.skipped:
            count = sum(len(u) for u, _ in one.runs)
            warnings.append(
                f"{one.source}: this machine was too busy for {one.skipped} of {count} samples: the previous voltage "
                "was held, which counts as noise or distortion"
            )
    if kind == INTERNAL and data is not None:
        ends = responses[-1].response.frequency[[0, -1]]
        plant, held = _internal(data, request, (0.999 * ends[0], 1.001 * ends[1]))
    else:
        plant, held = _hammerstein(responses[0], judged, reading, loops, names, request)
    _require_regular(plant.gain, responses[0], names)
    analyses = decoupled_responses(responses[0], plant.gain)
    text, deviations = _file(reading, loops, plant, names, analyses, noise)
    parameters = StageParameters.from_configuration(parse_configuration(text, "the identified stage"))
    known = _uncertainties(parameters, analyses)
    held_out, deviating = None, list[str]()
    if judged is not None and data is not None:
        held_out = _held_out(parameters, data, request.held_out)
        known, deviating = _with_gains(known, held_out, names)
    measured = 0.0 if noise is None else float(np.max(noise))
    level = request.noise or measured or None  # a simulated plant may have no noise
    text, designs, why = design_identified(text, parameters, request, level, analyses, known)
    warnings += deviating + why
    designed = parse_configuration(text, "the identified stage")
    parameters = StageParameters.from_configuration(designed)
    figures = _figures(responses, plant, held, noise, names, data) | deviations
    if held_out is not None:
        figures |= {f"file_{name}_rmse_m": float(v) for name, v in zip(names, held_out.errors, strict=True)}
    if into is not None:
        text = put_into(into, designed, parameters)
    warnings = list(dict.fromkeys(warnings))
    text = _with_section(text, reading, loops, request.response, figures, warnings, known)
    structure = _linear_response(plant, responses[0].response.frequency)
    return IdentifiedStage(
        text,
        parameters,
        responses,
        analyses,
        structure,
        plant.hysteresis,
        held_out,
        designs,
        figures,
        tuple(warnings),
    )


def _responses(reading: StageReading, data: StructureData | None, request: StageRequest, names):
    """Return the response matrix of each level, the held-out realisations and the sensor noise [m]; None: unknown."""
    judged = None
    with correlated_by_name(reading):
        if data is None:
            responses: tuple[ResponseMatrix, ...] = (response_without_periods(reading),)
        else:
            responses, judged = level_responses(data, request.held_out)
    noise = np.array(request.resting_noise) if request.resting_noise else _noise(responses[0], data)
    if request.response is not None:
        responses = (_measured_matrix(request.response, names, reading),)
    return responses, judged, noise


def _kind(data: StructureData | None, request: StageRequest, loops: StageReading | None) -> str:
    """Return the type of the stage: by default ``internal`` for recordings at several levels without loops."""
    several = data is not None and len(data.levels) > 1 and loops is None and request.plays > 0
    kind = request.type or (INTERNAL if several else HAMMERSTEIN)
    if kind == INTERNAL and loops is not None:
        raise IdentificationError(f"type {INTERNAL}: the hysteresis is identified from the levels; omit the loops")
    if kind == INTERNAL and data is None:
        raise DataError("shape", f"type {INTERNAL}: the inputs do not repeat; excite with periodic multisines")
    if kind == INTERNAL and request.response is not None:
        raise IdentificationError(
            f"type {INTERNAL}: the structure is fitted to all levels of the recording, not to a response matrix: omit "
            f"--response, or give --type {HAMMERSTEIN}"
        )
    return kind


def _measured_matrix(path, names: tuple[str, ...], reading: StageReading) -> ResponseMatrix:
    """Return the response matrix in a file; refuse one with other axes or another sample rate."""
    axes, found = load_stage_response(path)
    if axes != names:
        raise IdentificationError(
            f"{path}: has the axes {', '.join(axes)}, but the recording has {', '.join(names)}; measure the stage of "
            "the recording, or give the same names with --axes"
        )
    step = found.response.sample_time
    if abs(step / reading.sample_time - 1.0) > 1e-6:
        raise IdentificationError(
            f"{path}: was measured at {1.0 / step:.6g} Hz, but the recording has {1.0 / reading.sample_time:.6g} Hz; "
            "measure it at the rate of the recording"
        )
    return found


def _require_regular(gain: np.ndarray, found: ResponseMatrix, names: tuple[str, ...]) -> None:
    """Refuse a static gain [m/V] with a combination of voltages that causes no displacement."""
    lost = _lost(gain, found, names)
    if lost:
        raise ParameterError(
            [
                Problem(
                    "static gain [m/V]",
                    [[float(f"{value:.4g}") for value in row] for row in gain],
                    f"is singular: the direction {lost} moves no sensor; excite more strongly, or move the sensors",
                )
            ]
        )


def _linear_response(plant: _Plant, frequency: np.ndarray) -> np.ndarray:
    """Return the response of the linear part of a plant to voltages, shape (F, n, n) [m/V]."""
    step = plant.structure.sample_time
    linear = plant.structure.linear if plant.type == HAMMERSTEIN else plant.structure.small
    z = np.exp(2j * np.pi * frequency * step)
    return linear.response(z) * np.array(plant.small) * z[:, None, None] ** -plant.delay


def _lost(gain: np.ndarray, found: ResponseMatrix, names) -> str:
    """Return the combination of actuators that moves no sensor by more than the uncertainty of the gain."""
    left, sizes, right = np.linalg.svd(gain)
    response = found.response
    # the lowest lines determine the static gain
    unsure = 0.0
    if response.degrees is not None:
        circle = response.radius()[:LOWEST]
        unsure = float(np.sqrt(np.mean(circle**2) / len(circle)))
    if sizes[-1] <= unsure:
        sizes = np.append(sizes[:-1], 0.0)
    return lost_direction(left * sizes @ right, [f"actuator {name}" for name in names])


def _names(reading: StageReading, request: StageRequest, into: Configuration | None) -> tuple[str, ...]:
    m, q = len(reading.inputs), len(reading.outputs)
    if m != q:
        raise IdentificationError(
            f"{m} inputs and {q} outputs: a stage has one sensor for each actuator; give as many --output as --input"
        )
    if request.axes:
        names = request.axes
    elif into is not None:
        names = StageParameters.from_configuration(into).names
    elif reading.axes:
        names = reading.axes
    else:
        names = tuple("xyz"[:m]) if m <= 3 else tuple(f"a{i + 1}" for i in range(m))
    if len(names) != m:
        raise IdentificationError(str(Problem("axes", names, f"must be {m} names, one for each input and its output")))
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        allowed = f"'{twice[0]}' occurs more than once: give each actuator its own name"
        raise IdentificationError(str(Problem("axes", names, allowed)))
    return tuple(names)


def _hammerstein(found: ResponseMatrix, judged, reading, loops, names, request: StageRequest):
    """Return the plant with the hysteresis before the linear structure, and the held-out errors of its linear part."""
    orders = ORDERS if request.order is None else (request.order,)
    model, delay = _linear(found.response, judged, orders, STRUCTURE_ENOUGH, request.progress)
    held = None if judged is None else _held_errors(model, delay, judged[0])
    gain = model.dc_gain
    own = np.diag(gain).copy()
    small = 1e-3 * np.abs(gain).max()
    for i, name in enumerate(names):
        if abs(own[i]) < small:
            raise IdentificationError(
                f"static gain of actuator {reading.inputs[i]} at sensor {reading.outputs[i]} = {own[i]:.3g} m/V, but "
                f"the largest gain is {np.abs(gain).max():.3g} m/V: name inputs and outputs in the order of the axes"
            )
        if own[i] < 0.0:
            raise IdentificationError(
                f"axis {name}: {reading.outputs[i]} falls when {reading.inputs[i]} rises, but a hysteresis before the "
                "structure needs a positive gain: negate that column"
            )
    flat = {
        "A": _block_values(model),
        "B": tuple((model.B / own).ravel().tolist()),
        "C": tuple(model.C.ravel().tolist()),
    }
    structure = StructureParameters(
        inputs=len(names), outputs=len(names), **flat, sample_time=_step(reading.sample_time)
    )
    hysteresis: list[workflow.Identified | None] = [None] * len(names)
    if loops is not None:
        hysteresis = _loops(loops, names, request)
    return _Plant(HAMMERSTEIN, structure, delay, gain, tuple(hysteresis), tuple(own.tolist())), held


def _step(sample_time: float) -> float:
    return 1.0 / rate_of(sample_time)


def _block_values(model: LinearModel) -> tuple[float, ...]:
    """Return A of a modal model as its 2×2 blocks."""
    return tuple(v for i in range(0, model.order, 2) for v in model.A[i : i + 2, i : i + 2].ravel().tolist())


def _linear(
    response: FrequencyResponse, judged, orders: Sequence[int], enough: float, progress=None
) -> tuple[LinearModel, int]:
    """Return the state space of a response in modal form, and the delay before it [samples]."""
    z = np.exp(2j * np.pi * response.frequency * response.sample_time)
    size = np.sqrt(np.mean(np.abs(response.response) ** 2, axis=(1, 2)))
    weights = np.sqrt(size.mean() / size)
    entries = np.broadcast_to(weights[:, None, None], response.response.shape)

    def early(delay: int) -> FrequencyResponse:
        return replace(response, response=response.response * z[:, None, None] ** delay)

    found: list[tuple[float, int, int, LinearModel]] = []
    for order in orders:
        for delay in range(MOST_DELAY + 1):
            with contextlib.suppress(FitError, DataError, np.linalg.LinAlgError):
                model = subspace_model(early(delay), order, weights=weights, radius=RADIUS, feedthrough=False)
                found.append((_judge(model, delay, response, judged), order, delay, model))
    if not found:
        tried_orders = ", ".join(map(str, orders))
        raise IdentificationError(
            f"no structure of order {tried_orders} fits the response; give another order with --order"
        )
    least = min(one[0] for one in found)
    tried: list[tuple[float, int, int, LinearModel]] = []
    for error, order, delay, model in found:
        if error > WORTH * least:
            continue
        model, _ = refine_on_response(model, early(delay), entries, steps=STEPS, radius=RADIUS, feedthrough=False)
        tried.append((_judge(model, delay, response, judged), order, delay, model))
        if progress is not None:
            progress(f"order {order}, delay {delay}: error {tried[-1][0]:.4g}")
    # a slow real pole would describe creep, which belongs to the actuators, and would change the static gain
    tried = [one for one in tried if not _slow(one[3], response)] or tried
    least = min(one[0] for one in tried)
    # the lowest order that is almost as good as the best, and the best delay for this order
    order = min(one[1] for one in tried if one[0] <= enough * least)
    _, _, delay, model = min((one for one in tried if one[1] == order), key=lambda one: one[0])
    last, _ = refine_on_response(model, early(delay), entries, steps=LAST_STEPS, radius=RADIUS, feedthrough=False)
    model = model if _slow(last, response) else last
    return model, delay


def _slow(model: LinearModel, response: FrequencyResponse) -> bool:
    """Return whether a model has a real pole slower than :data:`CREEPING` times the lowest line of the response."""
    poles = model.poles
    slowest_allowed = np.exp(-2.0 * np.pi * CREEPING * response.frequency[0] * response.sample_time)
    return bool(np.any((np.abs(poles.imag) < 1e-9) & (poles.real > slowest_allowed)))


def _judge(model: LinearModel, delay: int, response: FrequencyResponse, judged) -> float:
    """Return the RMS error of a model on the held-out realisations [m]; without them, on the response itself [m/V]."""
    if judged is not None:
        errors = _held_errors(model, delay, judged[0])
        return float(np.sqrt(np.mean(errors**2)))
    z = np.exp(-2j * np.pi * response.frequency * response.sample_time)
    rest = model.frequency_response(response.frequency) * z[:, None, None] ** delay - response.response
    return float(np.sqrt(np.mean(np.abs(rest) ** 2)))


def _held_errors(model: LinearModel, delay: int, data: StructureData) -> np.ndarray:
    """Return the RMS error of each output [m] in steady state, without the mean, shape (q,)."""
    R, _, m = data.u.shape
    N = data.period
    u, y = (one.reshape(R, -1, N, one.shape[2]).mean(axis=1) for one in (data.u, data.y))
    U, Y = np.fft.rfft(u, axis=1), np.fft.rfft(y, axis=1)
    f = np.arange(N // 2 + 1) / (N * data.sample_time)
    G = model.frequency_response(f) * np.exp(-2j * np.pi * f * data.sample_time * delay)[:, None, None]
    rest = np.einsum("fij,rfj->rfi", G, U) - Y
    rest[:, 0] = 0.0
    return np.sqrt(np.mean(np.fft.irfft(rest, N, axis=1) ** 2, axis=(0, 1)))


def _internal(data: StructureData, request: StageRequest, band: tuple[float, float]):
    """Return the plant with the hysteresis inside the structure, and its held-out errors."""
    centre = data.u.mean(axis=(0, 1)), data.y.mean(axis=1, keepdims=True)
    moved = replace(data, u=data.u - centre[0], y=data.y - centre[1])
    orders: dict[str, Any] = {} if request.order is None else {"order": request.order}
    estimator = StructureEstimator(
        plays=request.plays,
        hystereses=request.hystereses,
        held_out=request.held_out,
        steps=request.steps,
        feedthrough=False,
        band=band,
        progress=request.progress,
        **orders,
    )
    found = estimator.fit(moved)
    parameters = replace(found.parameters, sample_time=_step(data.sample_time))
    held = None
    if request.held_out:
        judged = [chosen[len(chosen) - request.held_out :] for chosen in moved.levels]
        held = np.mean([found.score(moved.part(chosen)).mean(axis=0) for chosen in judged], axis=0)
    count = len(parameters.small.C)
    gain = parameters.small.dc_gain.reshape(count, -1)
    return _Plant(INTERNAL, parameters, 0, gain, (None,) * count, (1.0,) * count), held


def _loops(loops: StageReading, names, request: StageRequest) -> list[workflow.Identified | None]:
    """Return the hysteresis of each actuator, from the part of the recording in which this actuator moves alone."""
    u, y = loops.whole()
    found: list[workflow.Identified | None] = []
    for i, (name, (first, last)) in enumerate(zip(names, loops_of(loops), strict=True)):
        if request.progress is not None:
            request.progress(f"hysteresis of {name}")
        time = np.arange(last - first) * loops.sample_time
        data = IdentificationData(
            time, u[first:last, i], y[first:last, i], "V", "m", loops.inputs[i], loops.outputs[i], loops.source
        )
        try:
            one = workflow.identify(data, request.model, linear="lag,delay,creep")
        except IdentificationError as error:
            raise type(error)(*_named(error, f"{loops.source}: actuator {name}")) from None
        if not one.plant.invertible:
            raise IdentificationError(f"model {request.model}: its hysteresis contains dynamics; choose another model")
        found.append(one)
    return found


def _named(error: IdentificationError, where: str) -> tuple:
    text = f"{where}: {error}"
    return (error.check, text) if isinstance(error, DataError) else (text,)


def _noise(found: ResponseMatrix, data: StructureData | None) -> np.ndarray | None:
    """Return the RMS noise of each output [m], from the upper half of the lines; None: unknown."""
    if found.noise is None:
        return None
    upper = found.noise[len(found.noise) // 2 :]
    samples = 1 if data is None else data.u.shape[1]
    # without periods, found.noise is the covariance of a single sample
    return np.sqrt(samples * np.einsum("fii->i", upper).real / len(upper))


def _file(reading, loops, plant: _Plant, names, analyses, noise) -> tuple[str, dict[str, float]]:
    """Return the text of the stage in open loop, and the deviation of each axis model from its response [%]."""
    rate = rate_of(reading.sample_time)
    step = 1.0 / rate
    count = len(names)
    matrices = {f"structure.{name}": value for name, value in plant.structure.to_mapping().items() if value != ()}
    scaled = plant.gain / np.array(plant.small)
    decoupling = static_decoupling(scaled, [f"actuator {name}" for name in names])
    recordings = [reading, *([loops] if loops is not None else [])]
    lows = [min(u[:, i].min() for one in recordings for u, _ in one.runs) for i in range(count)]
    highs = [max(u[:, i].max() for one in recordings for u, _ in one.runs) for i in range(count)]
    changes = [max(largest_change(u[:, i], step) for one in recordings for u, _ in one.runs) for i in range(count)]
    centre = np.array([np.mean([u[:, i].mean() for u, _ in reading.runs]) for i in range(count)])
    shared = {"sample_rate": rate}
    stage = {"axes": list(names), "type": plant.type, **matrices, "decoupling": tuple(decoupling.ravel().tolist())}
    nodes: dict[str, dict] = {"/**": shared, f"/{STAGE}": stage}
    deviations: dict[str, float] = {}
    compensators, preloads = [], []
    for i in range(count):
        compensator, preload = _compensator(plant, i, float(min(lows[i], 0.0)), float(max(highs[i], 0.0)))
        compensators.append(compensator)
        preloads.append(preload)
    if plant.type == INTERNAL:
        preloads = _resting_offsets(plant, reading, centre)
    elif loops is None:
        preloads = (np.array(_means(reading)[1]) - plant.gain @ np.array(_means(reading)[0])).tolist()
    ranges = _ranges(plant, compensators, decoupling, step)
    for i, name in enumerate(names):
        values, deviations[f"model_{name}_deviation_percent"] = _axis_model(analyses[i].response, step)
        compensator, (low, high), offset = compensators[i], ranges[i], float(preloads[i])
        limits = {key: value for key, value in compensator.items() if key.startswith("limits.")}
        hysteresis = {key: value for key, value in compensator.items() if key.split(".")[0] in ("hysteresis", "creep")}
        nodes[f"/{name}/plant_simulator"] = {
            "joint": name,
            **limits,
            **hysteresis,
            **({"dynamics.sample_time": step, "dynamics.delay": plant.delay * step} if plant.delay else {}),
            **({"preload.A1": offset} if offset else {}),
            **({"sensor.noise": float(noise[i]), "sensor.seed": i + 1} if noise is not None else {}),
        }
        nodes[f"/{name}/hysteresis_compensator"] = dict(compensator)
        nodes[f"/{name}/motion_controller"] = {
            "type": "open_loop",
            **values,
            **({"model.preload.A1": offset} if offset else {}),
        }
        nodes[f"/{name}/reference_generator"] = {
            "minimum": low,
            "maximum": high,
            "initial_setpoint": float(f"{0.5 * (low + high):.4g}"),
            "waveform.type": "hold",
        }
        for other in ("hysteresis_compensator", "motion_controller", "reference_generator"):
            nodes[f"/{name}/{other}"]["joint"] = name
    text = _HEADER + dump_configuration(_copied(nodes))
    for name, change in zip(names, changes, strict=True):
        text = with_safe_motion(text, "the identified stage", f"/{name}", change)
    return text, deviations


def _axis_model(response: FrequencyResponse, step: float) -> tuple[dict, float]:
    """Return the dynamics of an axis for its controller's model, and the median error of their response [%]."""
    model, late = _linear(response, None, AXIS_ORDERS, AXIS_ENOUGH)
    dynamics = replace(model.linear_parameters(), delay=late * step)
    f = response.frequency
    fitted = (model.frequency_response(f)[:, 0, 0] / model.dc_gain * np.exp(-2j * np.pi * f * late * step)).ravel()
    # a pure delay has order 0; a model of higher order would have uncontrollable states
    samples = np.arange(1, MOST_DELAY + 2)
    delays = np.exp(-2j * np.pi * np.outer(samples, f) * step)
    errors = np.sqrt(np.mean(np.abs(delays - response.single) ** 2, axis=1))
    least = float(np.sqrt(np.mean(np.abs(fitted - response.single) ** 2)))
    if errors.min() <= max(AXIS_ENOUGH * least, PURE_DELAY):
        fitted = delays[np.argmin(errors)]
        dynamics = LinearParameters(delay=float(samples[np.argmin(errors)]) * step)
    relative = np.abs(response.single - fitted) / np.maximum(np.abs(fitted), 1e-12)
    values = {f"model.dynamics.{key}": value for key, value in dynamics.to_mapping().items() if value != ()}
    return values | {"model.dynamics.sample_time": step}, 100.0 * float(np.median(relative))


def _copied(nodes: dict) -> dict:
    """Return the nodes with copied arrays, because YAML would write a repeated array as an alias."""
    return {
        node: {key: tuple(v) if isinstance(v, tuple) else v for key, v in values.items()}
        for node, values in nodes.items()
    }


def put_into(into: Configuration, designed: Configuration, found: StageParameters) -> str:
    """Return the text of the stage ``into`` with decoupling, compensators, controllers and references of ``designed``.

    A simulated stage keeps its plant. A stage of devices gets the identified plant, because only simulations and
    designs use it.
    """
    given = StageParameters.from_configuration(into)
    if abs(given.sample_rate / found.sample_rate - 1.0) > 1e-6:
        raise ConfigurationError(
            f"{into.source}: runs at {given.sample_rate:g} Hz, but the recording has {found.sample_rate:g} Hz; "
            "record at the rate of the stage"
        )
    if given.names != found.names:
        raise ConfigurationError(
            f"{into.source}: has the axes {', '.join(given.names)}, but the recording has {', '.join(found.names)}; "
            "give the same names with --axes"
        )
    stage = {"decoupling": found.stage.decoupling, "feedforward.weights": (), "scan.kind": ""}
    devices = all(axis.plant_simulator.driver for axis in given.axes)
    if devices:
        matrices = {f"structure.{name}": value for name, value in found.stage.structure.to_mapping().items()}
        stage |= {"type": found.stage.type, **matrices}
    entries: list[tuple[str, dict]] = [(f"{given.namespace}/{STAGE}", stage)]
    for name, axis in zip(given.names, given.axes, strict=True):
        if devices:
            plant = designed.node("plant_simulator", f"/{name}")
            entries.append((f"{given.namespace}/{name}/plant_simulator", _modelled(plant)))
        for node in ("hysteresis_compensator", "motion_controller", "reference_generator"):
            values = dict(designed.node(node, f"/{name}"))
            values = {key: value for key, value in values.items() if key not in ("joint", "sample_rate")}
            if node == "hysteresis_compensator":
                # the stage keeps its voltage limits
                own = axis.hysteresis_compensator.limits
                values |= {"limits.minimum": own.minimum, "limits.maximum": own.maximum}
                if own.slew_rate > 0.0:
                    values["limits.slew_rate"] = own.slew_rate
                values = {"creep.type": "none", **values}
            elif node == "motion_controller":
                values = {"damping.type": "none", "feedforward.type": "none", "learning.type": "none", **values}
            entries.append((f"{given.namespace}/{name}/{node}", values))
    whole = replace(into, entries=(*into.entries, *entries))
    text = StageParameters.from_configuration(whole).configuration_text()
    return _HEADER + with_comments(text, designed.text)


def _modelled(plant: dict) -> dict:
    """Return the model parameters of an identified plant without those of its device; missing ones get defaults."""
    lacking = {"creep.type": "none", "dynamics.delay": 0.0, "preload.A1": 0.0, "sensor.noise": 0.0}
    model = ("hysteresis.", "creep.", "dynamics.", "preload.", "sensor.")
    return lacking | {key: value for key, value in plant.items() if key.startswith(model)}


def _compensator(plant: _Plant, i: int, low: float, high: float) -> tuple[dict, float]:
    """Return the parameters of an axis' compensator, and the zero of its sensor [m]."""
    limits = {"limits.minimum": low, "limits.maximum": high}
    one = plant.hysteresis[i]
    if one is None:
        gain = 1.0 if plant.type == INTERNAL else plant.small[i]
        return {"hysteresis.type": "proportional", "hysteresis.proportional.gain": gain, **limits}, 0.0
    chain = one.plant
    creep = {} if chain.creep.type == "none" else block_mapping(chain.creep, "creep.")
    hysteresis = block_mapping(chain.hysteresis, "hysteresis.")
    return {**block_mapping(chain.inverse, "inverse."), **limits, **hysteresis, **creep}, float(chain.offset)


def _means(reading: StageReading) -> tuple[list[float], list[float]]:
    """Return the means of inputs [V] and outputs [m]."""
    u, y = (np.concatenate([run[place] for run in reading.runs]) for place in (0, 1))
    return u.mean(axis=0).tolist(), y.mean(axis=0).tolist()


def _resting_offsets(plant: _Plant, reading: StageReading, centre) -> list[float]:
    """Return the sensor zeros [m] of a structure with hysteresis: mean output minus steady state at mean voltage."""
    block = Structure(plant.structure, plant.structure.sample_time)
    block.settle(centre)
    return (np.array(_means(reading)[1]) - block.step(centre)).tolist()


def _ranges(plant: _Plant, compensators, decoupling, step: float) -> list[tuple[float, float]]:
    """Return ranges of the degrees of freedom [m] that are reached repeatedly and in any combination."""
    ends = np.array(
        [returned_commands(CompensatorParameters.from_mapping(one).validated(), step) for one in compensators]
    )
    middle, half = ends.mean(axis=1), 0.5 * np.abs(np.diff(ends, axis=1))[:, 0]
    back = np.linalg.inv(decoupling)
    centre = back @ middle
    wide = np.abs(np.diag(back)) * half
    share = USED * float(np.min(half / (np.abs(decoupling) @ wide)))
    return [(float(f"{c - share * w:.4g}"), float(f"{c + share * w:.4g}")) for c, w in zip(centre, wide, strict=True)]


def _uncertainties(parameters: StageParameters, analyses) -> Uncertainties:
    """Return the uncertainty of each axis' model from its measured response, if this response has a variance."""
    found = {}
    for name, axis, analysis in zip(parameters.names, parameters.axes, analyses, strict=True):
        response = analysis.response
        if response.degrees is not None:
            z = np.exp(2j * np.pi * response.frequency * response.sample_time)
            model = plant_state_space(axis.motion_controller.model.dynamics).response(z)[:, 0, 0]
            found[name] = measured_plant(analysis, model).uncertainty(model, response.sample_time)
    return found


def _with_gains(known: Uncertainties, held_out: HeldOut, names) -> tuple[Uncertainties, list[str]]:
    """Return uncertainties that include held-out gains above the gains of the file, and a warning for each such gain.

    A hysteresis model that was identified from slow loops has a wrong gain for small, fast movements if the actuators
    have hysteresis of another class.
    """
    found, said = dict(known), []
    for name, gain in zip(names, held_out.gains, strict=True):
        if gain > DEVIATING:
            said.append(
                f"axis {name}: the held-out multisine has {gain:.3g} times the gain of the file with the hysteresis of "
                "the loops; a design keeps its margins with both gains"
            )
            if name in known:
                found[name] = replace(known[name], gain=float(f"{gain:.3g}"))
    return found, said


def design_identified(
    text: str, parameters: StageParameters, request: StageRequest, noise: float | None, analyses, known: Uncertainties
):
    """Return the text with designed controllers, the designs, and warnings or the reason for missing designs.

    Units: ``noise`` [m], RMS.
    """
    if request.controller == "none":
        return text, {}, []
    dampings: Sequence[str | None] = (request.damping,) if request.damping else ("irc", None)
    said: list[str] = []
    for damping in dampings:
        asked = DesignRequest(controller=request.controller, noise=noise, damping=damping)
        try:
            designs = design_controllers(parameters, asked, known)
            words = f"--controller {request.controller}" + (f" --damping {damping}" if damping else "")
            source = parse_configuration(text, "the identified stage")
            require_stable(with_designs(parameters, designs), source.source)
            warnings = _measured(designs, analyses) + _too_slow(designs, analyses, noise)
            # each reason is listed once, because it is the same for all axes
            reasons = dict.fromkeys(design.together for design in designs.values() if design.together)
            warnings += [f"all loops together: {reason}" for reason in reasons]
            return controllers_file(source, designs, words), designs, warnings
        except (HysteresisError, ValueError) as error:
            said.append(f"{request.controller}, damping {damping or 'none'}: {error}")
    if request.damping is not None or request.noise is not None:
        raise ConfigurationError("; ".join(said))
    return text, {}, [f"no controller could be designed, so the loops are open: {'; '.join(said)}"]


def _measured(designs: dict[str, AxisDesign], analyses) -> list[str]:
    """Return a warning for each loop whose M_s on the measured response exceeds the limit of a design."""
    found = []
    for (name, design), analysis in zip(designs.items(), analyses, strict=True):
        response = analysis.response
        if response.degrees is None:
            continue
        controller, model = whole_loop(design.parameters, response.sample_time)
        circle = response.radius()[:, 0, 0]
        loop = loop_of(controller, response.frequency, response.single, circle, response.sample_time, model)
        if loop.sensitivity_peak.low > REQUIRED.sensitivity_peak:
            found.append(
                f"axis {name}: on the measured response M_s reaches {loop.sensitivity_peak.low:.3g}, but "
                f"at most {REQUIRED.sensitivity_peak:g} is allowed: design again with a lower --bandwidth"
            )
    return found


def _too_slow(designs: dict[str, AxisDesign], analyses, noise: float | None) -> list[str]:
    """Return a warning for each loop slower than the lowest measured line, or slow because of an uncertain response.

    Units: ``noise`` [m], RMS.
    """
    found = []
    for (name, design), analysis in zip(designs.items(), analyses, strict=True):
        response, bandwidth = analysis.response, design.margins.bandwidth
        lowest = float(response.frequency[0])
        near = response.frequency <= NEAR * max(bandwidth, lowest)
        unsure, where = 0.0, lowest
        if response.degrees is not None:
            parts = response.radius()[near, 0, 0] / np.abs(response.single[near])
            unsure, where = float(np.max(parts)), float(response.frequency[near][np.argmax(parts)])
        slow = f"axis {name}: the loop has a bandwidth of {readable(bandwidth, 'Hz')} only"
        if unsure > UNSURE:
            found.append(
                f"{slow}: its response at {readable(where, 'Hz')} is known to ±{100.0 * unsure:.0f} %, and the design "
                "assumes the worst case: record more realisations (hysteresis excite --realisations)"
            )
        elif bandwidth < lowest:
            reason = "" if noise is None else f"; the noise of {readable(noise, 'm')} may be the reason: give --noise"
            found.append(f"{slow}, below the lowest measured frequency of {readable(lowest, 'Hz')}{reason}")
    return found


def _figures(responses, plant: _Plant, held, noise, names, data) -> dict:
    """Return the figures of an identification; their names contain the units."""
    figures: dict = {
        "type": plant.type,
        "order": plant.structure.order,
        "delay_samples": plant.delay,
        "lines": int(responses[0].response.frequency.size),
        "lowest_hz": float(responses[0].response.frequency[0]),
        "highest_hz": float(responses[0].response.frequency[-1]),
        "largest_condition": float(max(one.condition.max() for one in responses)),
        "gain_m_per_v": [[float(v) for v in row] for row in plant.gain],
        "relative_gains": [[float(v) for v in row] for row in relative_gain_array(plant.gain)],
    }
    if data is not None:
        figures |= {"realisations": len(data.u), "period_s": data.period * data.sample_time}
    for i, name in enumerate(names):
        one = plant.hysteresis[i]
        if held is not None:
            figures[f"held_out_{name}_rmse_m"] = float(held[i])
        if noise is not None:
            figures[f"noise_{name}_m"] = float(noise[i])
        if one is not None:
            figures[f"loops_{name}_rmse_m"] = float(one.figures["rmse_m"])
            figures[f"loops_{name}_rmse_percent_of_stroke"] = float(one.figures["rmse_percent_of_stroke"])
    for name in ("noise", "total"):
        values = getattr(responses[0], name)
        if values is not None:
            levels = responses[0].level(values)
            word = "noise" if name == "noise" else "noise_and_distortion"
            figures |= {f"{word}_in_response_{axis}_m": float(v) for axis, v in zip(names, levels, strict=True)}
    return figures


def _held_out(parameters: StageParameters, data: StructureData, held_out: int) -> HeldOut:
    """Return the held-out data of the highest level and their prediction by the identified stage, without the means."""
    chosen = np.concatenate([level[len(level) - held_out :] for level in data.levels])
    u, y = data.u[chosen[-1]], data.y[chosen[-1]]
    # the model settles in all repetitions but the last
    predicted = simulated(parameters, np.concatenate([u] * 4))[-len(u) :]
    # the drift is removed as in the data, in which creep moves the stage from period to period
    predicted = without_drift(predicted[np.newaxis], data.period)[0]
    # subtract the mean difference of each output, because the zeros of the sensors are not part of the prediction
    shift = (predicted - y).mean(axis=0)
    mean = y.mean(axis=0)
    return HeldOut(np.arange(len(u)) * data.sample_time, y - mean, predicted - mean - shift)


def simulated(parameters: StageParameters, u: np.ndarray) -> np.ndarray:
    """Return the noise-free sensor readings of a stage [m], shape (N, n), for voltages ``u`` [V] that begin at rest."""
    stage = Stage(parameters)
    drives = np.empty_like(np.asarray(u, dtype=float))
    for i, plant in enumerate(stage.plants):
        one = plant.actuator
        drives[:, i] = one.dynamics.simulate(one.creep.simulate(one.hysteresis.simulate(u[:, i])))
    block = Structure(parameters.stage.structure, 1.0 / parameters.sample_rate)
    preloads = np.array([axis.plant_simulator.preload.offset for axis in parameters.axes])
    return product(block.simulate(drives) + preloads, parameters.stage.matrix("sensor_matrix").T)


def _with_section(text: str, reading, loops, response, figures: dict, warnings, known: Uncertainties) -> str:
    """Return the text with its section ``/identification``."""
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    section: dict = {"source": reading.source, "date": now.isoformat()}
    if loops is not None:
        section["loops"] = loops.source
    if response is not None:
        section["linear_source"] = pathlib.Path(response).name
    section |= {"inputs": list(reading.inputs), "outputs": list(reading.outputs)}
    for name, value in figures.items():
        if isinstance(value, list):
            value = tuple(float(v) for v in np.ravel(value))
        section[f"metrics.{name}"] = value
    if warnings:
        section["warnings"] = list(warnings)
    for name, uncertainty in known.items():
        section |= entries(uncertainty, name)
    return text.rstrip("\n") + "\n" + dump_configuration({SECTION: section})


def _lines(found: IdentifiedStage) -> list[str]:
    """Return the printed report of an identified stage."""
    figures, names = found.figures, found.parameters.names
    response = found.responses[0].response
    rows: list[tuple[str, str]] = [
        ("axes", ", ".join(names)),
        ("type", f"{figures['type']}, order {figures['order']}, {figures['delay_samples']} samples of delay before it"),
        ("response", f"{figures['lines']} lines, {figures['lowest_hz']:.4g} … {figures['highest_hz']:.4g} Hz"),
        ("condition of the inputs", f"{figures['largest_condition']:.3g} at most"),
    ]
    if "realisations" in figures:
        rows.append(
            ("excitation", f"{figures['realisations']} realisations, period {readable(figures['period_s'], 's')}")
        )
    width = 10
    table = ["", "static gain [m/V]  " + "".join(f"{name:>{width + 2}}" for name in names)]
    for name, row in zip(names, figures["gain_m_per_v"], strict=True):
        table.append(f"  {name:<17}" + "".join(f"{value:>{width + 2}.4g}" for value in row))
    table += ["", "response, largest over the lines [m/V]"]
    peak = np.abs(response.response).max(axis=0)
    where = response.frequency[np.abs(response.response).argmax(axis=0)]
    for i, name in enumerate(names):
        entries = [f"{peak[i, j]:.3g} at {where[i, j]:.4g} Hz" for j in range(len(names))]
        table.append(f"  {name:<6}" + "  ".join(f"{entry:>22}" for entry in entries))
    table += [
        "",
        f"{'output':<8}{'held out':>12}{'as written':>12}{'noise':>12}{'in response: noise':>20}{'and distortion':>16}",
    ]

    def shown(name: str) -> str:
        return readable(figures[name], "m") if name in figures else "-"

    for name in names:
        table.append(
            f"{name:<8}{shown(f'held_out_{name}_rmse_m'):>12}{shown(f'file_{name}_rmse_m'):>12}"
            f"{shown(f'noise_{name}_m'):>12}{shown(f'noise_in_response_{name}_m'):>20}"
            f"{shown(f'noise_and_distortion_in_response_{name}_m'):>16}"
        )
    for name in names:
        if f"loops_{name}_rmse_m" in figures:
            percent = figures[f"loops_{name}_rmse_percent_of_stroke"]
            table.append(f"loops of {name}: RMS error {shown(f'loops_{name}_rmse_m')}, {percent:.2g} % of the stroke")
    for name, design in found.designs.items():
        table.append(f"controller of {name}: {design.parameters.type}, bandwidth {design.margins.bandwidth:.4g} Hz")
    size = max(len(label) for label, _ in rows)
    head = [f"{label:<{size}}  {text}" for label, text in rows]
    return [*head, *table, "", *stage_lines(found.parameters), *(f"warning: {text}" for text in found.warnings)]
