# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Inchworm sequencer: setpoints in millimetres to clamp voltages and the extender's reference.

It takes the reference generator's place. The motion controller's measurement is the slider less :attr:`origin`: while
the motor walks that is the extender's own displacement, in fine positioning the slider's, and while both clamps hold it
is the reference itself, because nothing can move then and an integral would only wind up.
"""

from __future__ import annotations

import math

import numpy as np

from hysteresis_ros import elementary
from hysteresis_ros.block import Block
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references.inchworm_machine import sequence
from hysteresis_ros.references.inchworm_parameters import InchwormSequencerParameters
from hysteresis_ros.references.step_model import GAIN, OFFSET, forget_all
from hysteresis_ros.references.walk import BINS_PER_SPLINE, learning_matrix, phase_bounds
from hysteresis_ros.references.walk_file import LearnedWalk, read_walk, write_walk


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

    def __init__(self, parameters: InchwormSequencerParameters, sample_time: float):
        walk = parameters.validated().walk
        self._walk = LearnedWalk(walk.step, np.zeros(walk.splines), np.zeros(walk.splines))
        if walk.continuous and walk.file:
            self._walk = read_walk(walk.file, walk.splines, walk.step, walk.bound)
        super().__init__(parameters, sample_time)

    def pack(self, parameters: InchwormSequencerParameters) -> np.ndarray:
        """Return p; the layout is in :mod:`hysteresis_ros.references.inchworm_layout`."""
        gait, fine, guard = parameters.gait, parameters.fine, parameters.guard
        p = np.concatenate([np.zeros(at.PARAMETERS), *self._pack_learning(parameters)])

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
        self._pack_walk(p, parameters)
        return p

    def _pack_walk(self, p: np.ndarray, parameters: InchwormSequencerParameters) -> None:
        gait, walk = parameters.gait, parameters.walk
        p[at.CONTINUOUS] = walk.continuous
        p[at.WALKING_STEP] = walk.step
        p[at.BLEND] = walk.blend
        p[at.LEAD] = 0.5 + walk.lead / self.sample_time
        p[at.BOUND] = walk.bound
        p[at.LEARNING_GAIN] = walk.gain
        p[at.LEARNING_RATE] = walk.learning_speed * self.sample_time / walk.step
        p[at.INERTIA] = walk.inertia / self.sample_time**2
        p[at.SPLINES] = walk.splines if walk.continuous else 0.0
        p[at.BINS] = BINS_PER_SPLINE * p[at.SPLINES]
        p[at.FORWARD_BOUNDS : at.FORWARD_BOUNDS + 8] = phase_bounds(gait, 1)
        p[at.BACKWARD_BOUNDS : at.BACKWARD_BOUNDS + 8] = phase_bounds(gait, -1)

    @staticmethod
    def _pack_learning(parameters: InchwormSequencerParameters) -> list[np.ndarray]:
        gait, walk = parameters.gait, parameters.walk
        if not walk.continuous:
            return []
        return [learning_matrix(walk, gait, direction).ravel() for direction in (1, -1)]

    def initial_state(self) -> np.ndarray:
        """Return x: nothing has closed yet, both clamps are about to."""
        parameters = self.parameters
        gait, learning, walk = parameters.gait, parameters.learning, parameters.walk
        n, m = int(self.p[at.SPLINES]), int(self.p[at.BINS])
        x = np.zeros(at.STATES + 4 * n + 2 * m)
        x[at.LEARNS] = walk.learning
        if n:
            x[at.WALK : at.WALK + n] = self._walk.forward
            x[at.WALK + 2 * n : at.WALK + 3 * n] = self._walk.backward
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
        reason = self.parameters.refuse_speed(speed)
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

    @property
    def learned_walk(self) -> LearnedWalk:
        """What was learned of continuous walking over the phase of its cycle."""
        n = int(self.p[at.SPLINES])
        starts = at.WALK, at.WALK + 2 * n
        return LearnedWalk(self.parameters.walk.step, *(self.x[first : first + n].copy() for first in starts))

    def save(self, path=None) -> None:
        """Write what was learned of continuous walking.

        Parameters
        ----------
        path : path-like, optional
            By default ``walk.save_file``.

        Raises
        ------
        ParameterError
            There is no continuous walking, or no file was named.
        ConfigurationError
            The file cannot be written.
        """
        walk = self.parameters.walk
        if not walk.continuous:
            raise ParameterError([Problem("walk.continuous", False, "must be true for something to be learned")])
        if not (path or walk.save_file):
            raise ParameterError([Problem("walk.save_file", "", "names no file; give one: nothing else is written")])
        write_walk(path or walk.save_file, self.learned_walk)

    def retune(self, parameters: InchwormSequencerParameters) -> None:
        """Refuse: nothing may change under a motor that walks.

        Raises
        ------
        ParameterError
            Unless the parameters are the present ones.
        """
        if parameters != self.parameters:
            raise ParameterError([Problem("gait", "…", "fixed while configured; clean up and configure anew")])
