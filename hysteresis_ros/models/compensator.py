# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Hysteresis compensator: voltage and achieved command for a commanded displacement, and the range of commands."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hysteresis_ros.configuration import Parameters, group, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models.actuator import ActuatorParameters
from hysteresis_ros.models.block import Chain, compiled, composite, interpreted, nested
from hysteresis_ros.models.creep import Creep, CreepParameters, creep, creep_inverse
from hysteresis_ros.models.declaration import require_structure
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block
from hysteresis_ros.models.hysteresis.proportional import ProportionalHysteresis, ProportionalParameters
from hysteresis_ros.models.inverses import InverseParameters, tries_model
from hysteresis_ros.models.limits import (
    FLAGS,
    MAXIMUM,
    MINIMUM,
    OUTPUT,
    SLEWING,
    UNQUANTISED,
    Limits,
    LimitsParameters,
    limits,
)


class CompensatorArrays(NamedTuple):
    """Parameter arrays, or state arrays, of a compensator."""

    inverse: np.ndarray
    hysteresis: np.ndarray
    limits: np.ndarray
    out: np.ndarray
    creep: np.ndarray


# Layout of xs.out.
APPLIED = 0  # achieved command: displacement of the model at the limited voltage [m]
BIAS = 1  # decaying voltage that prevents a jump of the output at a retune [V]
COMMAND = 2  # last command [m]

# Layout of ps.out.
DECAY = 0  # decay factor of the bias per sample

#: A bias below this value is set to zero [V].
NEGLIGIBLE_BIAS = 1e-9

#: Fraction of the voltage range by which the search of the inverse ``general`` extends beyond both ends, in order to
#: detect saturation.
SEARCH_MARGIN = 0.1


@dataclass(frozen=True)
class CompensatorParameters(Parameters):
    """Parameters of the hysteresis compensator: its own model of the actuator, never the plant itself."""

    inverse: InverseParameters = group(InverseParameters)
    hysteresis: HysteresisParameters = group(HysteresisParameters)
    creep: CreepParameters = group(CreepParameters)
    limits: LimitsParameters = group(LimitsParameters)
    safe_voltage: float = parameter(
        0.0, description="voltage while stopped, at exit, and after commands are lost", unit="V"
    )
    handover_time: float = parameter(
        0.1,
        description="time constant of the voltage's transition to its new value after a change of parameters or a hold",
        unit="s",
        low=0.0,
    )

    def check(self):
        """Yield a Problem if the safe voltage is out of range, or if the inverse does not fit the model."""
        low, high = self.limits.minimum, self.limits.maximum
        if not low <= self.safe_voltage <= high:
            remedy = f"must lie within limits.minimum … limits.maximum ({low:g} … {high:g} V)"
            yield Problem("safe_voltage", self.safe_voltage, remedy)
        yield from self.inverse.fits(self.hysteresis)


@nested
def compensator_hold(hysteresis, ps, xs, voltage):
    """Output ``voltage`` [V] within the limits, advance the model, and return the output [V]."""
    limited = limits(ps.limits, xs.limits, voltage)
    xs.out[APPLIED] = creep(ps.creep, xs.creep, hysteresis(ps.hysteresis, xs.hysteresis, limited))
    return limited


@nested
def compensator_step(hysteresis, inverse, ps, xs, command):
    """Return the voltage [V] for the displacement ``command`` [m]; ``xs.out[APPLIED]`` is the achieved command.

    ``ps`` and ``xs`` are :class:`CompensatorArrays`.
    """
    out = xs.out
    out[COMMAND] = command
    displacement = creep_inverse(ps.creep, xs.creep, command)
    voltage = inverse(hysteresis, ps.inverse, xs.inverse, ps.hysteresis, xs.hysteresis, displacement)
    bias = out[BIAS]
    if bias != 0.0:
        voltage += bias
        bias *= ps.out[DECAY]
        out[BIAS] = bias if abs(bias) > NEGLIGIBLE_BIAS else 0.0
    limited = limits(ps.limits, xs.limits, voltage)
    out[APPLIED] = creep(ps.creep, xs.creep, hysteresis(ps.hysteresis, xs.hysteresis, limited))
    return limited


@nested
def compensator_resume(hysteresis, inverse, ps, xs, command):
    """Let the next voltage, for ``command`` [m], start at the present voltage; the bias contains the difference."""
    out, limited = xs.out, xs.limits
    out[COMMAND] = command
    out[BIAS] = 0.0
    if int(limited[FLAGS]) & SLEWING:
        return  # the slew rate prevents a jump of the voltage
    wanted = creep_inverse(ps.creep, xs.creep, command)
    now = inverse(hysteresis, ps.inverse, xs.inverse, ps.hysteresis, xs.hysteresis, wanted)
    last = limited[UNQUANTISED]
    if (now >= ps.limits[MAXIMUM] and last >= ps.limits[MAXIMUM]) or (
        now <= ps.limits[MINIMUM] and last <= ps.limits[MINIMUM]
    ):
        return  # both voltages are at the same end of the range
    if abs(last - now) > NEGLIGIBLE_BIAS:
        out[BIAS] = last - now


@composite("void", "kernel", "inverse", CompensatorArrays, CompensatorArrays, "array", "array")
def run_compensator(hysteresis, inverse, ps, xs, commands, voltages):
    """Set ``voltages[k]`` [V] to :func:`compensator_step` of ``commands[k]`` [m] for every k."""
    for k in range(commands.shape[0]):
        voltages[k] = compensator_step(hysteresis, inverse, ps, xs, commands[k])


def inverse_step(inverse):
    """Return the form of an inverse that Python calls once per sample; its arguments are those of every inverse.

    A kernel passed from Python would become part of the type of the called function. Numba cannot cache such a
    function, so every process would compile it again. Therefore an inverse that evaluates the model's kernel gets it as
    a first-class function; a closed form gets a number instead.
    """
    if tries_model(inverse):
        return compiled(inverse)
    return lambda hysteresis, *arguments: inverse(0.0, *arguments)


class Compensator(Chain):
    """Inverse of a hysteresis model, with the limits of the amplifier.

    Composites use ``ps``, ``xs``, ``hysteresis_kernel`` and ``inverse_kernel`` directly. With the inverse ``none``, the
    model is proportional, with the nominal gain of the configured model.

    Parameters
    ----------
    parameters : CompensatorParameters
        Parameters, checked on construction.
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        Parameters are wrong; the message states each wrong parameter.
    """

    def __init__(self, parameters: CompensatorParameters, sample_time: float):
        self.parameters = parameters.validated()
        self.sample_time = float(sample_time)
        self.limits = Limits(parameters.limits, sample_time)
        self.hysteresis = self._model(parameters)
        self.hysteresis_kernel = self.hysteresis.kernel
        self.creep = Creep(self._creep(parameters), sample_time)
        inverse = parameters.inverse.kernel(self.hysteresis)
        self.inverse_kernel = compiled(inverse) if tries_model(inverse) else inverse
        self.inverse_step = inverse_step(inverse)
        self.ps = CompensatorArrays(
            self._pack_inverse(), self.hysteresis.p, self.limits.p, self._pack_out(), self.creep.p
        )
        own = parameters.inverse.own_block(self.sample_time)
        scratch = np.zeros(max(len(self.hysteresis.x) + 2, 0 if own is None else len(own.x)))
        self.xs = CompensatorArrays(scratch, self.hysteresis.x, self.limits.x, np.zeros(3), self.creep.x)
        self._settle()

    def _model(self, parameters: CompensatorParameters):
        model = hysteresis_block(parameters.hysteresis, self.sample_time)
        if parameters.inverse.type == "none":
            return ProportionalHysteresis(ProportionalParameters(gain=model.gain), self.sample_time)
        return model

    def _creep(self, parameters: CompensatorParameters) -> CreepParameters:
        return CreepParameters() if parameters.inverse.type == "none" else parameters.creep

    def _pack_inverse(self) -> np.ndarray:
        own, limits = self.parameters.inverse.own_block(self.sample_time), self.parameters.limits
        if own is not None:
            return own.p
        margin = SEARCH_MARGIN * (limits.maximum - limits.minimum)
        return self.parameters.inverse.packed(self.hysteresis.gain, limits.minimum - margin, limits.maximum + margin)

    def _pack_out(self) -> np.ndarray:
        time = self.parameters.handover_time
        return np.array([elementary.exp(-self.sample_time / time) if time > 0.0 else 0.0])

    def _settle(self) -> None:
        out = self.xs.out
        out[:] = 0.0
        out[APPLIED] = out[COMMAND] = self.creep.settle(self.hysteresis.step(self.limits.x[OUTPUT]))
        own = self.parameters.inverse.own_block(self.sample_time)
        self.xs.inverse[:] = 0.0
        if own is not None:
            self.xs.inverse[: len(own.x)] = own.x

    def step(self, command: float) -> float:
        """Return the voltage [V] for the displacement ``command`` [m] of the hysteresis element."""
        return interpreted(compensator_step)(
            self.hysteresis_kernel, self.inverse_step, self.ps, self.xs, float(command)
        )

    def simulate(self, commands) -> np.ndarray:
        """Return the voltages [V], shape (N,), for displacements [m]; the state continues from the previous call."""
        commands = np.ascontiguousarray(commands, dtype=np.float64)
        voltages = np.empty_like(commands)
        if tries_model(interpreted(self.inverse_kernel)):
            run = compiled(run_compensator)
            run(self.hysteresis_kernel, self.inverse_kernel, self.ps, self.xs, commands, voltages)
            return voltages
        for k, command in enumerate(commands):
            voltages[k] = self.step(command)
        return voltages

    def hold(self, voltage: float) -> float:
        """Output a given voltage [V], such as the safe voltage, within the limits; the model follows this voltage."""
        return interpreted(compensator_hold)(self.hysteresis_kernel, self.ps, self.xs, float(voltage))

    @property
    def command(self) -> float:
        """Last command [m]."""
        return float(self.xs.out[COMMAND])

    @property
    def applied(self) -> float:
        """Displacement [m] of the model at the last output voltage."""
        return float(self.xs.out[APPLIED])

    @property
    def voltage(self) -> float:
        """Last output voltage [V]."""
        return float(self.limits.x[OUTPUT])

    @property
    def saturated(self) -> bool:
        """Whether the range or the slew rate limited the last voltage."""
        return self.limits.saturated

    def reset(self) -> None:
        """Return to rest, with the model in its initial state."""
        self.limits.reset()
        self.hysteresis.reset()
        self._settle()

    def retune(self, parameters: CompensatorParameters) -> None:
        """Change to parameters of the same structure while running, without a jump of the voltage.

        The model continues from the present point (``rebase``). For the last command, the remaining change of the
        voltage becomes a bias that decays with ``handover_time``.

        Raises
        ------
        ParameterError
            The parameters are wrong or of another structure; the compensator then remains unchanged.
        """
        parameters = parameters.validated()
        parameters.hysteresis.require_same(self.parameters.hysteresis)
        parameters.inverse.require_same(self.parameters.inverse)
        require_structure(self.parameters.creep, parameters.creep)
        model = self._model(parameters)
        self.parameters = parameters
        self.limits.retune(parameters.limits)
        self.hysteresis.retune(model.parameters)
        self.creep.retune(self._creep(parameters))
        self.ps.inverse[:] = self._pack_inverse()
        self.ps.out[:] = self._pack_out()
        self.resume(self.xs.out[COMMAND])

    def resume(self, command: float) -> None:
        """Let the next voltage, for ``command`` [m], start at the present voltage.

        The present voltage may be the safe voltage, after :meth:`hold`. The difference decays with ``handover_time``.
        """
        interpreted(compensator_resume)(self.hysteresis_kernel, self.inverse_step, self.ps, self.xs, float(command))


#: Number of samples in one sweep of the voltage.
SWEEP = 257
#: Fraction of an identified actuator's range that references use.
USED = 0.95


@lru_cache(maxsize=64)
def _sweep(hysteresis: HysteresisParameters, low: float, high: float, sample_time: float) -> tuple[float, float]:
    block = hysteresis_block(hysteresis, sample_time)
    reached = []
    for voltages in _swept(low, high):
        block.reset()
        reached.append(block.simulate(voltages))
    return float(np.min(reached)), float(np.max(reached))


@lru_cache(maxsize=8)
def _swept(low: float, high: float) -> tuple[np.ndarray, ...]:
    """Return voltages [V] from zero to one end, to the other end and back; and the same with the ends exchanged."""
    start = min(max(0.0, low), high)
    return tuple(
        np.concatenate([np.linspace(a, b, SWEEP) for a, b in zip(ends, ends[1:], strict=False)])
        for ends in ((start, high, low, high), (start, low, high, low))
    )


def reachable_commands(compensator: CompensatorParameters, sample_time: float) -> tuple[float, float]:
    """Return the smallest and largest displacement [m] that the compensator can reach at rest; ``sample_time`` [s]."""
    linear = compensator.inverse.type == "none"
    return _reached(compensator.hysteresis, compensator.limits, sample_time, linear)


def returned_commands(compensator: CompensatorParameters, sample_time: float) -> tuple[float, float]:
    """Return the smallest and largest displacement [m], each reached from the opposite end of the voltage range.

    An actuator with hysteresis does not return to its zero, so the first motion from zero has a larger range. Units:
    ``sample_time`` [s].
    """
    if compensator.inverse.type == "none":
        return reachable_commands(compensator, sample_time)
    low, high = compensator.limits.minimum, compensator.limits.maximum
    way = np.concatenate([np.linspace(a, b, SWEEP) for a, b in ((low, high), (high, low), (low, high))])
    reached = hysteresis_block(compensator.hysteresis, sample_time).simulate(way)
    ends = float(reached[2 * SWEEP - 1]), float(reached[-1])
    return min(ends), max(ends)


def commandable(compensator: CompensatorParameters, sample_time: float, *amplifiers: LimitsParameters):
    """Return the smallest and the largest useful command [m] of the compensator.

    These commands are one stroke beyond either end of the compensator's range, because fast steps and inverse dynamics
    briefly need more than the range. Beyond them, the voltage no longer changes. ``amplifiers`` contains limits to
    which a user may widen the compensator's limits while the axis runs. Units: ``sample_time`` [s].
    """
    ranges = compensator.limits, *amplifiers
    widest = LimitsParameters(
        minimum=min(limits.minimum for limits in ranges), maximum=max(limits.maximum for limits in ranges)
    )
    low, high = _reached(compensator.hysteresis, widest, sample_time, compensator.inverse.type == "none")
    return low - (high - low), high + (high - low)


def _reached(hysteresis: HysteresisParameters, limits: LimitsParameters, sample_time: float, linear: bool = False):
    block = hysteresis_block(hysteresis, sample_time)
    if linear or not block.invertible:
        ends = block.gain * limits.minimum, block.gain * limits.maximum
        return min(ends), max(ends)
    return _sweep(hysteresis, limits.minimum, limits.maximum, sample_time)


def resting_displacements(actuator: ActuatorParameters, sample_time: float) -> tuple[float, float]:
    """Return the smallest and largest displacement [m] of the actuator at rest, with preload, without creep."""
    dynamics = actuator.dynamics
    gain = dynamics.dc_gain * dynamics.output_scale / dynamics.resolved_input_scale
    ends = [gain * end for end in _reached(actuator.hysteresis, actuator.limits, sample_time)]
    return min(ends) + actuator.preload.offset, max(ends) + actuator.preload.offset
