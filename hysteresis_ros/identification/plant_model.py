# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The identified plant (a chain of blocks that the nodes run), and the request and the result of an identification.

voltage → hysteresis → creep → linear dynamics → + offset.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.linear_systems import LinearPart
from hysteresis_ros.identification.sensor_zero import sensor_zero
from hysteresis_ros.models.creep import Creep, CreepParameters
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block
from hysteresis_ros.models.inverses import InverseParameters
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters
from hysteresis_ros.units import readable


@dataclass(frozen=True)
class Request:
    """Request of one identification: the model, the dynamics that may follow it, and the conditions."""

    model: str
    parts: tuple[str, ...]  #: Parts that may follow the hysteresis, any of ``lag``, ``delay``, ``creep``, ``modes``.
    stage: str | None  #: Dynamics of higher order, in place of ``parts``.
    options: dict  #: Options of the model, by name.
    inverse: str  #: Type of the compensator's inverse.
    skip: int | None  #: Number of omitted samples at the beginning; None: all that earlier voltages affect.
    intersample: str
    initial: str | None
    progress: Callable[[int, str], None]  #: ``progress(number, text)``.
    #: Cache of results for this data: of :func:`.separation.separated`, by its arguments; and lists of fits of plays
    #: and densities, by :meth:`.separation.Start.past`.
    separations: dict = field(default_factory=dict)

    def report_residual(self, number: int, rmse: float) -> None:
        """Report the progress of a fit by its residual [m]."""
        self.progress(number, f"residual {readable(rmse, 'm')}")


@dataclass(frozen=True)
class FittedHysteresis:
    """A fitted hysteresis."""

    hysteresis: HysteresisParameters
    fitted: int  #: Number of fitted parameters.
    deviations: dict[str, float] = field(default_factory=dict)  #: Standard deviations, if known.
    warnings: tuple[str, ...] = ()
    converged: bool = True


@dataclass(frozen=True, eq=False)
class PlantModel:
    """Model of a plant: voltage → hysteresis → creep → linear dynamics → + offset."""

    hysteresis: HysteresisParameters
    creep: CreepParameters
    dynamics: LinearParameters  #: Linear dynamics at ``sample_time``.
    sample_time: float  #: [s]
    offset: float = 0.0  #: Constant part of the displacement [m]; a plant contains it as preload offset.
    #: Creep, lag, delay and modes in continuous time, if the dynamics consist of these.
    linear_part: LinearPart | None = None
    #: Numerator and denominator of the dynamics, if they were identified in continuous time.
    transfer_function: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    #: Whether each displacement responds to the voltage of the same sample (quasi-static sweeps). An axis, in contrast,
    #: measures before the voltage of the sample acts.
    synchronous: bool = False
    #: Identified voltage history [V] before the recording, from rest at 0 V; :meth:`simulate` begins with this history.
    history: tuple[float, ...] = ()
    initial: str = "zero"  #: Initial state: ``zero``, ``periodic`` or ``estimate``.
    intersample: str = "zoh"  #: Input between samples: ``zoh``, ``linear`` or ``bandlimited``.
    voltage_low: float = 0.0  #: voltage_low, voltage_high: Range of the recording [V].
    voltage_high: float = 0.0
    #: Inverse that the compensator uses.
    inverse: InverseParameters = field(default_factory=lambda: InverseParameters(type="general"))
    #: SI units of input and output; the parameters' documentation calls them V and m.
    units: tuple[str, str] = ("V", "m")
    #: Range of the input [V] outside which the output is constant, if the recording shows a saturation.
    saturation: tuple[float, float] | None = None

    @property
    def invertible(self) -> bool:
        """Whether the hysteresis is a separate, invertible block; otherwise it includes dynamics."""
        return self.hysteresis.model.block.invertible

    @property
    def continuous(self) -> LinearPart:
        """Creep, lag, delay and modes; a lag with the same low-frequency group delay replaces other dynamics."""
        if self.linear_part is not None:
            return self.linear_part
        # half of the sample time is the delay of the hold; a recorded voltage does not contain this delay
        delay = group_delay(self.dynamics) * self.sample_time - 0.5 * self.sample_time
        return LinearPart(lag=max(delay, 0.0))

    def simulate(self, voltage, sample_time: float | None = None) -> np.ndarray:
        """Return the displacement [m], shape (N,), without the offset, see :func:`simulate_chain`.

        Units: ``voltage`` [V], ``sample_time`` [s].
        """
        other = sample_time is not None and sample_time != self.sample_time
        sample_time = self.sample_time if sample_time is None else sample_time
        return simulate_chain(
            self.hysteresis,
            self.creep,
            self.continuous.dynamics(sample_time) if other else self.dynamics,
            voltage,
            sample_time,
            settled=self.continuous.settled,
            synchronous=self.synchronous and not other,
            history=self.history,
        )


@dataclass(frozen=True, eq=False)
class Identification:
    """Result of any identification."""

    model: str  #: Name of the model in the registry.
    linear: str  #: Description of the dynamics after the hysteresis.
    #: The model; its hysteresis is zero at rest at 0 V, or at the remanent displacement at the beginning of the
    #: recording.
    chain: PlantModel
    fitted: int  #: Number of fitted parameters.
    #: Figures of the fit except the parameters, by names with units (``lag_s``).
    numbers: dict[str, float] = field(default_factory=dict)
    deviations: dict[str, float] = field(default_factory=dict)  #: Standard deviations, by parameter.
    assumptions: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    converged: bool = True  #: False: the fit did not converge; this is the best point found.
    skipped: int | None = None  #: Number of omitted samples at the beginning; None: all that earlier voltages affect.
    start: str = ""  #: Sentence about the assumed voltage history before the recording.
    drift: float = 0.0  #: Drift of the output that is independent of the voltage [m/s]; not part of the model.
    #: Names of the parameters, and their values after each iteration of the best run, shape (K, n).
    trajectory: tuple[tuple[str, ...], np.ndarray] | None = None


@runtime_checkable
class IdentifiedModel(Protocol):
    """Result of an estimator of any model: predictions, their comparison with recordings, parameters of an axis."""

    def predict(self, voltage, sample_time: float | None = None) -> np.ndarray:
        """Return the displacement [m], shape (N,), under a voltage [V] of shape (N,).

        The default of ``sample_time`` [s] is the sample time of the recording.
        """
        ...

    def score(self, data) -> Any:
        """Compare a prediction with a recording: errors, tests of the residual, inverse."""
        ...

    def to_axis(self) -> Configuration:
        """Return the parameters of an axis: plant, compensator, controller and reference."""
        ...


@runtime_checkable
class Estimator(Protocol):
    """An estimator: a chosen structure with options, without data."""

    def fit(self, data) -> IdentifiedModel:
        """Return the model that fits a recording."""
        ...


class Procedure(Protocol):
    """The fit of one hysteresis model, named in its declaration as ``identify="my_package.my_fit:identify"``."""

    def __call__(self, data: IdentificationData, request: Request) -> Identification:
        """Return the plant that fits the data, with deviations, warnings and whether the search converged."""
        ...


#: Number of points per voltage ramp of the history before the recording.
FINE = 65


def simulate_chain(
    hysteresis: HysteresisParameters,
    creep: CreepParameters,
    dynamics: LinearParameters,
    voltage,
    sample_time: float,
    *,
    settled: bool = False,
    synchronous: bool = False,
    history: tuple[float, ...] = (),
) -> np.ndarray:
    """Return the displacement of a plant under ``voltage`` [m], computed by the kernels of the nodes.

    Voltage limits and sensor are not simulated. The plant starts at rest at 0 V. Sample k is measured before voltage k
    acts, as on an axis, unless ``synchronous``.

    Units: ``voltage`` [V], ``sample_time`` [s].
    """
    voltage = np.ascontiguousarray(voltage, dtype=np.float64)
    front = hysteresis_block(hysteresis, sample_time)
    pass_through(front, history)
    behind, last = Creep(creep, sample_time), LinearDynamics(dynamics, sample_time)
    last.settle(behind.settle(front.step(voltage[0] if settled else 0.0)))
    start = last.output()
    after = last.simulate(behind.simulate(front.simulate(voltage)))
    return after if synchronous else np.append(start, after[:-1])


def pass_through(block, history) -> None:
    """Step a hysteresis through voltages [V] in small steps, because some models are integrated along the path."""
    block.simulate(stretches(history))


def stretches(history) -> np.ndarray:
    """Return voltages [V], shape (K,), that go in small steps from 0 V through the voltages of a history."""
    ends = zip((0.0, *history), history, strict=False)
    return np.concatenate([np.zeros(0), *(np.linspace(low, high, FINE)[1:] for low, high in ends)])


def group_delay(dynamics: LinearParameters) -> float:
    """Return the group delay at zero frequency [samples]; 0 without dynamics."""
    if not dynamics.order:
        return 0.0
    model = dynamics.state_space
    rest = np.linalg.inv(np.eye(dynamics.order) - model.A)
    return float(model.C[0] @ rest @ rest @ model.B[:, 0]) / model.dc_gain


def at_rest(hysteresis: HysteresisParameters, sample_time: float) -> float:
    """Return the displacement [m] of a hysteresis at rest at 0 V.

    Units: ``sample_time`` [s].
    """
    return float(hysteresis_block(hysteresis, sample_time).step(0.0))


def grounded(hysteresis: HysteresisParameters, sample_time: float) -> tuple[HysteresisParameters, float]:
    """Return the hysteresis shifted to be zero at rest at 0 V, and the removed constant [m].

    References are then relative to the rest position, because the hysteresis no longer contains the sensor's constant.

    Units: ``sample_time`` [s].
    """
    rest = at_rest(hysteresis, sample_time)
    moved = hysteresis.shifted(-rest)
    return (moved, rest) if moved is not hysteresis else (hysteresis, 0.0)


def chain_of(
    data: IdentificationData,
    request: Request,
    hysteresis: HysteresisParameters,
    part: LinearPart | None,
    dynamics: LinearParameters,
    synchronous: bool,
    offset: float = 0.0,
) -> PlantModel:
    """Return the chain of a hysteresis that is zero at rest, with the sensor's zero if the recording shows it."""
    hysteresis, rest = grounded(hysteresis, data.sample_time)
    settled = part is not None and part.settled
    gain = 1.0 if part is None else part.settled_gain
    low, high = data.input_range
    offset = float(offset + rest * gain)
    chain = PlantModel(
        hysteresis=hysteresis,
        creep=CreepParameters() if part is None else part.creep,
        dynamics=dynamics,
        sample_time=data.sample_time,
        # the plant starts with settled creep, but during a recording creep does not settle
        offset=offset,
        linear_part=part,
        synchronous=bool(synchronous),
        initial=request.initial or ("estimate" if settled else "zero"),
        intersample=request.intersample,
        voltage_low=low,
        voltage_high=high,
        inverse=InverseParameters(type=request.inverse),
        units=(data.input_unit, data.output_unit),
    )
    zero = sensor_zero(data, chain)
    if zero is None:
        return chain
    # the sensor's zero is its reading at 0 V without remanence; a remanent displacement belongs to the hysteresis
    value = zero.significant
    moved = hysteresis.shifted((offset - value) / gain)
    return chain if moved is hysteresis else replace(chain, hysteresis=moved, offset=value)


#: Half width of a 95 % interval, in standard deviations.
WITHIN_95_PERCENT = 1.96


def half_widths(numbers: dict[str, float], deviations: dict[str, float]) -> dict[str, float]:
    """Return half widths of the 95 % intervals of lag, delay and modes, as figures such as ``lag_plus_minus_s``."""
    found = {}
    for name in numbers:
        unit = next((unit for unit in ("_s", "_hz") if name.endswith(unit)), "")
        stem = name.removesuffix(unit)
        size = deviations.get(name, deviations.get(stem))
        if size is not None:
            found[f"{stem}_plus_minus{unit}"] = WITHIN_95_PERCENT * size
    return found


def identified(
    data: IdentificationData,
    request: Request,
    found: FittedHysteresis,
    part: LinearPart,
    synchronous: bool,
    offset: float = 0.0,
) -> Identification:
    """Return the result of an identification; its linear part is also described as figures and text.

    For an input that is held between the samples, lag and delay do not include the delay of the hold.
    """
    if request.intersample == "zoh" and not synchronous:
        part = part.held(data.sample_time)
    numbers, words = part.described()
    numbers |= half_widths(numbers, found.deviations)
    dynamics = part.dynamics(data.sample_time)
    return Identification(
        model=request.model,
        linear=", ".join(words) or "none",
        chain=chain_of(data, request, found.hysteresis, part, dynamics, synchronous, offset),
        fitted=found.fitted + len(words) + 3 * len(part.modes),
        numbers=numbers,
        deviations=dict(found.deviations),
        warnings=tuple(found.warnings),
        converged=found.converged,
    )
