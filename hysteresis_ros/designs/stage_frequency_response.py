# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Response matrix of a stage: the run that measures it, the matrix from a recording, its table and its files.

Noise and distortion of an entry are standard deviations of the entry, after averaging over the realisations.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.designs.stage_excitation import PERIOD, ExcitedStage, StageExcitation, excited_stage
from hysteresis_ros.errors import ConfigurationError, IdentificationError
from hysteresis_ros.files import read_arrays
from hysteresis_ros.identification.coupled import StructureData
from hysteresis_ros.identification.data import DataError
from hysteresis_ros.identification.excitations import Plan
from hysteresis_ros.identification.frequency_response import (
    LEAST_RATIO,
    LINE,
    PROBABILITY,
    SPREADS,
    Analysis,
    FrequencyResponse,
    ResponseMatrix,
    near_level,
    reading_response,
    real_array,
    response_matrix,
    write_response_file,
)
from hysteresis_ros.identification.local_polynomial import local_polynomial_response
from hysteresis_ros.identification.response_check import LOWEST
from hysteresis_ros.identification.stage_data import (
    STILL,
    StageColumns,
    StageReading,
    planned_realisations,
    realisations,
)
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.models.hysteresis import hysteresis_block
from hysteresis_ros.references.recipes import REST, SMALL, WAY
from hysteresis_ros.units import readable

#: Approximate number of lines that are kept if the inputs are not periodic.
MOST_LINES = 500
#: Number of parts of a recording, to distinguish the usual motion from single large movements.
WINDOWS = 32


@dataclass(frozen=True, eq=False)
class StageResponse:
    """The measured response from the voltages of all actuators to the displacements of all sensors."""

    names: tuple[str, ...]  #: Names of the axes.
    matrix: ResponseMatrix
    excitation: str  #: Description of the excitation.

    @property
    def noise(self) -> np.ndarray | None:
        """Standard deviation of the entries due to noise, shape (F, n, n) [m/V]; None: unknown."""
        variance = self.matrix.response.noise_variance
        return None if variance is None else np.sqrt(variance)

    @property
    def distortion(self) -> np.ndarray | None:
        """Standard deviation of the entries due to nonlinear distortion, shape (F, n, n) [m/V]; None: unknown."""
        response = self.matrix.response
        if response.total_variance is None or response.noise_variance is None:
            return None
        clear = response.total_variance - response.noise_variance
        lines = np.arange(len(clear))
        levels = [near_level(lines, lines, column) for column in clear.reshape(len(clear), -1).T]
        return np.array(levels).T.reshape(clear.shape)

    @property
    def ratio(self) -> np.ndarray:
        """Signal-to-noise ratio of the entries [dB], median over the lines, shape (n, n)."""
        response = self.matrix.response
        variance = response.total_variance if response.noise_variance is None else response.noise_variance
        if variance is None:
            return np.full(response.response.shape[1:], np.inf)
        power = np.abs(response.response) ** 2 / np.maximum(variance, 1e-300)
        return np.median(10.0 * np.log10(np.maximum(power, 1e-300)), axis=0)

    def require_excited(self) -> None:
        """Refuse a response in which the motion by an actuator is too small for the noise of every sensor."""
        for name, best in zip(self.names, self.ratio.max(axis=0), strict=True):
            if best < LEAST_RATIO:
                raise IdentificationError(
                    f"the excitation of {name} is too weak: the signal-to-noise ratio of its response is {best:.1f} dB "
                    f"at half of the lines, but at least {LEAST_RATIO:g} dB are needed; raise --amplitude by a factor "
                    f"of {10.0 ** ((LEAST_RATIO - best) / 20.0):.2g}, or --periods"
                )

    def _pairs(self) -> Iterator[tuple[str, int, int]]:
        """Yield for each pair of input and output: its name, index of the output, index of the input."""
        for j, source in enumerate(self.names):
            for i, target in enumerate(self.names):
                yield f"{target}_from_{source}", i, j

    @property
    def figures(self) -> dict:
        """The figures; their names contain the units."""
        response, condition = self.matrix.response, self.matrix.condition
        size, ratio = np.abs(response.response), self.ratio
        found: dict[str, Any] = {
            "axes": list(self.names),
            "excitation": self.excitation,
            "lines": int(response.frequency.size),
            "lowest_hz": float(response.frequency[0]),
            "highest_hz": float(response.frequency[-1]),
            "largest_condition": float(condition.max()),
            "largest_condition_at_hz": float(response.frequency[np.argmax(condition)]),
        }
        for pair, i, j in self._pairs():
            entry = {
                "gain_m_per_v": float(np.median(size[:LOWEST, i, j])),
                "largest_m_per_v": float(size[:, i, j].max()),
                "largest_at_hz": float(response.frequency[np.argmax(size[:, i, j])]),
                "signal_to_noise_db": float(ratio[i, j]),
            }
            if self.distortion is not None:
                level = np.median(self.distortion[:, i, j] / size[:, i, j])
                entry["distortion_db"] = float(20.0 * np.log10(max(level, 1e-300)))
            found[pair] = {name: value for name, value in entry.items() if np.isfinite(value)}
        return found

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Columns of a table of the response; their names contain the units."""
        response = self.matrix.response
        unit = f"{response.output_unit}/{response.input_unit}"
        found = {"frequency [Hz]": response.frequency}
        radius = None if response.degrees is None else response.radius(PROBABILITY)
        levels = (f"radius_{100 * PROBABILITY:g}_percent", radius), ("noise", self.noise)
        for pair, i, j in self._pairs():
            values = response.response[:, i, j]
            found[f"{pair}_magnitude [{unit}]"] = np.abs(values)
            found[f"{pair}_phase [deg]"] = np.degrees(np.unwrap(np.angle(values)))
            for name, level in (*levels, ("distortion", self.distortion)):
                if level is not None:
                    found[f"{pair}_{name} [{unit}]"] = level[:, i, j]
        return found | {"condition [1]": self.matrix.condition}

    def lines(self) -> list[str]:
        """Return the printed table."""
        figures, names = self.figures, ", ".join(self.names)
        at = figures["largest_condition_at_hz"]
        rows = [
            ("response", f"voltages of {names} → displacements of {names}"),
            ("excitation", self.excitation),
            ("lines", f"{figures['lines']}, {figures['lowest_hz']:.4g} … {figures['highest_hz']:.4g} Hz"),
            ("condition number of the inputs", f"{figures['largest_condition']:.3g} at most, at {at:.4g} Hz"),
        ]
        width = max(len(name) for name, _ in rows)
        head = ("from → to", "lowest lines", "largest", "signal-to-noise ratio", "distortion")
        table = [head]
        for pair, i, j in self._pairs():
            one = figures[pair]
            distortion = one.get("distortion_db")
            clear = "" if distortion is None else f"{distortion:.1f} dB" if distortion > -200.0 else "below the noise"
            table.append(
                (
                    f"{self.names[j]} → {self.names[i]}",
                    f"{readable(one['gain_m_per_v'], 'm')}/V",
                    f"{readable(one['largest_m_per_v'], 'm')}/V at {one['largest_at_hz']:.4g} Hz",
                    f"{one['signal_to_noise_db']:.1f} dB" if "signal_to_noise_db" in one else "",
                    clear,
                )
            )
        wide = [max(len(row[place]) for row in table) for place in range(len(head))]
        return [
            *(f"{name:<{width}}  {text}" for name, text in rows),
            "",
            *("  ".join(f"{text:<{size}}" for text, size in zip(row, wide, strict=True)).rstrip() for row in table),
            *(f"note: {text}" for text in self.matrix.response.warnings),
        ]


def stage_response_run(
    configuration: Configuration, amplitude: str | None, period: float | None, more: dict[str, Any], path
) -> tuple[ExcitedStage, Plan]:
    """Return the stage that outputs orthogonal multisines, and the plan that describes them in a recording.

    ``amplitude`` is the peak amplitude of the multisines, as a fraction of the range of each axis, ``period`` [s] their
    period; ``more`` contains further settings of the excitation.
    """
    asked = StageExcitation(frequency=None if period is None else 1.0 / period, **more)
    if amplitude is not None:
        try:
            asked = StageExcitation(**vars(asked) | {"amplitude": float(amplitude) / SMALL})
        except ValueError:
            raise ConfigurationError(
                f"--amplitude {amplitude!r}: each axis has its own range: give a fraction of the range, "
                f"without a unit, such as {SMALL:g}"
            ) from None
    found = excited_stage(configuration, asked, path)
    rate = found.stage.sample_rate
    first = round(REST * rate) + round(WAY * rate)
    size = PERIOD if period is None else round(period * rate)
    return found, Plan("multisine", first, asked.settle, asked.periods, asked.count(len(found.stage.names)), (size,))


def recorded_stage_response(
    reading: StageReading, plan: Plan | None = None, period: float | None = None, settle: int | None = None
) -> StageResponse:
    """Return the response matrix in a recording of a stage; without a plan, the excitation is detected.

    Units: ``period`` [s]. Correlated excitations and actuators that do not move are refused.
    """
    names = reading.axes
    with correlated_by_name(reading):
        if plan is not None:
            places = (plan.first, plan.samples[0], plan.settle, plan.periods, plan.realisations)
            data: StructureData | None = planned_realisations(reading, *places)
        else:
            data = realisations(reading, StageColumns(period=period, settle=settle))
        matrix = response_without_periods(reading) if data is None else _of_one_level(data, reading.source)
    words = "no periods"
    if data is not None:
        step = data.period * data.sample_time
        count = data.u.shape[1] // data.period
        words = f"multisine, {len(data.u)} realisations of {count} periods of {readable(step, 's')}"
    found = StageResponse(names, matrix, words)
    found.require_excited()
    return found


def _of_one_level(data: StructureData, source: str) -> ResponseMatrix:
    """Return the response matrix of all realisations; their level must be the same."""
    levels, m = data.levels, data.u.shape[2]
    if len(levels) > 1 and min(len(level) for level in levels) >= m:
        sizes = ", ".join(f"{float(np.std(data.u[level])):.3g} V" for level in levels)
        raise DataError(
            "shape",
            f"{source}: has realisations of several levels ({sizes} RMS), but a response has one level: record "
            "each level in a file of its own, or give the file to hysteresis identify, which uses them all",
        )
    found = response_matrix(data.u, data.y, data.sample_time, data.period)
    return found.at(excited_lines(data.u, found, data))


@contextlib.contextmanager
def correlated_by_name(reading: StageReading) -> Iterator[None]:
    """Name the axes in an error about inputs that are correlated or constant."""
    try:
        yield
    except IdentificationError as error:
        names = reading.axes or reading.inputs
        u = np.concatenate([run - run.mean(axis=0) for run, _ in reading.runs])
        size = np.std(u, axis=0)
        still = [name for name, one in zip(names, size, strict=True) if one <= STILL * size.max()]
        if still:
            raise DataError(
                "constant",
                f"{reading.source}: {', '.join(still)} does not move: a response matrix needs an excitation of all "
                "axes (hysteresis excite STAGE --recipe multisine); use hysteresis frf --namespace AXIS for a "
                "recording in which a single axis moves",
            ) from None
        if isinstance(error, DataError):
            raise
        whole, parts = float(np.sqrt(np.mean(size**2))), np.array_split(u, WINDOWS)
        usual = float(np.sqrt(np.median([np.mean(np.var(part, axis=0)) for part in parts])))
        if usual <= STILL * whole:
            raise DataError(
                "constant",
                f"{reading.source}: the inputs move by {readable(usual, 'V')} RMS most of the time, but by "
                f"{readable(whole, 'V')} including the move to their centre: excite more strongly; hysteresis excite "
                "prints how far limits.slew_rate of plant_simulator and hysteresis_compensator reduces the amplitude",
            ) from None
        alike = np.abs(np.corrcoef(u.T)) - np.eye(len(names)) if len(names) > 1 else np.zeros((1, 1))
        one, other = np.unravel_index(int(np.argmax(alike)), alike.shape)
        raise IdentificationError(f"{reading.source}: {names[one]} and {names[other]}: {error}") from None


def level_responses(data: StructureData, held_out: int) -> tuple[tuple[ResponseMatrix, ...], list | None]:
    """Return the response of each level, from the realisations that are not held out, and the held-out realisations."""
    m, found, judged = data.u.shape[2], [], []
    for chosen in data.levels:
        if len(chosen) < m + held_out:
            raise DataError(
                "short",
                f"{len(chosen)} realisations of a level: {m} inputs and {held_out} held out need {m + held_out}: "
                "record more (hysteresis excite --realisations), hold out fewer (--held-out), or, if the recording "
                "has more, give --period and --settle",
            )
        kept = chosen[: len(chosen) - held_out]
        matrix = response_matrix(data.u[kept], data.y[kept], data.sample_time, data.period)
        found.append(matrix.at(excited_lines(data.u[kept], matrix, data)))
        judged.append(data.part(chosen[len(chosen) - held_out :]) if held_out else None)
    return tuple(found), judged if held_out else None


def excited_lines(u: np.ndarray, found: ResponseMatrix, data: StructureData) -> np.ndarray:
    """Return which lines are excited; the others contain only the effects of converters and late samples."""
    places = np.rint(found.response.frequency * data.period * data.sample_time).astype(int)
    mean = u.reshape(len(u), -1, data.period, u.shape[2]).mean(axis=1)
    strength = np.abs(np.fft.rfft(mean, axis=1)).max(axis=(0, 2))[places]
    return strength > LINE * strength.max()


def response_without_periods(reading: StageReading) -> ResponseMatrix:
    """Return the response matrix for inputs that are not periodic."""
    shortest = min(len(u) for u, _ in reading.runs)
    u, y = (np.array([run[place][:shortest] for run in reading.runs]) for place in (0, 1))
    found = local_polynomial_response(u, y, reading.sample_time)
    # the windows of neighbouring lines overlap, so only some lines are kept
    return found.at(np.arange(len(found.condition)) % max(len(found.condition) // MOST_LINES, 1) == 0)


def decoupled_responses(found: ResponseMatrix, gain: np.ndarray) -> tuple[Analysis, ...]:
    """Return the response of each axis to its command; the inverse of the static gain [m/V] decouples the commands."""
    return tuple(_decoupled(found, gain, i) for i in range(len(gain)))


def _decoupled(found: ResponseMatrix, gain: np.ndarray, i: int) -> Analysis:
    """Return the response of axis ``i`` to its decoupled command, with its variances."""
    into = np.linalg.inv(gain)[:, i]
    response = found.response

    def variance(values):
        return None if values is None else (values[:, i, :] * into**2).sum(axis=1)[:, None, None]

    one = FrequencyResponse(
        response.frequency,
        (response.response[:, i, :] @ into)[:, None, None],
        response.sample_time,
        variance(response.total_variance),
        variance(response.noise_variance),
        input_unit="m",
        degrees=response.degrees,
    )
    return Analysis(one, None, "multisine")


def command_responses(
    parameters: StageParameters, names: tuple[str, ...], found: ResponseMatrix
) -> dict[str, Analysis]:
    """Return the response of each axis of a stage to its decoupled command, by the names of the axes.

    Each response is marked as a response to a voltage; so it is scaled to the gain of the model, because small
    movements have a different gain.
    """
    if names != parameters.names:
        raise ConfigurationError(
            f"--response: has the axes {', '.join(names)}, but the stage has {', '.join(parameters.names)}"
        )
    step = 1.0 / parameters.sample_rate
    gains = [hysteresis_block(axis.hysteresis_compensator.hysteresis, step).gain for axis in parameters.axes]
    voltages = parameters.stage.matrix("decoupling") / np.array(gains)[:, None]
    analyses = decoupled_responses(found, np.linalg.inv(voltages))
    return {
        name: replace(one, response=replace(one.response, input_unit="V"))
        for name, one in zip(names, analyses, strict=True)
    }


def save_stage_response(path, found: StageResponse) -> None:
    """Write a response matrix in the format of the suffix: .npz, .csv or .yaml."""
    response = found.matrix.response
    arrays: dict[str, Any] = {"axes": np.array(found.names), "kind": np.array("multisine")}
    names = ("frequency", "response", "sample_time", "input_unit", "output_unit", *SPREADS)
    values = {name: getattr(response, name) for name in names}
    values |= {"noise": found.matrix.noise, "total": found.matrix.total, "condition": found.matrix.condition}
    arrays |= {name: np.asarray(value) for name, value in values.items() if value is not None}
    write_response_file(path, arrays, found.columns, found.figures)


def load_stage_response(path) -> tuple[tuple[str, ...], ResponseMatrix]:
    """Return the names of the axes and the response matrix of an NPZ file written by :func:`save_stage_response`."""
    with reading_response(path, "no response matrix of a stage", "hysteresis frf wrote for a stage"):
        held = read_arrays(path)
        names = tuple(str(name) for name in np.atleast_1d(held["axes"]))
        lines = real_array(held, "frequency")
        pairs = (lines.size, len(names), len(names))
        shapes = {name: pairs for name in ("response", "total_variance", "noise_variance", "noise", "total")}
        if not lines.size or np.any(np.diff(lines) <= 0.0):
            raise ValueError("no frequencies")
        for name, shape in shapes.items():
            if name in held and (held[name].shape != shape or not np.isfinite(held[name]).all()):
                raise ValueError(f"{name} has a wrong shape or a value that is not finite")
        spread: dict[str, Any] = {
            name: held[name].astype(float) for name in ("total_variance", "noise_variance") if name in held
        }
        (step,) = real_array(held, "sample_time")
        degrees = float(real_array(held, "degrees", 1)[0]) if "degrees" in held else None
        if not step > 0.0 or (str(held["input_unit"]), str(held["output_unit"])) != ("V", "m"):
            raise ValueError("wrong sample time or units")
        response = FrequencyResponse(lines, held["response"], float(step), degrees=degrees, **spread)
        condition = real_array(held, "condition", lines.size)
        return names, ResponseMatrix(response, held.get("noise"), held.get("total"), condition)
