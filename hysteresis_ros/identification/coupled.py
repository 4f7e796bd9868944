# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.


"""Identification of coupled axes: several inputs and outputs, and one model for all levels of the excitation.

The identification has three steps; each uses the result of the previous one:

1. the frequency response matrix of each level, with separate estimates of noise and nonlinear distortion
   (``frequency_response``);
2. the linear dynamics at the middle level, by a subspace method and a refinement on the response (``subspace``); the
   order is chosen by the error of the simulation on held-out realisations;
3. the hysteresis inside the structure (``structure_fit``), by Gauss-Newton on the error of the simulation. The search
   begins with gains and plays, then adds the linear part, then C_z, then B_w and the radii. It ends when the error on
   the held-out realisations no longer decreases.

The initial value of C_z is Γ C Λ^τ, where Γ is the inverse of the static gain. With this value the input of the plays
is the motion of the actuators, advanced by τ samples. Without the advance, the search ends far from the true plant.
"""

from __future__ import annotations

import numbers
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from hysteresis_ros.arguments import Seconds, check_fields
from hysteresis_ros.configuration import dump_configuration
from hysteresis_ros.errors import IdentificationError, Problem
from hysteresis_ros.identification.data import CONSTANT, DataError
from hysteresis_ros.identification.frequency_response import SAME, ResponseMatrix, experiments_of, response_matrix
from hysteresis_ros.identification.linear_systems import LinearModel
from hysteresis_ros.identification.parameter_file import write_file
from hysteresis_ros.identification.structure_fit import LINEAR_GROUPS, Experiments, ModalStructure, refine_in_time
from hysteresis_ros.identification.subspace import refine_on_response, subspace_model
from hysteresis_ros.models.structure import Structure, StructureParameters

#: Realisations belong to one level if the RMS values of their inputs agree within this factor.
SAME_LEVEL = 1.2
#: Default orders; all of them are tried.
ORDERS = (4, 8, 12, 20, 28, 36, 44)
#: The lowest order is chosen whose error on the held-out realisations is at most this factor times the smallest error.
ENOUGH = 1.02
#: Every mode must decay to this fraction during the run-in; this is the remaining error of a simulation from rest.
REMAINDER = np.exp(-5.0)
#: Initial value of the advance τ of the input of the plays [samples].
ADVANCE = 1.1
#: Smallest and largest initial radius of the plays, as fractions of the RMS motion at the highest level.
SMALLEST_RADIUS, LARGEST_RADIUS = 0.05, 2.0
#: Initial weight of the plays.
FIRST_WEIGHT = 1e-3
#: Number of refinement steps on the frequency response.
RESPONSE_STEPS = 30
#: Number of steps of each early search stage with plays.
EARLY_STEPS = 6
#: Number of realisations of each level that an early search stage uses, with half a period each.
EARLY_REALISATIONS = 2
#: The search ends after this number of consecutive steps without a smaller error on the held-out realisations.
PATIENCE = 3
#: Largest fraction of the samples of a realisation that may differ from those one period later (skipped samples).
MOST_CHANGED = 0.1
#: Allowed weightings of the errors.
WEIGHTINGS = ("distortion", "absolute")
#: Stages of the search, with the parameters that each stage adds to the parameters of the earlier stages.
STAGES = (
    ("gains and plays", ("gains", "weights")),
    ("linear part", ("sigma", "gamma", "B", "C", "D")),
    ("C_z", ("C_z",)),
    ("B_w and radii", ("B_w", "radii")),
)


def changed_samples(u: np.ndarray, period: int) -> np.ndarray:
    """Return, for each sample of ``u``, shape (N, m), whether its inputs differ from those one period later."""
    size = float(np.sqrt(np.mean(np.var(u, axis=0))))
    return np.abs(u[period:] - u[:-period]).max(axis=1) > SAME * max(size, CONSTANT) * 2.0


@dataclass(frozen=True, eq=False)
class StructureData:
    """Recordings of several inputs and outputs: whole periods in steady state.

    Parameters
    ----------
    u : array_like, shape (R, P N, m)
        Inputs [V]: R realisations, each with P periods of N samples.
    y : array_like, shape (R, P N, q)
        Outputs [m].
    sample_time : float
        [s]
    period : int
        N.

    Raises
    ------
    DataError
        The shapes of inputs and outputs do not fit together, a value is not finite, or the inputs do not repeat.
    """

    u: np.ndarray
    y: np.ndarray
    sample_time: Seconds
    period: int

    def __post_init__(self) -> None:
        check_fields(self)
        u, y = experiments_of("input", self.u, self.period), experiments_of("output", self.y, self.period)
        if u.shape[:2] != y.shape[:2]:
            text = f"input {np.shape(self.u)} and output {np.shape(self.y)} differ in realisations or samples"
            raise DataError("shape", text)
        if not self.sample_time > 0.0:
            raise DataError("uniform", f"sample_time = {self.sample_time!r}: must be > 0 s")
        object.__setattr__(self, "u", np.asarray(self.u, dtype=float))
        object.__setattr__(self, "y", np.asarray(self.y, dtype=float))
        self._require_periodic()

    def _require_periodic(self) -> None:
        if self.u.shape[1] == self.period:
            return
        changed = [float(np.mean(changed_samples(one, self.period))) for one in self.u]
        worst = int(np.argmax(changed))
        if changed[worst] > MOST_CHANGED:
            raise DataError(
                "shape",
                f"the inputs do not repeat with a period of {self.period} samples: {100 * changed[worst]:.0f} % of the "
                f"samples of realisation {worst} differ from those one period later (allowed: {100 * MOST_CHANGED:g} "
                "%); give the period of the excitation",
            )

    @property
    def levels(self) -> tuple[np.ndarray, ...]:
        """Indices of the realisations of each level, the lowest level first."""
        size = np.sqrt(np.mean(self.u**2, axis=(1, 2)))
        order = np.argsort(size, kind="stable")
        ends = np.flatnonzero(size[order][1:] > SAME_LEVEL * size[order][:-1]) + 1
        return tuple(np.sort(part) for part in np.split(order, ends))

    def part(self, chosen) -> StructureData:
        """Return some of the realisations.

        Parameters
        ----------
        chosen : array_like of int
            Indices of the realisations.

        Returns
        -------
        StructureData
            A copy.
        """
        return replace(self, u=self.u[chosen], y=self.y[chosen])

    def averaged(self, run_in: int) -> Experiments:
        """Return the mean period of each realisation after a run-in, which repeats the end of the period."""
        R, _, m = self.u.shape
        u, y = (part.reshape(R, -1, self.period, part.shape[2]).mean(axis=1) for part in (self.u, self.y))
        before = np.tile(u, (1, -(-run_in // self.period), 1))[:, -run_in:] if run_in else u[:, :0]
        return Experiments(np.concatenate([before, u], axis=1), np.ascontiguousarray(y), np.ones(R))


@dataclass(frozen=True, eq=False)
class IdentifiedStructure:
    """Result of :func:`identify_structure`.

    Parameters
    ----------
    parameters : StructureParameters
        The model, in SI units.
    responses : tuple of ResponseMatrix
        Frequency response matrices from the realisations that were not held out, one for each level, the lowest first.
    figures : dict
        Figures by names with units: order, plays, largest modulus of a pole, largest condition number; for each level:
        errors on the fitted and on the held-out realisations, noise and distortion.
    warnings : tuple of str
        Sentences about uncertain results.
    """

    parameters: StructureParameters
    responses: tuple[ResponseMatrix, ...]
    figures: dict
    warnings: tuple[str, ...]

    def predict(self, u, period: int | None = None) -> np.ndarray:
        """Return the outputs that the model simulates.

        Parameters
        ----------
        u : array_like, shape (R, N, m) or (N, m)
            Inputs [V].
        period : int, optional
            Number of samples after which the inputs repeat. If given, the outputs are those of the steady state, after
            one period of run-in; otherwise the simulation starts from rest.

        Returns
        -------
        ndarray, shape (R, N, q) or (N, q)
            Outputs [m].

        Raises
        ------
        ParameterError
            The number of input columns differs from the number of inputs of the model.
        """
        u = np.asarray(u, dtype=float)
        found = []
        for one in u if u.ndim == 3 else u[None]:
            block = Structure(self.parameters, self.parameters.sample_time)
            if period:
                block.simulate(one[:period])
            found.append(block.simulate(one))
        return np.array(found) if u.ndim == 3 else found[0]

    def score(self, data: StructureData, skip: int = 0) -> np.ndarray:
        """Return the RMS error [m] of the simulation at each level.

        Parameters
        ----------
        data : StructureData
            Recordings that were not used for the fit.
        skip : int
            Number of samples omitted at the beginning of each period.

        Returns
        -------
        ndarray, shape (L, q)
            RMS error of a period, averaged over realisations and periods, for each level (the lowest first) and each
            output.
        """
        R, q = len(data.u), data.y.shape[2]
        rest = (self.predict(data.u, data.period) - data.y).reshape(R, -1, data.period, q)[:, :, skip:]
        each = np.sqrt(np.mean(rest**2, axis=2)).mean(axis=1)
        return np.array([each[chosen].mean(axis=0) for chosen in data.levels])

    def to_yaml(self) -> str:
        """Return the text of a parameter file with the structure of a plant.

        Returns
        -------
        str
            Parameters ``structure`` of the node ``plant_simulator``; each matrix is a list of its numbers, row by row.
        """
        values = {row.name: getattr(self.parameters, row.name) for row in StructureParameters.table()}
        return dump_configuration({"/**/plant_simulator": {f"structure.{name}": v for name, v in values.items()}})

    def save(self, path) -> None:
        """Write the parameter file completely or not at all.

        The file contains the structure alone. ``hr.identify`` with ``columns=hr.StageColumns(…)`` writes a stage.

        Parameters
        ----------
        path : path-like
            ``.yaml``

        Raises
        ------
        IdentificationError
            The file cannot be written.
        """
        write_file(path, self.to_yaml())


@dataclass(frozen=True)
class StructureEstimator:
    """An estimator of a structure, for any recordings.

    Parameters
    ----------
    order : int or tuple of int
        Even order of the linear part. If several are given, the lowest one is chosen that predicts the held-out
        realisations about as well as the best.
    plays : int
        Number of plays of each hysteresis; 0: linear dynamics only.
    hystereses : int
        Number of hystereses of each actuator. At the start of the search, the input of the first one is the motion of
        the structure, and the input of the others is the voltage.
    held_out : int
        Number of held-out realisations of each level; their error selects the order and ends the search.
    run_in : int, optional
        Number of samples before each period during which a simulation from rest settles; by default a quarter of the
        period. Modes that settle more slowly cannot be identified.
    weighting : str
        Weighting of the errors. ``distortion``: relative to the nonlinear distortion of the level, so that all levels
        count equally; ``absolute``: in metres, so that the highest level counts most.
    steps : int
        Largest number of steps of the last stage of the search, which fits all parameters to all realisations that are
        not held out.
    seconds : float, optional
        Time limit of the search [s]: no step begins after this time, and the best point so far is the result. If this
        limit ends the search, the model depends on the speed of the machine.
    band : tuple of float, optional
        Lowest and highest frequency [Hz] of the fit of the linear part; by default all excited lines.
    feedthrough : bool
        Whether an output may respond to the input of the same sample (matrix D). In a loop that measures before it
        commands, it cannot.
    progress : callable, optional
        Called as ``progress(text)`` after each step.
    """

    order: int | tuple[int, ...] = ORDERS
    plays: int = 8
    hystereses: int = 2
    held_out: int = 1
    run_in: int | None = None
    weighting: str = "distortion"
    steps: int = 20
    seconds: Seconds | None = None
    band: tuple[float, float] | None = None
    feedthrough: bool = True
    progress: Callable[[str], None] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        check_fields(self)

    def fit(self, data: StructureData) -> IdentifiedStructure:
        """Identify the structure from recordings.

        Parameters
        ----------
        data : StructureData
            At least m + ``held_out`` realisations of each level.

        Returns
        -------
        IdentifiedStructure
            The model with ``predict``, ``score`` and ``save``.

        Raises
        ------
        IdentificationError, DataError
            The options or the data cannot be used; the message states what is allowed.
        """
        orders = self._checked()
        begun, run_in = time.perf_counter(), data.period // 4 if self.run_in is None else self.run_in
        limits = REMAINDER ** (1.0 / run_in), np.inf if self.seconds is None else begun + self.seconds
        levels = data.levels
        m = data.u.shape[2]
        for chosen in levels:
            if len(chosen) < m + self.held_out:
                raise DataError(
                    "short",
                    f"{len(chosen)} realisations of a level: {m} inputs and held_out = {self.held_out} need at least "
                    f"{m + self.held_out}: record more, or hold out fewer",
                )
        fitted = [chosen[: len(chosen) - self.held_out] for chosen in levels]
        judged = [chosen[len(chosen) - self.held_out :] for chosen in levels]
        responses = tuple(self._response(data.part(chosen)) for chosen in fitted)
        whole = data.averaged(run_in)
        deviation = np.empty(len(data.u))
        for chosen, found in zip(levels, responses, strict=True):
            # without an estimate of the distortion, the errors of each level are relative to the outputs at this level
            deviation[chosen] = found.level(found.total).mean() if found.total is not None else whole.y[chosen].std()
        if self.weighting == "absolute":
            deviation[:] = deviation.mean()
        whole = replace(whole, deviation=deviation)
        training = whole.part(np.concatenate(fitted))
        held = whole.part(np.concatenate(judged)) if self.held_out else None
        middle = len(levels) // 2
        linear = self._linear(
            responses[middle], orders, whole.part(judged[middle] if held else fitted[middle]), limits[0]
        )
        scale = float(np.std(whole.y))
        start = ModalStructure.linear(linear, scale)
        if self.plays:
            early = np.concatenate([chosen[:: max(1, len(chosen) - 1)][:EARLY_REALISATIONS] for chosen in fitted])
            found, course = self._plays(
                start, linear, whole.part(early), training, held=held, limits=limits, run_in=run_in
            )
        else:
            found, course = self._refined(
                "linear part", start, training, LINEAR_GROUPS, held=held, steps=self.steps, limits=limits
            )
        parameters = found.parameters().validated()
        warnings = [text for one in responses for text in one.response.warnings]
        if not course.converged and held is None:
            warnings.append("the search was stopped before it converged; raise steps or seconds")
        result = IdentifiedStructure(parameters, responses, {}, tuple(dict.fromkeys(warnings)))
        figures = _figures(result, data, levels, fitted, judged if self.held_out else None)
        figures["seconds"] = time.perf_counter() - begun
        return replace(result, figures=figures)

    def _checked(self) -> tuple[int, ...]:
        """Return the orders to try; refuse options that cannot be used."""
        orders = (self.order,) if isinstance(self.order, int) else tuple(self.order)
        whole = all(isinstance(one, numbers.Integral) for one in orders)
        for name, value, allowed, wrong in (
            (
                "order",
                self.order,
                "must be even numbers ≥ 2",
                not (orders and whole) or any(n < 2 or n % 2 for n in orders),
            ),
            ("plays", self.plays, "must be ≥ 0", self.plays < 0),
            ("hystereses", self.hystereses, "must be ≥ 1", self.hystereses < 1),
            ("held_out", self.held_out, "must be ≥ 0", self.held_out < 0),
            ("run_in", self.run_in, "must be ≥ 1 sample", self.run_in is not None and self.run_in < 1),
            ("weighting", self.weighting, f"must be one of {', '.join(WEIGHTINGS)}", self.weighting not in WEIGHTINGS),
            ("steps", self.steps, "must be ≥ 1", self.steps < 1),
            ("seconds", self.seconds, "must be > 0 s", self.seconds is not None and not self.seconds > 0.0),
            ("band", self.band, "must be (lowest, highest frequency) in Hz", not _is_band(self.band)),
        ):
            if wrong:
                raise IdentificationError(str(Problem(name, value, allowed)))
        return orders

    def _report(self, text: str) -> None:
        if self.progress is not None:
            self.progress(text)

    def _response(self, data: StructureData) -> ResponseMatrix:
        return response_matrix(data.u, data.y, data.sample_time, data.period)

    def _linear(self, found: ResponseMatrix, orders, judge: Experiments, radius: float) -> LinearModel:
        """Return the linear dynamics of a level, in modal form."""
        response = found.response if self.band is None else found.response.band(*self.band)
        size = np.sqrt(np.mean(np.abs(response.response) ** 2, axis=(1, 2)))
        # between absolute and relative errors, so that resonances do not dominate the fit
        weights = np.sqrt(size.mean() / size)
        models, errors = [], []
        for order in orders:
            model = subspace_model(response, order, weights=weights, radius=radius, feedthrough=self.feedthrough)
            model, _ = refine_on_response(
                model, response, steps=RESPONSE_STEPS, radius=radius, feedthrough=self.feedthrough
            )
            models.append(model)
            errors.append(judge.cost(ModalStructure.linear(model, 1.0).parameters()))
            self._report(f"order {order}: weighted held-out error {np.sqrt(errors[-1]):.4g}")
        enough = np.sqrt(errors) <= ENOUGH * np.sqrt(min(errors))
        return models[min(np.flatnonzero(enough), key=lambda i: orders[i])]

    def _refined(self, name, start, training, groups, *, held, steps, limits):
        def step(text: str) -> None:
            self._report(f"{name}: {text}")

        radius, deadline = limits
        groups = tuple(group for group in groups if group != "D" or self.feedthrough)
        return refine_in_time(
            start,
            training,
            groups,
            steps=steps,
            held_out=held,
            radius=radius,
            patience=PATIENCE,
            deadline=deadline,
            progress=step,
        )

    def _plays(self, start: ModalStructure, linear: LinearModel, early, training, *, held, limits, run_in: int):
        """Return the structure with plays, and the result of the last search."""
        gain = np.linalg.pinv(np.atleast_2d(linear.dc_gain))
        ahead = [
            np.real(scipy.linalg.fractional_matrix_power(linear.A[i : i + 2, i : i + 2], ADVANCE))
            for i in range(0, linear.order, 2)
        ]
        motion = gain @ linear.C @ scipy.linalg.block_diag(*ahead)
        largest = training.u[int(np.argmax(training.u.std(axis=(1, 2))))]
        size = float(np.std(linear.simulate(largest)[run_in:] @ gain.T))
        m, further = len(motion), self.hystereses - 1
        model = replace(
            start,
            B_w=np.tile(linear.B, (1, self.hystereses)),
            C_z=np.concatenate([motion, np.zeros((m * further, linear.order))]),
            gains=np.concatenate([np.zeros(m), np.ones(m * further)]),
            weights=np.full((m * self.hystereses, self.plays), FIRST_WEIGHT),
            radii=size * np.geomspace(SMALLEST_RADIUS, LARGEST_RADIUS, self.plays),
        )
        half = training.y.shape[1] // 2
        early = replace(early, u=early.u[:, : early.u.shape[1] - half], y=early.y[:, : early.y.shape[1] - half])
        groups: tuple[str, ...] = ()
        for name, added in STAGES:
            groups += added
            model, _ = self._refined(name, model, early, groups, held=held, steps=EARLY_STEPS, limits=limits)
        return self._refined("everything", model, training, groups, held=held, steps=self.steps, limits=limits)


def _is_band(band) -> bool:
    """Return whether a band is None, or two frequencies [Hz] of which the second is higher."""
    if band is None:
        return True
    both = tuple(band)
    return len(both) == 2 and all(isinstance(one, numbers.Real) for one in both) and both[0] < both[1]


def _figures(result: IdentifiedStructure, data: StructureData, levels, fitted, judged) -> dict:
    """Return the figures of an identification by names with units."""
    parameters = result.parameters
    condition = np.concatenate([one.condition for one in result.responses])
    figures: dict = {
        "order": parameters.order,
        "plays": len(parameters.radii),
        "largest_modulus": float(np.abs(parameters.linear.poles).max()),
        "largest_condition": float(condition.max()),
        "level_rms_v": [float(np.sqrt(np.mean(data.u[chosen] ** 2))) for chosen in levels],
        "rmse_m": [float(result.score(data.part(chosen)).mean()) for chosen in fitted],
    }
    if judged is not None:
        figures["held_out_rmse_m"] = [float(result.score(data.part(chosen)).mean()) for chosen in judged]
    for name in ("noise", "total"):
        parts = [getattr(one, name) for one in result.responses]
        if all(part is not None for part in parts):
            pairs = zip(result.responses, parts, strict=True)
            figures[f"{name}_m"] = [float(one.level(part).mean()) for one, part in pairs]
    return figures


def identify_structure(u, y, sample_time: Seconds, period: int, **options) -> IdentifiedStructure:
    """Identify coupled axes, hysteresis included, from recordings of several inputs and outputs.

    Parameters
    ----------
    u : array_like, shape (R, P N, m)
        Inputs [V]: R realisations, each with P periods of N samples, of orthogonal or full random-phase multisines in
        steady state, at one or several levels.
    y : array_like, shape (R, P N, q)
        Outputs [m].
    sample_time : float or str
        [s], or a text with its unit such as ``"1ms"``.
    period : int
        N.
    **options
        ``order``, ``plays``, ``hystereses``, ``held_out``, ``run_in``, ``weighting``, ``steps``, ``seconds``, ``band``,
        ``feedthrough`` and ``progress``, see :class:`StructureEstimator`.

    Returns
    -------
    IdentifiedStructure
        One model for all levels, with ``parameters``, ``figures``, ``predict``, ``score`` and ``save``.

    Raises
    ------
    IdentificationError, DataError
        The excitations are correlated, there are too few realisations, or a shape, a value or an option is invalid.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> found = hr.identify_structure(u, y, 1 / 6400, 8192, order=40)  # doctest: +SKIP
    >>> found.save("mirror.yaml")  # doctest: +SKIP
    """
    unknown = [name for name in options if name not in StructureEstimator.__dataclass_fields__]
    if unknown:
        known = ", ".join(StructureEstimator.__dataclass_fields__)
        raise IdentificationError(f"{', '.join(unknown)}: no such option; there are {known}")
    return StructureEstimator(**options).fit(StructureData(u, y, sample_time, period))
