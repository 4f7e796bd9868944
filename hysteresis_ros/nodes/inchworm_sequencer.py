"""Node ``inchworm_sequencer``: setpoints in millimetres → clamp voltages, ``reference`` and ``origin``.

It takes the reference generator's place on the axis of an inchworm motor.
"""

from __future__ import annotations

import math
import time
from collections import deque

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from hysteresis_ros.nodes.base import AxisNode, sample_index
from hysteresis_ros.nodes.qos import setpoint_qos
from hysteresis_ros.nodes.spin import run
from hysteresis_ros.nodes.timing import STALE
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references.inchworm_sequencer import InchwormSequencer, InchwormSequencerParameters
from hysteresis_ros.references.step_model import GAIN, OFFSET
from hysteresis_ros.simulation.node_parameters import part

#: Seconds between two looks at the watchdog.
WATCHDOG_PERIOD = 0.01

#: Seconds that closing both clamps may take when the node leaves or no measurement comes.
CLOSING_TIME = 0.3

#: Signals of ``~/state`` that stand in the sequencer's state as they are, and where.
SIGNALS = {
    "reference": at.REFERENCE,
    "origin": at.ORIGIN,
    "front_voltage": at.FRONT_VOLTAGE,
    "rear_voltage": at.REAR_VOLTAGE,
    "phase": at.PHASE,
    "steps": at.STEPS,
    "direction": at.DIRECTION,
    "slip": at.SLIP,
    "error": at.ERROR,
    "arrived": at.ARRIVED,
    "total_steps": at.TOTAL_STEPS,
    "missed": at.MISSED,
    "step_commanded": at.COMMANDED_STEP,
    "step_achieved": at.ACHIEVED_STEP,
    "load_deflection": at.LOAD,
    "forward_gain": at.FORWARD_MODEL + GAIN,
    "backward_gain": at.BACKWARD_MODEL + GAIN,
}
_PLACES = np.array(list(SIGNALS.values()))

#: What each error means.
ERRORS = {
    at.SENSOR_ERROR: "slider or extender has no finite measurement: both clamps hold until there is one",
    at.NO_MOTION_ERROR: "the slider did not move in {still} steps: both clamps hold; look after clamps and load, then "
    "call ~/start",
    at.RUNAWAY_ERROR: "the slider moved where nothing was to move it (guard.runaway {runaway:g} m): both clamps hold; "
    "look after clamps and load, then call ~/start",
    at.SLIP_ERROR: "the front clamp slips (guard.slip {slip:g} m) again and again: both clamps hold; raise its voltage "
    "or lower the load, then call ~/start",
}


class InchwormSequencerNode(AxisNode):
    """Answers every ``joint_states`` with ``reference``, ``origin`` [m] and the voltages of both clamps [V].

    Setpoints [m] and speeds [m/s] are taken at any time; requests (start, stop, home, release) take effect one a
    sample, in the order of the calls. All of them stand in ``~/state`` at the sample at which they did, so that a run
    can be simulated again bit for bit.

    Safe is both clamps closed, which takes voltage: without any they open. On the way out, and when measurements stop,
    the node closes whatever is open and leaves its voltage on.
    """

    state_names = ("setpoint", "request", "speed", *SIGNALS, "forward_offset", "backward_offset")
    triggers = ("start", "stop", "reset", "home", "release")

    def __init__(self, **options):
        super().__init__("inchworm_sequencer", **options)
        self.refused = 0

    def build(self, parameters) -> None:
        """Make the sequencer from the parameters."""
        given = part(parameters, InchwormSequencerParameters)
        self.sequencer = InchwormSequencer(given, 1.0 / parameters.sample_rate)
        self.sequencer.step(given.initial_setpoint, 0.0, 0.0)  # compile now, not at the first sample
        self._clear()

    def _clear(self) -> None:
        self.sequencer.reset()
        given = self.sequencer.parameters
        self.setpoint = given.initial_setpoint
        first = [round(instant / self.sequencer.sample_time) for instant in given.setpoints.times]
        self._schedule = deque(zip(first, given.setpoints.values, strict=True))
        self._requests: deque = deque()
        self._awaiting = None
        self._measured = (math.nan, math.nan)
        self._complete = False
        self._joints = (-1, -1)
        self._error = 0.0
        self.stale = False

    def connect(self) -> None:
        """Make the topics."""
        self._message = Float64()
        qos = self.qos()
        # in this order: whoever hears a reference has heard its origin
        self._outputs = [
            (place, self.publisher(Float64, topic, qos, loop=True))
            for topic, place in (
                ("origin", at.ORIGIN),
                ("reference", at.REFERENCE),
                ("front_clamp/voltage", at.FRONT_VOLTAGE),
                ("rear_clamp/voltage", at.REAR_VOLTAGE),
            )
        ]
        self.subscriber(JointState, "joint_states", self._on_measurement, qos, partner="plant_simulator")
        self.subscriber(Float64, "setpoint", self._on_setpoint, setpoint_qos())
        self.subscriber(Float64, "speed", self._on_speed, setpoint_qos())
        self.subscribe_end()

    def begin(self) -> None:
        """Start the watchdog of the measurement."""
        self._complete = False
        if not self.lockstep:
            self.timer(WATCHDOG_PERIOD, self._watchdog)

    def reset_blocks(self) -> None:
        """Begin again: both clamps close, steps and learned lengths are forgotten.

        In real time the clamps' voltages go on from where they are: a slider must not be dropped by a reset.
        """
        x = self.sequencer.x
        front, rear = x[at.FRONT_VOLTAGE], x[at.REAR_VOLTAGE]
        self._clear()
        if not self.lockstep:
            x[at.FRONT_VOLTAGE] = x[at.FRONT_FROM] = front
            x[at.REAR_VOLTAGE] = x[at.REAR_FROM] = rear

    def retune(self, parameters) -> None:
        """Take new timeouts; everything of the gait is refused under a motor that walks."""
        self.sequencer.retune(part(parameters, InchwormSequencerParameters))

    # -- what people ask for -----------------------------------------------------------------------------------

    def _on_setpoint(self, message) -> None:
        value = message.data
        reason = self.sequencer.refuse(value)
        if reason:
            self.refused += 1
            self.warn("setpoint", f"{reason}; {self.setpoint:.6g} m is kept")
            return
        x = self.sequencer.x
        if value == x[at.RECEIVED] and (x[at.SPEED] or x[at.WALKED] or value != x[at.TARGET]):
            # the sequencer takes setpoints that differ from the last one: by as little as there is
            low, high = self.sequencer.parameters.minimum, self.sequencer.parameters.maximum
            value = math.nextafter(value, high if value < 0.5 * (low + high) else low)
        self.setpoint = value
        x[at.SPEED] = 0.0
        self._schedule.clear()

    def _on_speed(self, message) -> None:
        reason = self.sequencer.walk(message.data)
        if reason:
            self.refused += 1
            self.warn("speed", f"{reason}; {self.sequencer.x[at.SPEED]:.6g} m/s is kept")
        else:
            self._schedule.clear()

    def _on_start(self, request, response):
        return self._ask(response, at.START_REQUEST, "goes on")

    def _on_stop(self, request, response):
        return self._ask(response, at.STOP_REQUEST, "closes both clamps and holds")

    def _on_home(self, request, response):
        if self.parameters is not None and self.sequencer.x[at.MODE] != at.FAILED:
            self.setpoint = self.parameters.home_position
            self._schedule.clear()
        return self._ask(response, at.HOME_REQUEST, "goes home")

    def _on_release(self, request, response):
        return self._ask(response, at.RELEASE_REQUEST, "opens the front clamp and relaxes the extender")

    def _ask(self, response, code: int, what: str):
        """Queue a request; it takes effect at a sample."""
        if self.parameters is not None:
            if code in (at.HOME_REQUEST, at.RELEASE_REQUEST) and self.sequencer.x[at.MODE] == at.FAILED:
                response.success = False
                response.message = f"refused: stopped by the error {self.sequencer.error}; call ~/start first"
                return response
            self._requests.append(code)
        return self._answer_service(response, f"{what} from sample {self.sample + len(self._requests) - 1} on")

    # -- samples -----------------------------------------------------------------------------------------------

    def _on_measurement(self, message) -> None:
        if self.lockstep:
            if self.expected(sample_index(message.header.stamp, self.parameters.sample_rate)):
                self.heard()
                self._measured = self._displacements(message)
                self._awaiting = message.header.stamp
                self.advance()
        elif self.active:
            self.pace.tick()
            self.stale = False
            if self._complete:
                self._answer(message.header.stamp, *self._displacements(message))

    def _displacements(self, message) -> tuple[float, float]:
        """Return the positions of slider and extender [m], NaN where there is none."""
        names, (first, second) = message.name, self._joints
        size = len(names)
        wanted = self.parameters.joint, self.parameters.extender_joint
        if not (0 <= first < size and 0 <= second < size and (names[first], names[second]) == wanted):
            absent = [joint for joint in wanted if joint not in names]
            if absent:
                text = f"joint '{absent[0]}' is not in joint_states, which has {list(names)}"
                if self.lockstep:
                    self.fail(text)
                else:
                    self.warn("joint", text, error=True)
                return math.nan, math.nan
            first, second = self._joints = tuple(names.index(joint) for joint in wanted)
        position = message.position
        if max(first, second) >= len(position):
            return math.nan, math.nan
        return position[first], position[second]

    def advance(self) -> None:
        """Answer the awaited sample once the partners are there."""
        if self._awaiting is not None and self.active and not self.failure and self.matched():
            self.pace.tick()
            stamp, self._awaiting = self._awaiting, None
            self._answer(stamp, *self._measured)

    def missing_partner(self) -> str:
        """Name who has not delivered what the present sample needs."""
        return "plant_simulator" if self._awaiting is None else ""

    def _answer(self, stamp, slider: float, extender: float) -> None:
        while self._schedule and self._schedule[0][0] <= self.sample:
            self.setpoint = self._schedule.popleft()[1]
        x = self.sequencer.x
        request = self._requests.popleft() if self._requests else at.NO_REQUEST
        speed = float(x[at.SPEED])
        x[at.REQUEST] = request
        self.sequencer.step(self.setpoint, slider, extender)
        self._publish(self._outputs)
        stroke = self.parameters.gait.stroke
        self.publish_state(
            stamp,
            *(self.setpoint, float(request), speed, *x[_PLACES].tolist()),
            *(stroke * x[at.FORWARD_MODEL + OFFSET], stroke * x[at.BACKWARD_MODEL + OFFSET]),
        )
        self.sample += 1
        if x[at.ERROR] != self._error:
            self._error = x[at.ERROR]
            if self._error:
                self.warn("error", self._explanation, error=True, every=0.0)

    def _publish(self, outputs) -> None:
        x, message = self.sequencer.x, self._message
        for place, publisher in outputs:
            message.data = float(x[place])
            publisher.publish(message)

    # -- safety ------------------------------------------------------------------------------------------------

    def _watchdog(self) -> None:
        """Real time: begin when the loop is complete, close both clamps when no measurement comes."""
        if not self.active:
            return
        if not self._complete:
            # steps of an extender that nobody drives yet would be taken for missed ones
            topics = (self.resolve_topic_name(topic) for topic in ("command", "voltage"))
            self._complete = self.matched() and all(self.count_publishers(topic) for topic in topics)
        if self.sample == 0 or self.stale:
            return
        if self.pace.age > self.parameters.measurement_timeout:
            self.stale = True
            limit = self.parameters.measurement_timeout
            self.warn("stale", f"no joint_states for {limit:g} s: both clamps close")
            self._close_clamps()

    def _close_clamps(self) -> None:
        """Let the sequencer close what is open, as it does without a measurement, and publish the voltages only."""
        x = self.sequencer.x
        samples = max(round(0.001 * self.parameters.sample_rate), 1)
        deadline = time.monotonic() + CLOSING_TIME
        while time.monotonic() < deadline:
            for _ in range(samples):
                self.sequencer.step(self.setpoint, math.nan, math.nan)
            self._publish(self._outputs[2:])
            if x[at.BAD] > self.sequencer.p[at.SENSOR_SAMPLES] and x[at.PHASE] in (at.HOLDING, at.RELEASED):
                return
            time.sleep(samples / self.parameters.sample_rate)
        # too slow a gait to wait for
        for place in (at.FRONT_VOLTAGE, at.REAR_VOLTAGE):
            x[place] = max(x[place], self.parameters.gait.grip_voltage)
        self._publish(self._outputs[2:])

    def go_safe(self) -> None:
        """Close what is open and leave the voltages on; in lockstep, where time stands still, nothing."""
        if not self.lockstep and self.sample:
            self._close_clamps()

    # -- diagnostics -------------------------------------------------------------------------------------------

    @property
    def _explanation(self) -> str:
        guard = self.parameters.guard
        text = ERRORS[int(self.sequencer.x[at.ERROR])]
        return text.format(still=guard.still_steps, runaway=guard.runaway, slip=guard.slip)

    def health(self):
        """Report errors with what to do, missed steps, refused setpoints, and what the motor does."""
        sequencer, x = self.sequencer, self.sequencer.x
        # in real time a sequencer without measurements has nothing to answer
        stale = self.stale or (not self.lockstep and self.pace.age > max(STALE, 3.0 / self.parameters.sample_rate))
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
        }
        refused = self.since_report("refused", self.refused)
        missed = self.since_report("missed", int(x[at.MISSED]))
        if stale:
            return 2, "joint_states is stale", values
        if not self._complete and not self.lockstep:
            return 1, "waiting for motion_controller, hysteresis_compensator and the clamps' driver", values
        if x[at.ERROR]:
            return 2, self._explanation, values
        if x[at.MODE] == at.STOP:
            return 1, "stopped: both clamps hold", values
        if x[at.MODE] == at.LET_GO:
            return 1, "released: the rear clamp holds alone", values
        if missed:
            return 1, f"{missed} steps missed, slip of the last step {1e6 * x[at.SLIP]:.3g} um", values
        if x[at.LIMITED_SPEED]:
            return 1, f"slower than {x[at.SPEED]:g} m/s: the steps slip", values
        return (1, f"{refused} setpoints or speeds refused", values) if refused else (0, "", values)


def main(arguments=None) -> int:
    """Run the node; returns the exit code."""
    return run([InchwormSequencerNode], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
