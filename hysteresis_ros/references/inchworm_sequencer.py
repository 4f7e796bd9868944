"""Inchworm sequencer: setpoints in millimetres to clamp voltages and the extender's reference.

It takes the reference generator's place. The motion controller's measurement is the slider less :attr:`origin`: while
the motor walks that is the extender's own displacement, in fine positioning the slider's, and while both clamps hold it
is the reference itself, because nothing can move then and an integral would only wind up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros import elementary
from hysteresis_ros.block import Block
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.parameters import Parameters, group, parameter
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references.gait import GaitParameters
from hysteresis_ros.references.inchworm_machine import sequence
from hysteresis_ros.references.step_model import GAIN, OFFSET, forget_all


@dataclass(frozen=True)
class FineParameters(Parameters):
    """Fine positioning: the front clamp holds the slider, the controller measures the slider."""

    enabled: bool = parameter(
        True, read_only=True, description="finish on the extender in closed loop; false: on steps, with both clamps"
    )
    tolerance: float = parameter(
        10.0e-9,
        unit="m",
        low=1.0e-12,
        high=1.0,
        read_only=True,
        description="distance to the setpoint (smoothed) at which the motor has arrived",
    )
    speed: float = parameter(
        1.0e-3, unit="m/s", low=1.0e-12, high=1.0, read_only=True, description="highest speed of the reference"
    )
    time: float = parameter(
        2.0e-3,
        unit="s",
        low=1.0e-6,
        high=100.0,
        read_only=True,
        description="time constant of the reference's critically damped approach",
    )
    timeout: float = parameter(
        0.5,
        unit="s",
        low=1.0e-3,
        high=1.0e4,
        read_only=True,
        description="time outside of the tolerance after which the motor grips anew and tries again",
    )
    smoothing_time: float = parameter(
        5.0e-3,
        unit="s",
        low=0.0,
        high=100.0,
        read_only=True,
        description="time constant of the smoothing of the distance to the setpoint and of the slip",
    )


def _model(default: float, which: str, unit: str = ""):
    return parameter(default, unit=unit, low=-2.0, high=2.0, read_only=True, description=which)


@dataclass(frozen=True)
class LearningParameters(Parameters):
    """Learned step length: movement of the slider = gain · extension + offset, for either direction."""

    enabled: bool = parameter(True, read_only=True, description="learn from the measured steps")
    forgetting: float = parameter(
        0.98,
        low=0.5,
        high=1.0,
        read_only=True,
        description="weight of the past at each step (least squares)",
    )
    forward_gain: float = _model(1.0, "gain to start from, forward")
    forward_offset: float = _model(0.0, "offset to start from, forward; negative: a load holds back", "m")
    backward_gain: float = _model(1.0, "gain to start from, backward")
    backward_offset: float = _model(0.0, "offset to start from, backward, along the motion", "m")
    load_deflection: float = _model(0.0, "deflection of the extender by the load to start from", "m")


@dataclass(frozen=True)
class GuardParameters(Parameters):
    """What counts as a fault."""

    still_steps: int = parameter(
        5, low=1, high=1000, read_only=True, description="steps in a row without motion after which the motor gives up"
    )
    missed_part: float = parameter(
        0.5,
        low=0.1,
        high=0.99,
        read_only=True,
        description="a step is missed when the slider moves by less than this part of the extension",
    )
    runaway: float = parameter(
        2.0e-6,
        unit="m",
        low=1.0e-12,
        high=1.0,
        read_only=True,
        description="motion of a held slider, or beyond what a step can do, that is an error",
    )
    slip: float = parameter(
        1.0e-6,
        unit="m",
        low=1.0e-12,
        high=1.0,
        read_only=True,
        description="slip of the front clamp in fine positioning after which the motor grips anew",
    )
    drift: float = parameter(
        2.0e-8,
        unit="m/s",
        low=0.0,
        high=1.0,
        read_only=True,
        description="slower than this the grip of the front clamp only seems to slip: sensors drift and creep",
    )
    sensor_timeout: float = parameter(
        1.0e-3,
        unit="s",
        low=0.0,
        high=10.0,
        read_only=True,
        description="time without a finite measurement after which both clamps close",
    )


@dataclass(frozen=True)
class ScheduleParameters(Parameters):
    """Setpoints over time, so that a run needs no hands."""

    values: tuple[float, ...] = parameter((), unit="m", read_only=True, description="setpoints; empty: none")
    times: tuple[float, ...] = parameter(
        (), unit="s", low=0.0, read_only=True, description="when each of them is given, in rising order"
    )
    duration: float = parameter(
        0.0, unit="s", low=0.0, read_only=True, description="length of a run; 0: the configuration does not say"
    )

    def check(self):
        """There are as many times as values, in rising order."""
        if len(self.times) != len(self.values):
            yield Problem("times", self.times, f"must be {len(self.values)} numbers, one for each of values")
        elif any(later <= earlier for earlier, later in zip(self.times, self.times[1:], strict=False)):
            yield Problem("times", self.times, "must rise from one to the next")


@dataclass(frozen=True)
class InchwormSequencerParameters(Parameters):
    """Parameters of the inchworm sequencer."""

    minimum: float = parameter(-5.0e-3, description="lowest setpoint", unit="m", read_only=True)
    maximum: float = parameter(5.0e-3, description="highest setpoint", unit="m", read_only=True)
    initial_setpoint: float = parameter(
        0.0, description="setpoint until the first one is received", unit="m", read_only=True
    )
    home_position: float = parameter(0.0, description="where the service home goes", unit="m", read_only=True)
    resting_extension: float = parameter(
        0.0, description="extension after release, with the front clamp open", unit="m", read_only=True
    )
    gait: GaitParameters = group(GaitParameters)
    fine: FineParameters = group(FineParameters)
    learning: LearningParameters = group(LearningParameters)
    guard: GuardParameters = group(GuardParameters)
    setpoints: ScheduleParameters = group(ScheduleParameters)

    def check(self):
        """The travel is not empty and contains every setpoint of the configuration."""
        if not self.minimum < self.maximum:
            yield Problem("maximum", self.maximum, f"must be > minimum = {self.minimum:g} m")
            return
        places = [("initial_setpoint", self.initial_setpoint), ("home_position", self.home_position)]
        places += [("setpoints.values", value) for value in self.setpoints.values]
        for name, value in places:
            if not self.minimum <= value <= self.maximum:
                allowed = f"outside of the travel, allowed: {self.minimum:g} … {self.maximum:g} m"
                yield Problem(name, value, allowed)


class InchwormSequencer(Block):
    """The sequencer: once per sample from setpoint and measurements to the reference and the clamps' voltages.

    Parameters
    ----------
    parameters : InchwormSequencerParameters
        Gait, fine positioning, learning and guards.
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        A parameter is wrong, or a duration is shorter than a sample.
    """

    kernel = staticmethod(sequence)

    def pack(self, parameters: InchwormSequencerParameters) -> np.ndarray:
        """Return p, shape (33,); the layout is in :mod:`hysteresis_ros.references.inchworm_layout`."""
        gait, fine, guard = parameters.gait, parameters.fine, parameters.guard
        p = np.zeros(at.PARAMETERS)

        def samples(duration: float, least: int) -> float:
            return float(max(round(duration / self.sample_time), least))

        p[at.SAMPLE_TIME] = self.sample_time
        p[at.RELEASE_SAMPLES] = samples(gait.release, 2)
        p[at.GRIP_SAMPLES] = samples(gait.grip, 2)
        p[at.EXTEND_SAMPLES] = samples(gait.extend, 2)
        p[at.CONTRACT_SAMPLES] = samples(gait.contract, 2)
        p[at.SETTLE_SAMPLES] = samples(gait.settle, 0)
        p[at.OVERLAP_SAMPLES] = min(samples(gait.overlap, 0), p[at.GRIP_SAMPLES] - 1.0)
        p[at.LINEAR_RAMP] = gait.clamp_ramp == "linear"
        p[at.GRIP_VOLTAGE] = gait.grip_voltage
        p[at.RELEASE_VOLTAGE] = gait.release_voltage
        p[at.LOWEST] = gait.lowest_extension
        p[at.HIGHEST] = gait.highest_extension
        p[at.MARGIN] = gait.fine_margin
        p[at.WINDOW] = gait.fine_window
        p[at.MINIMUM] = parameters.minimum
        p[at.MAXIMUM] = parameters.maximum
        p[at.HOME] = parameters.home_position
        p[at.RESTING] = parameters.resting_extension
        p[at.FINE_ENABLED] = fine.enabled
        p[at.TOLERANCE] = fine.tolerance
        p[at.FINE_SPEED] = fine.speed
        p[at.FINE_TIME] = max(fine.time, 2.0 * self.sample_time)
        p[at.FINE_TIMEOUT] = samples(fine.timeout, 1)
        smooth = fine.smoothing_time
        p[at.SMOOTHING] = 1.0 - elementary.exp(-self.sample_time / smooth) if smooth > 0.0 else 1.0
        p[at.LEARNING] = parameters.learning.enabled
        p[at.FORGETTING] = parameters.learning.forgetting
        p[at.STILL_STEPS] = guard.still_steps
        p[at.MISSED_PART] = guard.missed_part
        p[at.RUNAWAY] = guard.runaway
        p[at.SLIP_LIMIT] = guard.slip
        p[at.DRIFT] = guard.drift
        p[at.SENSOR_SAMPLES] = samples(guard.sensor_timeout, 0)
        exchange = p[at.RELEASE_SAMPLES] + p[at.GRIP_SAMPLES] - p[at.OVERLAP_SAMPLES] + p[at.SETTLE_SAMPLES]
        p[at.CYCLE_SAMPLES] = 2.0 * exchange + p[at.EXTEND_SAMPLES] + p[at.CONTRACT_SAMPLES]
        return p

    def initial_state(self) -> np.ndarray:
        """Return x, shape (74,): nothing has closed yet, both clamps are about to."""
        parameters = self.parameters
        gait, learning = parameters.gait, parameters.learning
        x = np.zeros(at.STATES)
        x[at.FRONT_VOLTAGE] = x[at.FRONT_FROM] = x[at.REAR_VOLTAGE] = x[at.REAR_FROM] = gait.initial_voltage
        x[at.FRONT_TO] = x[at.REAR_TO] = gait.grip_voltage
        x[at.PHASE] = at.STARTING
        x[at.MODE] = at.RUN
        x[at.MOVE_DONE] = 1.0
        x[at.TARGET] = x[at.RECEIVED] = parameters.initial_setpoint
        x[at.SPEED] = gait.walking_speed
        stroke = gait.stroke
        x[at.LOAD] = learning.load_deflection
        forget_all(x, at.FORWARD_MODEL, learning.forward_gain, learning.forward_offset / stroke)
        forget_all(x, at.BACKWARD_MODEL, learning.backward_gain, learning.backward_offset / stroke)
        return x

    def step(self, setpoint: float, slider: float, extender: float) -> float:
        """Return the reference [m] for this sample's setpoint and measurements [m]; the rest is in the properties."""
        return self.kernel(self.p, self.x, float(setpoint), float(slider), float(extender))

    def refuse(self, setpoint: float) -> str | None:
        """Say why a setpoint [m] is refused, with value and range; None when it is not."""
        low, high = self.parameters.minimum, self.parameters.maximum
        if low <= setpoint <= high:
            return None
        reason = "outside of the travel" if math.isfinite(setpoint) else "not a finite number"
        return f"setpoint {setpoint:g} m refused: {reason}, allowed: {low:g} … {high:g} m"

    def request(self, code: int) -> None:
        """Ask for start, stop, home or release (a request of the layout); it is taken at the next sample.

        Release opens the front clamp and lets the extender relax; the rear clamp keeps holding the slider.
        """
        self.x[at.REQUEST] = code

    def walk(self, speed: float) -> str | None:
        """Walk continuously at ``speed`` [m/s] from the next sample on; 0 holds where the motor is.

        Returns
        -------
        str or None
            Why the speed is refused, with the number; nothing changes then.
        """
        reason = self.parameters.gait.refuse_speed(speed)
        if reason is None:
            self.x[at.SPEED] = speed
        return reason

    def scheduled(self, samples: int) -> np.ndarray:
        """Return the setpoint [m] that the schedule has in force at each of the first ``samples`` samples."""
        given = self.parameters.setpoints
        values = np.array([self.parameters.initial_setpoint, *given.values])
        first = [round(time / self.sample_time) for time in given.times]
        return values[np.searchsorted(np.array(first, dtype=float), np.arange(samples), side="right")]

    @property
    def duration_samples(self) -> int:
        """Length of a run that the schedule gives, in samples; 0 when it gives none."""
        return round(self.parameters.setpoints.duration / self.sample_time)

    @property
    def reference(self) -> float:
        """Wanted displacement [m] of the extender, or of the slider less :attr:`origin`."""
        return float(self.x[at.REFERENCE])

    @property
    def front_voltage(self) -> float:
        """Voltage [V] of the front clamp."""
        return float(self.x[at.FRONT_VOLTAGE])

    @property
    def rear_voltage(self) -> float:
        """Voltage [V] of the rear clamp."""
        return float(self.x[at.REAR_VOLTAGE])

    @property
    def origin(self) -> float:
        """What the controller subtracts from the measured slider [m]."""
        return float(self.x[at.ORIGIN])

    @property
    def phase(self) -> str:
        """Name of the present phase."""
        return at.PHASE_NAMES[int(self.x[at.PHASE])]

    @property
    def error(self) -> str:
        """Name of the error; empty when there is none."""
        return at.ERROR_NAMES[int(self.x[at.ERROR])]

    @property
    def arrived(self) -> bool:
        """Whether the slider is at the setpoint within the tolerance."""
        return bool(self.x[at.ARRIVED])

    @property
    def learned(self) -> dict[str, float]:
        """The learned step lengths, as parameters of ``learning`` to start from."""
        stroke = self.parameters.gait.stroke
        found = {"load_deflection": float(self.x[at.LOAD])}
        for way, first in (("forward", at.FORWARD_MODEL), ("backward", at.BACKWARD_MODEL)):
            found[f"{way}_gain"] = float(self.x[first + GAIN])
            found[f"{way}_offset"] = float(self.x[first + OFFSET] * stroke)
        return found

    def retune(self, parameters: InchwormSequencerParameters) -> None:
        """Refuse: nothing may change under a motor that walks.

        Raises
        ------
        ParameterError
            Unless the parameters are the present ones.
        """
        if parameters != self.parameters:
            raise ParameterError([Problem("gait", "…", "fixed while configured; clean up and configure anew")])
