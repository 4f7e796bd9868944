# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Evaluation of a campaign: the axis under test, the bounds of its figures, the observations, and violated claims."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.laboratory.campaign.mishaps import COMMAND, DEVICE, FUSED, MEASUREMENT, VOLTAGE, Mishap
from hysteresis_ros.loop.parameters import MESSAGE_RATE, AxisParameters
from hysteresis_ros.loop.reach import single_axis

#: Time in which the voltage may cross its whole range if the configuration sets no slew rate [s].
CROSSING = 0.25
#: Setpoints, as fractions of the range from the lowest to the highest reference.
LOW, HIGH = 0.2, 0.8
#: Fraction of the stroke by which the displacement may leave the range between rest and setpoints. While voltages are
#: late and the plant has not yet tripped, the axis may in addition continue to move at the slew rate.
BEYOND = 0.1
#: Fraction of the stroke within which a setpoint counts as reached.
REACHED = 0.02
#: Fraction of the range within which a voltage counts as safe.
SAFE = 0.01
#: Additional time that a busy machine may need [s].
SLACK = 0.5


@dataclass(frozen=True)
class Bounds:
    """Bounds of the figures of an axis; all times are wall-clock times."""

    minimum: float  #: minimum, maximum, safe: Limits of the voltage, and the safe voltage [V].
    maximum: float
    safe: float
    step: float  #: Largest change of the voltage between two samples [V], including one bit of the converter.
    sample_time: float  #: Sample time on the clock of the stamps [s].
    low: float  #: low, high: Setpoints [m].
    high: float
    stroke: float  #: Range from the lowest to the highest reference [m].
    #: Longest time until the voltage is safe [s], for each name in
    #: :data:`hysteresis_ros.laboratory.campaign.mishaps.TIMEOUTS`.
    timeouts: dict[str, float]
    #: Largest distance of the displacement from the range between rest and setpoints, as a fraction of the stroke.
    beyond: float


def at_rate(configuration: Configuration, rate: float) -> Configuration:
    """Return a configuration with another sample rate [Hz] (0: unchanged) and the same dynamics per sample.

    Time-outs stay the same in seconds, because the campaign tests the reaction of the nodes to time.
    """
    if not rate:
        return configuration
    configuration = configuration.override("", sample_rate=rate)
    configuration = configuration.override("plant_simulator", dynamics__sample_time=0.0)
    return configuration.override("motion_controller", model__dynamics__sample_time=0.0)


def prepared(configuration: Configuration, way: str, namespace: str) -> AxisParameters:
    """Return the axis for a campaign: with a simulated plant, setpoints as reference, and a limited slew rate."""
    mode = "fused" if way == FUSED else "realtime"
    simulated = configuration.override("", time_mode=mode, autostart=True, exit_at_end=True, external_plant=False)
    simulated = simulated.override("plant_simulator", driver="", real_time_factor=1.0)
    axis = single_axis(simulated.override("reference_generator", waveform__type="hold"))
    axis.require_generator(
        f"{configuration.source}: describes an inchworm motor; give the configuration of a single actuator"
    )
    plant = axis.plant_simulator
    span = plant.limits.maximum - plant.limits.minimum
    slew = plant.limits.slew_rate or span / CROSSING
    limits = {"limits__slew_rate": slew, "safe_slew_rate": min(plant.safe_slew_rate, slew)}
    factor = 1.0 if way == FUSED else min(MESSAGE_RATE / plant.sample_rate, 1.0)
    simulated = simulated.override("reference_generator", waveform__type="hold")
    # the plant must trip like a device, even if the file allows more late samples in a simulation
    simulated = simulated.override("plant_simulator", real_time_factor=factor, late_limit=0, **limits)
    simulated = simulated.override("hysteresis_compensator", **limits)
    return replace(single_axis(simulated), namespace=namespace)


def bounds_of(axis: AxisParameters) -> Bounds:
    """Return the bounds of a prepared axis."""
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
    """Observed samples of the plant."""

    time: np.ndarray  #: shape (N,); Time of observation [s], on the common clock.
    stamp: np.ndarray  #: shape (N,); Stamp of the sample [s].
    voltage: np.ndarray  #: voltage, displacement: shape (N,); Output voltage [V] and displacement [m] of the plant.
    displacement: np.ndarray
    #: shape (N,); Number of restarts of the plant; the slew rate is not limited across a restart.
    life: np.ndarray

    @classmethod
    def of(cls, rows) -> Samples:
        """Return the samples from rows with the values of these five fields."""
        table = np.array([tuple(row) for row in rows], dtype=np.float64).reshape(-1, 5).T
        return cls(*table)

    def between(self, begun: float, ended: float) -> Samples:
        """Return the samples observed in an interval.

        Units: ``begun`` [s], ``ended`` [s].
        """
        within = (self.time >= begun) & (self.time <= ended)
        columns = (self.time, self.stamp, self.voltage, self.displacement, self.life)
        return Samples(*(column[within] for column in columns))


@dataclass(frozen=True)
class Trace:
    """Record of one fault case that was executed once, in one way of running."""

    mishap: str
    way: str
    amount: float  #: Amount of the action.
    load: float  #: Load of the machine (runnable processes).
    #: begun, ended, recovered: Begin and end of the fault, and time at which the axis followed a setpoint again [s];
    #: NaN: it did not.
    begun: float
    ended: float
    recovered: float
    asked: tuple[float, float]  #: Lowest and highest setpoint, including the rest position [m].
    samples: Samples  #: Samples from the beginning of the fault to the recovery.
    #: Other violations: processes that died, tracebacks, unanswered calls.
    broken: tuple[str, ...] = ()
    said: str = ""  #: Most severe message of the nodes on ``/diagnostics``.
    notes: tuple[str, ...] = ()  #: Notes for the table.

    def with_samples(self, samples: Samples) -> Trace:
        """Return the record with the samples of a recording instead of the observed samples."""
        last = self.recovered if np.isfinite(self.recovered) else np.inf
        return replace(self, samples=samples.between(self.begun, last))


#: Largest difference between the safe voltage and the voltage that the inverse calculates for a safe command [fraction
#: of the range].
COMMANDED = 0.1
#: Tolerance of comparisons, for rounding errors.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Figures:
    """Figures of a fault case: those of one execution, or the worst of several."""

    lowest: float  #: lowest, highest: Output voltages of the plant [V].
    highest: float
    step: float  #: Ratio of the largest change of the voltage between two samples to the allowed change.
    #: Largest distance of the displacement from the range between rest and setpoints, as a fraction of the stroke.
    beyond: float
    #: Time from the beginning of the fault until the voltage was safe and stayed so [s]; NaN: not required; infinite:
    #: never.
    safe: float
    recovery: float  #: Time from the end of the fault until the axis followed a setpoint again [s]; infinite: never.


@dataclass(frozen=True)
class Verdict:
    """Figures of a fault case and its violated claims."""

    trace: Trace
    figures: Figures
    failures: tuple[str, ...]  #: Violated claims; empty: all claims held.


def largest_step(samples: Samples, bounds: Bounds, stalls: bool = False) -> float:
    """Return the largest ratio of the voltage's change between two samples to the change allowed in that time."""
    if samples.time.size < 2:
        return 0.0
    follow = np.diff(samples.life) == 0
    passed = np.maximum(np.diff(samples.stamp), np.diff(samples.time) if stalls else 0.0)
    periods = np.maximum(np.round(passed / bounds.sample_time), 1.0)
    steps = np.abs(np.diff(samples.voltage)) / (periods * bounds.step)
    return float(np.max(steps[follow], initial=0.0))


def time_to_safe(samples: Samples, begun: float, ended: float, bounds: Bounds, part: float = SAFE) -> float:
    """Return the time until the voltage is safe and stays so until the end [s]; infinite: never."""
    inside = samples.between(begun, ended)
    if not inside.time.size:
        return math.inf
    unsafe = np.abs(inside.voltage - bounds.safe) > part * (bounds.maximum - bounds.minimum)
    if unsafe[-1]:
        return math.inf
    last = np.flatnonzero(unsafe)
    return float(inside.time[last[-1] + 1] - begun) if last.size else 0.0


def judged(trace: Trace, mishap: Mishap, bounds: Bounds) -> Verdict:
    """Return the figures of a fault case and its violated claims."""
    samples = trace.samples
    voltage = samples.voltage if samples.time.size else np.array([math.nan])
    low, high = trace.asked
    places = samples.displacement[np.isfinite(samples.displacement)]  # the true displacement of a device is unknown
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
    """Yield the violated claims."""
    yield from trace.broken
    if not trace.samples.time.size:
        yield "no samples of the plant were observed"
        return
    small = ROUNDING * (bounds.maximum - bounds.minimum)
    if not (bounds.minimum - small <= figures.lowest and figures.highest <= bounds.maximum + small):
        allowed = f"{bounds.minimum:g} … {bounds.maximum:g} V"
        yield f"voltages of {figures.lowest:.4g} … {figures.highest:.4g} V exceed {allowed}"
    if not figures.step <= 1.0 + 1e-6:
        yield f"the largest step of the voltage is {figures.step:.3g} times the allowed one"
    if mishap.bounded and not figures.beyond <= bounds.beyond:
        yield f"the displacement exceeds the setpoints by {100.0 * figures.beyond:.2g} % of the stroke"
    if mishap.safe and not figures.safe <= bounds.timeouts[mishap.safe]:
        yield f"safe after {figures.safe:.3g} s, at most {bounds.timeouts[mishap.safe]:.3g} s is allowed"
    if not math.isfinite(figures.recovery):
        yield "the axis does not follow setpoints again"


def worst(verdicts: list[Verdict]) -> Figures:
    """Return the worst figures of several verdicts."""
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
