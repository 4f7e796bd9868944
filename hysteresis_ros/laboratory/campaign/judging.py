# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Judging of a campaign: its axis with the bounds of its figures, what was seen, and what did not hold."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.laboratory.campaign.mishaps import COMMAND, DEVICE, FUSED, MEASUREMENT, VOLTAGE, Mishap
from hysteresis_ros.loop.parameters import MESSAGE_RATE, AxisParameters
from hysteresis_ros.loop.reach import single_axis

#: Seconds of the axis in which the voltage may cross its range, where the configuration sets no slew rate.
CROSSING = 0.25
#: Where the axis is sent, as parts of the way from its lowest to its highest reference.
LOW, HIGH = 0.2, 0.8
#: Part of the stroke by which the displacement may leave the places between rest and what was asked for, beside what
#: the slew rate allows while voltages are late and the plant does not trip yet.
BEYOND = 0.1
#: Part of the stroke within which a setpoint is reached.
REACHED = 0.02
#: Part of the range within which a voltage is safe.
SAFE = 0.01
#: What a machine with other work may take longer [s].
SLACK = 0.5


@dataclass(frozen=True)
class Bounds:
    """What the figures of an axis must stay within; times are those of the wall clock."""

    minimum: float  #: minimum, maximum, safe: Voltages [V]: limits, and the safe one.
    maximum: float
    safe: float
    step: float  #: Largest change of the voltage between two samples [V], one bit of the converter included.
    sample_time: float  #: Between two samples, in the axis' own time, that of the stamps [s].
    low: float  #: low, high: Where the axis is sent [m].
    high: float
    stroke: float  #: From the lowest to the highest reference [m].
    #: Of :data:`hysteresis_ros.laboratory.campaign.mishaps.TIMEOUTS` [s], the voltage's return to safe included.
    timeouts: dict[str, float]
    #: So far the displacement may leave the places between rest and what was asked for, as a part of the stroke.
    beyond: float


def at_rate(configuration: Configuration, rate: float) -> Configuration:
    """Return a configuration at another sample rate [Hz], 0: its own; its dynamics are the same from sample to sample.

    What is tried is what the nodes do about time: the time-outs stay what they are in seconds.
    """
    if not rate:
        return configuration
    configuration = configuration.override("", sample_rate=rate)
    configuration = configuration.override("plant_simulator", dynamics__sample_time=0.0)
    return configuration.override("motion_controller", model__dynamics__sample_time=0.0)


def prepared(configuration: Configuration, way: str, namespace: str) -> AxisParameters:
    """Return the axis of a configuration as a campaign runs it: simulated, held at setpoints, its slew rate limited."""
    mode = "fused" if way == FUSED else "realtime"
    simulated = configuration.override("", time_mode=mode, autostart=True, exit_at_end=True, external_plant=False)
    simulated = simulated.override("plant_simulator", driver="", real_time_factor=1.0)
    axis = single_axis(simulated.override("reference_generator", waveform__type="hold"))
    if axis.reference_generator is None:
        raise ConfigurationError(f"{configuration.source}: an inchworm motor; a campaign is for axes of one actuator")
    plant = axis.plant_simulator
    span = plant.limits.maximum - plant.limits.minimum
    slew = plant.limits.slew_rate or span / CROSSING
    limits = {"limits__slew_rate": slew, "safe_slew_rate": min(plant.safe_slew_rate, slew)}
    factor = 1.0 if way == FUSED else min(MESSAGE_RATE / plant.sample_rate, 1.0)
    simulated = simulated.override("reference_generator", waveform__type="hold")
    # the plant trips as a device would, also where the file allows its simulated one more late samples
    simulated = simulated.override("plant_simulator", real_time_factor=factor, late_limit=0, **limits)
    simulated = simulated.override("hysteresis_compensator", **limits)
    return replace(single_axis(simulated), namespace=namespace)


def bounds_of(axis: AxisParameters) -> Bounds:
    """Return what the figures of a prepared axis must stay within."""
    plant, source, compensator = axis.plant_simulator, axis.reference_generator, axis.hysteresis_compensator
    assert source is not None
    limits, factor = plant.limits, plant.real_time_factor
    span, stroke = limits.maximum - limits.minimum, source.maximum - source.minimum
    bit = span / 2**limits.bits if limits.bits else 0.0
    back, controller = span / plant.safe_slew_rate, axis.motion_controller
    waits = {
        MEASUREMENT: controller.measurement_timeout + stroke / controller.safe_slew_rate,
        COMMAND: compensator.command_timeout,
        VOLTAGE: plant.voltage_timeout,
    }
    return Bounds(
        limits.minimum,
        limits.maximum,
        plant.safe_voltage,
        max(limits.slew_rate, plant.safe_slew_rate) / plant.sample_rate + bit,
        1.0 / plant.sample_rate,
        source.minimum + LOW * stroke,
        source.minimum + HIGH * stroke,
        stroke,
        {name: (wait + back) / factor + SLACK for name, wait in waits.items()},
        BEYOND + plant.allowed_late / plant.sample_rate * limits.slew_rate / span,
    )


@dataclass(frozen=True)
class Samples:
    """What the plant did."""

    time: np.ndarray  #: shape (N,); When it was seen [s], on one clock with everything else.
    stamp: np.ndarray  #: shape (N,); Of the sample [s].
    voltage: np.ndarray  #: voltage, displacement: shape (N,); What the plant put out [V], and where it was [m].
    displacement: np.ndarray
    #: shape (N,); Which life of the plant it is: one that begins again knows nothing of the voltage before.
    life: np.ndarray

    @classmethod
    def of(cls, rows) -> Samples:
        """Return the samples of rows with these five numbers."""
        table = np.array([tuple(row) for row in rows], dtype=np.float64).reshape(-1, 5).T
        return cls(*table)

    def between(self, begun: float, ended: float) -> Samples:
        """Return those that were seen in a time.

        Units: ``begun`` [s], ``ended`` [s].
        """
        within = (self.time >= begun) & (self.time <= ended)
        columns = (self.time, self.stamp, self.voltage, self.displacement, self.life)
        return Samples(*(column[within] for column in columns))


@dataclass(frozen=True)
class Trace:
    """One mishap, once, in one way of running."""

    mishap: str
    way: str
    amount: float  #: Of what was done.
    load: float  #: Of the machine meanwhile, processes that want to run.
    #: begun, ended, recovered: When it began and ended, and when the axis followed a setpoint again [s]; NaN: it did
    #: not.
    begun: float
    ended: float
    recovered: float
    asked: tuple[float, float]  #: Lowest and highest place that was asked for, rest included [m].
    samples: Samples  #: From a moment before until the recovery.
    #: What else did not happen as it must: processes that died, tracebacks, calls without an answer.
    broken: tuple[str, ...] = ()
    said: str = ""  #: The gravest that the nodes said of themselves on ``/diagnostics``.
    notes: tuple[str, ...] = ()  #: What a reader of the table should know.

    def with_samples(self, samples: Samples) -> Trace:
        """Return the same with what a recording holds in the place of what was seen."""
        last = self.recovered if np.isfinite(self.recovered) else np.inf
        return replace(self, samples=samples.between(self.begun, last))


#: A safe command is not quite a safe voltage: so far from it may the inverse of the hysteresis be [part of the range].
COMMANDED = 0.1
#: Rounding of numbers that are compared.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Figures:
    """What a mishap came to, once or at worst."""

    lowest: float  #: lowest, highest: Voltages that the plant put out [V].
    highest: float
    step: float  #: Largest change between two samples, as a part of what is allowed.
    #: How far the displacement left the places between rest and what was asked for, as a part of the stroke.
    beyond: float
    #: Time from the beginning until the voltage was safe and stayed so [s]; NaN where it need not be, infinite where
    #: it was not.
    safe: float
    recovery: float  #: Time from the end until the axis followed a setpoint again [s]; infinite: it did not.


@dataclass(frozen=True)
class Verdict:
    """What a mishap came to, and what of its claims did not hold."""

    trace: Trace
    figures: Figures
    failures: tuple[str, ...]  #: Empty: all held.


def largest_step(samples: Samples, bounds: Bounds, stalls: bool = False) -> float:
    """Return the largest change of the voltage as a part of what is allowed in the time between two samples."""
    if samples.time.size < 2:
        return 0.0
    follow = np.diff(samples.life) == 0
    passed = np.maximum(np.diff(samples.stamp), np.diff(samples.time) if stalls else 0.0)
    periods = np.maximum(np.round(passed / bounds.sample_time), 1.0)
    steps = np.abs(np.diff(samples.voltage)) / (periods * bounds.step)
    return float(np.max(steps[follow], initial=0.0))


def time_to_safe(samples: Samples, begun: float, ended: float, bounds: Bounds, part: float = SAFE) -> float:
    """Return the time from the beginning until the voltage is safe and stays so until the end [s]; infinite: never."""
    inside = samples.between(begun, ended)
    if not inside.time.size:
        return math.inf
    unsafe = np.abs(inside.voltage - bounds.safe) > part * (bounds.maximum - bounds.minimum)
    if unsafe[-1]:
        return math.inf
    last = np.flatnonzero(unsafe)
    return float(inside.time[last[-1] + 1] - begun) if last.size else 0.0


def judged(trace: Trace, mishap: Mishap, bounds: Bounds) -> Verdict:
    """Return what a mishap came to."""
    samples = trace.samples
    voltage = samples.voltage if samples.time.size else np.array([math.nan])
    low, high = trace.asked
    places = samples.displacement[np.isfinite(samples.displacement)]  # of a device nobody may know it
    excess = np.maximum(places - high, low - places)
    beyond = float(np.max(excess, initial=0.0)) / bounds.stroke
    safe = math.nan
    if mishap.safe:
        part = COMMANDED if mishap.safe == MEASUREMENT else SAFE
        safe = time_to_safe(samples, trace.begun, trace.ended, bounds, part)
    recovery = trace.recovered - trace.ended if math.isfinite(trace.recovered) else math.inf
    figures = Figures(
        float(np.min(voltage)),
        float(np.max(voltage)),
        largest_step(samples, bounds, mishap.graph == DEVICE),
        beyond,
        safe,
        recovery,
    )
    return Verdict(trace, figures, tuple(_failures(figures, trace, mishap, bounds)))


def _failures(figures: Figures, trace: Trace, mishap: Mishap, bounds: Bounds):
    """Yield what did not hold."""
    yield from trace.broken
    if not trace.samples.time.size:
        yield "nothing was seen of the plant"
        return
    small = ROUNDING * (bounds.maximum - bounds.minimum)
    if not (bounds.minimum - small <= figures.lowest and figures.highest <= bounds.maximum + small):
        allowed = f"{bounds.minimum:g} … {bounds.maximum:g} V"
        yield f"voltages of {figures.lowest:.4g} … {figures.highest:.4g} V leave {allowed}"
    if not figures.step <= 1.0 + 1e-6:
        yield f"a step of the voltage is {figures.step:.3g} times what the slew rate allows"
    if mishap.bounded and not figures.beyond <= bounds.beyond:
        yield f"the displacement goes {100.0 * figures.beyond:.2g} % of the stroke beyond what was asked for"
    if mishap.safe and not figures.safe <= bounds.timeouts[mishap.safe]:
        yield f"safe after {figures.safe:.3g} s, {bounds.timeouts[mishap.safe]:.3g} s are allowed"
    if not math.isfinite(figures.recovery):
        yield "the axis does not follow setpoints again"


def worst(verdicts: list[Verdict]) -> Figures:
    """Return the worst figures of several."""
    found = [verdict.figures for verdict in verdicts]
    safe = [figures.safe for figures in found if not math.isnan(figures.safe)]
    return Figures(
        min(figures.lowest for figures in found),
        max(figures.highest for figures in found),
        max(figures.step for figures in found),
        max(figures.beyond for figures in found),
        max(safe, default=math.nan),
        max(figures.recovery for figures in found),
    )
