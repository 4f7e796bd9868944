# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Node ``inchworm_sequencer``: setpoints over a travel of millimetres → clamp voltages, ``reference``, ``origin``.

It replaces the reference generator on the axis of an inchworm motor.
"""

from __future__ import annotations

import math
import time
from collections import deque

from std_msgs.msg import Float64

from hysteresis_ros import signals
from hysteresis_ros.loop.parameters import InchwormSequencerNodeParameters
from hysteresis_ros.loop.source import SequencerSource, refer
from hysteresis_ros.models.block import interpreted
from hysteresis_ros.nodes.qos import setpoint_qos
from hysteresis_ros.nodes.realtime import WATCHDOG_PERIOD
from hysteresis_ros.nodes.reference_source import ReferenceSource
from hysteresis_ros.nodes.spin import run
from hysteresis_ros.nodes.timing import STALE
from hysteresis_ros.references import inchworm_layout as at

#: Time to close both clamps when the node exits [s].
CLOSING_TIME = 0.3

#: Message of each error.
ERRORS = {
    at.SENSOR_ERROR: "slider or extender has no finite measurement: both clamps hold until there is one",
    at.NO_MOTION_ERROR: "the slider did not move in {still} steps: both clamps hold; check clamps and load, then call "
    "~/start",
    at.RUNAWAY_ERROR: "the slider moved although nothing should move it (guard.runaway {runaway:g} m): both clamps "
    "hold; check clamps and load, then call ~/start",
    at.SLIP_ERROR: "the front clamp slips (guard.slip {slip:g} m) repeatedly: both clamps hold; raise its voltage "
    "or lower the load, then call ~/start",
}

_REFER = interpreted(refer)


class InchwormSequencerNode(ReferenceSource):
    """Answers every ``joint_states`` with ``reference``, ``origin`` [m] and the voltages of both clamps [V].

    Setpoints [m] and speeds [m/s] are accepted at any time. Requests (start, stop, home, release, …) take effect in the
    order of the calls, at most one per sample. ``~/state`` contains setpoint, speed and request of each sample, so that
    a run can be repeated offline bit for bit.

    In the safe state both clamps are closed, which needs voltage: without voltage they open. At exit, and when
    measurements stop, the node closes the open clamps and leaves the voltages of the clamps on.
    """

    parameters: InchwormSequencerNodeParameters
    # origin before reference, so that a node that receives a reference already has its origin
    outputs = (
        ("origin", signals.ORIGIN),
        ("reference", signals.REFERENCE),
        ("front_clamp/voltage", signals.FRONT_VOLTAGE),
        ("rear_clamp/voltage", signals.REAR_VOLTAGE),
    )
    triggers = ("start", "stop", "reset", "home", "release", "learn", "freeze", "forget", "save")

    def __init__(self, **options):
        super().__init__("inchworm_sequencer", **options)

    @property
    def axis_kind(self) -> signals.AxisKind:
        """Kind of the axis: an inchworm motor."""
        return signals.INCHWORM

    @property
    def sequencer(self):
        """The sequencer."""
        return self.part.sequencer

    def build(self, parameters) -> None:
        """Create the sequencer from the parameters."""
        self.part = SequencerSource(parameters)
        self.step()  # compile now, not at the first sample
        self._clear()

    def _clear(self) -> None:
        self.part.reset()
        self.row[:] = [0.0] * len(self.row)
        given = self.sequencer.parameters
        self.setpoint = given.initial_setpoint
        first = [round(instant / self.sequencer.sample_time) for instant in given.setpoints.times]
        self._schedule = deque(zip(first, given.setpoints.values, strict=True))
        self._requests: deque = deque()
        self._complete = False
        self._extender_index = -1
        self._error = 0.0

    def connect(self) -> None:
        """Create the topics."""
        super().connect()
        self.subscriber(Float64, "speed", self._on_speed, setpoint_qos())

    def begin(self) -> None:
        """In real time, start when the loop is complete."""
        super().begin()
        self._complete = not self.runner.by_message
        if not self.runner.exact and self.runner.by_message:
            self.timer(WATCHDOG_PERIOD, self._look_for_the_others)

    def _look_for_the_others(self) -> None:
        if self.active and not self._complete:
            # without these nodes the extender does not move, and its steps would count as missed
            topics = (self.resolve_topic_name(topic) for topic in ("command", "voltage"))
            self._complete = self.all_matched() and all(self.count_publishers(topic) for topic in topics)

    def reset_blocks(self) -> None:
        """Reset the sequencer: both clamps close, and steps and learned lengths are cleared.

        In real time the clamp voltages continue from their present values, so that a reset does not drop the slider.
        """
        x = self.sequencer.x
        front, rear = x[at.FRONT_VOLTAGE], x[at.REAR_VOLTAGE]
        self._clear()
        if self.trigger_out is not None:
            self.trigger_out.restart()
        if not self.runner.exact:
            x[at.FRONT_VOLTAGE] = x[at.FRONT_FROM] = front
            x[at.REAR_VOLTAGE] = x[at.REAR_FROM] = rear

    # -- requests of the user ---------------------------------------------------------------------------------

    def take_setpoint(self, value: float) -> str:
        """Take a setpoint [m]; return why it is refused, or an empty text if it is taken."""
        reason = self.sequencer.refuse(value)
        if reason:
            return reason
        x = self.sequencer.x
        if value == x[at.RECEIVED] and (x[at.SPEED] or x[at.WALKED] or value != x[at.TARGET]):
            # the sequencer accepts only a setpoint that differs from the last one, so an equal setpoint is changed by
            # the smallest possible amount
            low, high = self.sequencer.parameters.minimum, self.sequencer.parameters.maximum
            value = math.nextafter(value, high if value < 0.5 * (low + high) else low)
        self.setpoint = value
        self._schedule.clear()
        if self.is_fused:
            self.fused.set(setpoint=value, speed=0.0)
        else:
            x[at.SPEED] = 0.0
        return ""

    def _on_speed(self, message) -> None:
        reason = self.sequencer.parameters.refuse_speed(message.data)
        if reason:
            self.refuse("speed", f"{reason}; {self.sequencer.x[at.SPEED]:.6g} m/s is kept")
        else:
            self._schedule.clear()
            if self.is_fused:
                self.fused.set(speed=message.data)
            else:
                self.sequencer.walk(message.data)

    def _on_start(self, request, response):
        return self._ask(response, at.START_REQUEST, "resumes")

    def _on_stop(self, request, response):
        return self._ask(response, at.STOP_REQUEST, "closes both clamps and holds")

    def _on_home(self, request, response):
        if self.parameters is not None and self.sequencer.x[at.MODE] != at.FAILED:
            self.setpoint = self.parameters.home_position
            self._schedule.clear()
            if self.is_fused:
                self.fused.set(setpoint=self.setpoint)
        return self._ask(response, at.HOME_REQUEST, "goes home")

    def _on_release(self, request, response):
        return self._ask(response, at.RELEASE_REQUEST, "opens the front clamp and relaxes the extender")

    def _on_learn(self, request, response):
        if self.parameters is not None:
            self.sequencer.require_continuous()
        return self._ask(response, at.LEARN_REQUEST, "learns from the next cycle of continuous walking; requested")

    def _on_freeze(self, request, response):
        return self._ask(response, at.FREEZE_REQUEST, "stops learning, and applies the learned values")

    def _on_forget(self, request, response):
        return self._ask(response, at.FORGET_REQUEST, "discards the values learned while walking; requested")

    def _on_save(self, request, response):
        if self.parameters is not None:
            self.sequencer.save()
        return self._answer_service(response, f"written to {self.parameters and self.parameters.walk.save_file}")

    def _ask(self, response, code: int, what: str):
        """Queue a request; it takes effect at the next free sample."""
        if self.parameters is not None:
            if code in (at.HOME_REQUEST, at.RELEASE_REQUEST) and self.sequencer.x[at.MODE] == at.FAILED:
                response.success = False
                response.message = f"refused: stopped by the error {self.sequencer.error}; call ~/start first"
                return response
            if self.is_fused:
                self.fused.set(request=float(code))
            else:
                self._requests.append(code)
        return self._answer_service(response, f"{what} from sample {self.sample + len(self._requests) - 1} on")

    # -- samples -----------------------------------------------------------------------------------------------

    def read(self, message, row) -> bool:
        """Write the positions of slider and extender into a row, NaN for a missing position."""
        if not super().read(message, row):
            return False
        row[signals.EXTENDER] = math.nan
        joint, names, index = self.parameters.extender_joint, message.name, self._extender_index
        if not 0 <= index < len(names) or names[index] != joint:
            if joint not in names:
                text = f"joint '{joint}' is not in joint_states, which has {list(names)}"
                if self.runner.exact:
                    self.fail(text)
                    return False
                self.warn("joint", text, error=True)
                return True
            index = self._extender_index = names.index(joint)
        if index < len(message.position):
            row[signals.EXTENDER] = message.position[index]
        return True

    def before_step(self) -> None:
        """Write setpoint and request into the row."""
        super().before_step()
        while self._schedule and self._schedule[0][0] <= self.sample:
            self.setpoint = self._schedule.popleft()[1]
        self.row[signals.SETPOINT] = self.setpoint
        self.row[signals.REQUEST] = float(self._requests.popleft() if self._requests else at.NO_REQUEST)
        self.row[signals.SPEED] = math.nan

    def step(self) -> None:
        """Compute the sample in the row with the reference source of the loop."""
        _REFER(None, self.part.arrays, self.row)

    def answer(self, stamp) -> None:
        """Answer the sample in the row; in real time only if the other nodes of the axis are present."""
        if self.runner.exact or self._complete:
            super().answer(stamp)

    def after_step(self) -> None:
        """Log errors, and publish whether the slider has arrived."""
        super().after_step()
        if self.runner.by_message:
            self.look_at((self.row,))
        error = self.row[signals.ERROR]
        if error != self._error:
            self._error = error
            if error:
                self.warn("error", self._explanation, error=True, every=0.0)

    def look_at(self, rows) -> None:
        """Detect from the samples whether the slider has arrived and stands still."""
        last = rows[-1]
        self.tell_settled(bool(last[signals.ARRIVED]) and not last[signals.TRIPPED])

    # -- safety ------------------------------------------------------------------------------------------------

    @property
    def stale(self) -> bool:
        """Whether measurements have stopped."""
        return not self.runner.exact and self.runner.silent

    #: Always true: both clamps close as soon as measurements stop, and missed samples are not repeated.
    is_stale = True

    def say_silent(self) -> None:
        """Log that measurements have stopped."""
        self.warn("stale", f"no joint_states for {self.parameters.measurement_timeout:g} s: both clamps close")

    def miss(self, samples: int) -> None:
        """Process samples without a measurement: open clamps close. Publish only the voltages."""
        self.row[signals.REQUEST], self.row[signals.SPEED] = 0.0, math.nan
        self.row[signals.TRIGGER_IN] = 0.0
        for _ in range(samples):
            self.row[signals.MEASURED] = self.row[signals.EXTENDER] = math.nan
            self.step()
        self._publish_voltages()

    def _publish_voltages(self) -> None:
        for place, publisher in self._outputs:
            if place in (signals.FRONT_VOLTAGE, signals.REAR_VOLTAGE):
                self._message.data = float(self.row[place])
                publisher.publish(self._message)

    def go_safe(self) -> None:
        """Close open clamps and leave the clamp voltages on; do nothing in lockstep, where time does not advance."""
        if self.runner.exact or not self.sample:
            return
        x = self.sequencer.x
        samples = max(round(0.001 * self.parameters.sample_rate), 1)
        deadline = time.monotonic() + CLOSING_TIME
        while time.monotonic() < deadline:
            self.miss(samples)
            if x[at.BAD] > self.sequencer.p[at.SENSOR_SAMPLES] and x[at.PHASE] in (at.HOLDING, at.RELEASED):
                return
            time.sleep(samples / self.parameters.sample_rate)
        # the clamps have not closed in time at the speed of the gait, so the grip voltage is output without a ramp
        for place, own in ((signals.FRONT_VOLTAGE, at.FRONT_VOLTAGE), (signals.REAR_VOLTAGE, at.REAR_VOLTAGE)):
            self.row[place] = x[own] = max(x[own], self.parameters.gait.grip_voltage)
        self._publish_voltages()

    # -- diagnostics -------------------------------------------------------------------------------------------

    @property
    def _explanation(self) -> str:
        guard = self.parameters.guard
        text = ERRORS[int(self.sequencer.x[at.ERROR])]
        return text.format(still=guard.still_steps, runaway=guard.runaway, slip=guard.slip)

    def health(self):
        """Report errors with a remedy, missed steps, refused setpoints, and the state of the motor."""
        sequencer, x = self.sequencer, self.sequencer.x
        # in real time, measurements are missing if the last answered sample is long ago
        stale = self.stale or (not self.runner.exact and self.pace.age > max(STALE, 3.0 / self.parameters.sample_rate))
        values = {
            "setpoint_m": f"{self.setpoint:.9g}",
            "slider_m": f"{x[at.SLIDER]:.9g}",
            "phase": sequencer.phase,
            "error": sequencer.error or "none",
            "arrived": sequencer.arrived,
            "steps": f"{x[at.STEPS]:g}",
            "missed_steps": f"{x[at.MISSED]:g}",
            "slip_m": f"{x[at.SLIP]:.3g}",
            "setpoints_refused": self.refused,
            "stale": stale,
            **{name: f"{value:.4g}" for name, value in sequencer.learned.items()},
            **self._walk_values(),
        }
        refused = self.since_report("refused", self.refused)
        missed = self.since_report("missed", int(x[at.MISSED]))
        if stale:
            return 2, "joint_states is stale", values
        if not self._complete and not self.runner.exact:
            return 1, "waiting for motion_controller, hysteresis_compensator and the clamps' driver", values
        if self.row[signals.TRIPPED]:
            return 2, "the plant has stopped the axis: both clamps hold", values
        if x[at.ERROR]:
            return 2, self._explanation, values
        if x[at.MODE] == at.STOP:
            return 1, "stopped: both clamps hold", values
        if x[at.MODE] == at.LET_GO:
            return 1, "released: only the rear clamp holds", values
        if missed:
            return 1, f"{missed} steps missed, slip of the last step {1e6 * x[at.SLIP]:.3g} um", values
        if x[at.LIMITED_SPEED]:
            return 1, f"the steps slip: the speed is below the requested {x[at.SPEED]:g} m/s", values
        return (1, f"{refused} setpoints or speeds refused", values) if refused else (0, "", values)

    def _walk_values(self) -> dict[str, str]:
        """Return the diagnostics of continuous walking."""
        x = self.sequencer.x
        if not self.parameters.walk.continuous:
            return {}
        return {
            "walk_learning": "learns" if x[at.LEARNS] else "frozen",
            "walk_learned_cycles": f"{x[at.LEARNED_CYCLES]:g}",
            "walk_off_path_m": f"{x[at.RIPPLE]:.3g}",
        }


def main(arguments=None) -> int:
    """Run the node; return the exit code."""
    return run([InchwormSequencerNode], arguments, steered=True)


if __name__ == "__main__":
    raise SystemExit(main())
