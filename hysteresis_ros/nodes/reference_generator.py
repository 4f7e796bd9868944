# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Node ``reference_generator``: setpoints and waveforms → ``reference``, one for every sample.

A generator that starts with its axis begins as configured: at ``initial_setpoint``, with its waveform. A generator that
is restarted on a running axis begins at the present position of the axis, and holds it until a setpoint arrives. It
reads this position from ``~/state`` of the controller, because a measurement also contains the offset of the preload
and the control error.

With an external plant, the generator also begins and ends the run: once the loop is complete and the recorder is
present, it answers the measurements of the external node for the given number of samples.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, UInt64

from hysteresis_ros import signals
from hysteresis_ros.loop.parameters import ReferenceNodeParameters
from hysteresis_ros.loop.reach import steep_warnings
from hysteresis_ros.loop.source import GeneratorSource, refer
from hysteresis_ros.loop.tick import Laws
from hysteresis_ros.loop.watch import FOLLOWING, HOLDING, RUNNING, STOPPED
from hysteresis_ros.models.block import interpreted
from hysteresis_ros.nodes.qos import latched_qos
from hysteresis_ros.nodes.ready import ReadyTopics
from hysteresis_ros.nodes.reference_source import ReferenceSource, nanoseconds
from hysteresis_ros.nodes.scan_clock import NAMES as CLOCK_NAMES
from hysteresis_ros.nodes.scan_clock import TOPIC, ScanClockTopic
from hysteresis_ros.nodes.spin import run
from hysteresis_ros.nodes.timing import STALE, WINDOW, Pairing
from hysteresis_ros.nodes.trajectories import Trajectories, TrajectoryAction, action_type
from hysteresis_ros.references.moves import Settling
from hysteresis_ros.references.waveforms.scan import clock_of

#: Time after the first measurement to search for a controller [s].
CONTROLLER_LOOK = 1.0
#: Time after the first measurement to wait for a controller that is present but sends nothing because it is not active
#: [s].
CONTROLLER_PATIENCE = 5.0

#: Modes of a controller that follows its reference.
LEADING_MODES = (RUNNING, HOLDING, FOLLOWING)


def place_of(state: dict[str, float]) -> float:
    """Return the position [m] that the controller holds, from the signals of its ``~/state``; NaN before any command.

    For a stopped controller this is the command, which moves to ``safe_command``.
    """
    if math.isnan(state["reference"]):
        return math.nan
    return state["reference"] if int(state["mode"]) in LEADING_MODES else state["command"]


class Beginning:
    """Decides whether a reference generator begins as configured or at the position of the axis."""

    def __init__(self, node):
        self._node = node
        self._known = False
        self._since = math.nan
        self._heard = node.subscriber(JointState, "motion_controller/state", self._on_state, node.qos())

    def _on_state(self, message) -> None:
        node = self._node
        if self._known or not node.active:
            return
        self._known = True
        place = place_of(dict(zip(message.name, message.position, strict=True)))
        if math.isfinite(place):
            node.begin_at(place)
            node.get_logger().info(
                f"the axis is running: the reference stays at its position, {place:.6g} m, until a setpoint or ~/start"
            )

    def take(self, message) -> bool:
        """Return whether this measurement may be answered, that is, whether the start of the reference is decided."""
        node = self._node
        if not self._known and node.active:
            now = time.monotonic()
            if math.isnan(self._since):
                self._since = now
            there = node.count_publishers(self._heard.topic_name)
            self._known = now - self._since > (CONTROLLER_PATIENCE if there else CONTROLLER_LOOK)
        if self._known and self._heard is not None:
            node.drop(self._heard)
            self._heard = None
        return self._known


#: Time-out for the beginning of a run of given length [s].
START_PATIENCE = 30.0
#: Interval between log messages while the run waits [s].
START_REPORT = 5.0

#: Number of measurements from the completion of the loop to the first sample, in which the nodes match answers to
#: measurements.
SETTLING_SAMPLES = Pairing.SUSPICION + 20

#: Time from the last sample to the end of the run [s], because on a busy machine other nodes answer later than the
#: source.
END_GRACE = 0.5

#: Smallest number of stamps that determine the rate of the measurements.
RATE_STAMPS = 50
#: Allowed deviation of this rate from ``sample_rate``, as a fraction of it.
RATE_TOLERANCE = 0.1


class ExternalRun:
    """Begins and ends a run with an external plant."""

    def __init__(self, node):
        self._node = node
        self._begun = self._recorded = self._answered = False
        self._stamps: list[int] = []
        self._noted = False
        self._further = self._settled = 0
        self._end = node.publisher(UInt64, "end_of_run", latched_qos())
        topics = ("command", "applied", "voltage", "joint_states")
        self._command, self._applied, self._voltage, self._joint_states = map(node.resolve_topic_name, topics)
        node.subscriber(Float64, "voltage", self._on_voltage, node.qos(), partner="hysteresis_compensator")
        if node.parameters.wait_for_recorder:
            node.subscriber(UInt64, "recorder/acknowledged", self._on_recorder, latched_qos(), partner="recorder")

    def _on_recorder(self, message) -> None:
        self._recorded = True

    def _on_voltage(self, message) -> None:
        """Store that controller and compensator are connected: they have answered before the first reference."""
        self._answered = True

    def begin(self) -> None:
        """Start to wait for the partners."""
        self._since = time.monotonic()
        self._node.timer(0.5, self._look)

    def _absent(self) -> str:
        """Return the missing partners for which the run waits; empty if it does not wait."""
        node = self._node
        partners = {
            "motion_controller": node.count_publishers(self._command),
            "hysteresis_compensator": node.count_publishers(self._applied),
            "a publisher of joint_states (the external plant)": node.count_publishers(self._joint_states),
            # this node and the recorder also subscribe to it
            "a subscriber of voltage (the external plant)": node.count_subscribers(self._voltage)
            > 1 + node.parameters.wait_for_recorder,
            "recorder": self._recorded or not node.parameters.wait_for_recorder,
            "a voltage": self._answered,
            "a subscriber of reference": node.runner.matched(),
        }
        return ", ".join(name for name, there in partners.items() if not there)

    def take(self, message) -> bool:
        """Receive a measurement; return whether it belongs to the run."""
        node = self._node
        if node.finished or node.failure:
            return False
        if not self._begun:
            self._settled = 0 if self._absent() else self._settled + 1
            self._begun = self._settled > SETTLING_SAMPLES
            return self._begun
        if not node.sample:
            self._further = 0  # also after a reset
        self._note(message.header.stamp)
        samples = node.parameters.samples
        if not samples or node.sample < samples:
            return True
        self._further += 1
        if self._further == math.ceil(END_GRACE * node.parameters.sample_rate):
            node.end_of_run = node.sample
            self._end.publish(UInt64(data=node.sample))
            node.get_logger().info(f"{node.sample} samples: the run ends")
            node.leave_when_done()
        return False

    def _note(self, stamp) -> None:
        """Check the rate of the measurements once."""
        if self._noted:
            return
        self._stamps.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
        span = 1e-9 * (self._stamps[-1] - self._stamps[0])
        if len(self._stamps) < RATE_STAMPS or span < WINDOW:
            return
        self._noted = True
        steps = sorted(later - earlier for earlier, later in zip(self._stamps[:-1], self._stamps[1:], strict=True))
        wanted, rate = self._node.parameters.sample_rate, len(steps) / span
        # a burst distorts only the median interval, a gap only the mean; a wrong rate changes both
        usual = 1e9 / max(steps[len(steps) // 2], 1)
        self._stamps.clear()
        if min(abs(rate - wanted), abs(usual - wanted)) > RATE_TOLERANCE * wanted:
            text = f"joint_states arrive at {rate:.6g} Hz, but models and controllers are for sample_rate {wanted:g} Hz"
            self._node.warn("rate", f"{text}; make both equal", error=True, every=0.0)

    def _look(self) -> None:
        """Log at intervals why the run waits; a run of given length has a time-out."""
        node, waited = self._node, time.monotonic() - self._since
        absent = "" if self._begun else self._absent()
        if self._begun or waited < START_REPORT:
            return
        text = f"the run waits for {absent or 'a measurement of the external plant'}"
        if node.parameters.samples and waited > START_PATIENCE:
            node.fail(f"{text} for {waited:.0f} s; start it, and repeat the run")
        else:
            node.warn("waiting", text, every=START_REPORT)


_REFER = interpreted(refer)


class ReferenceGeneratorNode(ReferenceSource):
    """Answers every ``joint_states`` with one ``reference`` [m]; takes ``setpoint`` [m] at any time."""

    parameters: ReferenceNodeParameters
    identity = ("waveform.type",)
    #: Infinite: without measurements there is nothing to answer, so no samples are counted.
    patience = math.inf
    outputs = (("reference", signals.REFERENCE),)

    def __init__(self, **options):
        super().__init__("reference_generator", **options)
        self.trajectories: Trajectories | None = None
        self.action: TrajectoryAction | None = None
        self.ready: ReadyTopics | None = None
        #: Clock of the scan that the axis follows; None: the axis has never followed a scan.
        self.scan_clock: ScanClockTopic | None = None

    def build(self, parameters) -> None:
        """Create the generator from the parameters."""
        self.part = GeneratorSource(parameters)
        self._connect_part()
        self.setpoint = parameters.initial_setpoint
        tolerance = parameters.settled.tolerance or 0.01 * (parameters.maximum - parameters.minimum)
        self.settling = Settling(tolerance, parameters.settled.time, 1.0 / parameters.sample_rate)
        self.compile()

    def step(self) -> None:
        """Compute the sample in the row with the reference source of the loop."""
        _REFER(self._laws, self._arrays, self.row)

    def after_step(self) -> None:
        """Update the moves in progress, and the setpoint, which a trajectory may have changed."""
        super().after_step()
        self.setpoint = self.row[signals.SETPOINT]
        if self.trajectories is not None:
            self.trajectories.look()
        if self.runner.by_message:
            self.look_at((self.row,))
            if self.ready is not None:
                self.ready.look(self.row, self.sample - 1)
        if self.action is not None:
            self.action.tell()

    def retune(self, parameters) -> None:
        """Apply another waveform while stopped."""
        self.part.retune(parameters)
        self._connect_part()

    def retuned(self, parameters) -> None:
        """Let the clock of the scan follow the new waveform, and create the topic of the triggers if needed."""
        super().retuned(parameters)
        self.offer_triggers(parameters)
        if parameters.waveform != self.parameters.waveform:
            if self.is_fused:
                self.fused.show()  # publishes the samples of the previous waveform
                self.warn_of_slope(parameters)
            self.follow_scan(parameters.waveform)

    def warn_of_slope(self, parameters) -> None:
        """Warn of a waveform that the slew rate of the voltage limits; only if fused, to know the other nodes."""
        axis = replace(self.fused.present_parameters(), reference_generator=parameters)
        if found := steep_warnings(axis):
            self.warn("steep", "; ".join(found))

    def follow_scan(self, waveform) -> None:
        """Let the clock follow the scan of a waveform; without a scan it publishes nothing."""
        scans = waveform.type == "scan" and waveform.scan.clock != "none"
        if scans and self.scan_clock is None:
            self.scan_clock = self.make_scan_clock()
        if self.scan_clock is not None:
            self.scan_clock.follow(clock_of(waveform, 1.0 / self.parameters.sample_rate) if scans else None)

    def make_scan_clock(self) -> ScanClockTopic | None:
        """Return the topic of the clock."""
        return ScanClockTopic(self, TOPIC)

    def report(self, stamp) -> None:
        """Publish the scan edges, then ``~/state``."""
        if self.scan_clock is not None and self.runner.by_message:
            self.scan_clock.take(nanoseconds(stamp), self.row[signals.WAVEFORM_SAMPLE], self.scan_axis)
        super().report(stamp)

    #: Index of this axis among the axes that follow the same scan.
    scan_axis = 0

    def _connect_part(self) -> None:
        self._laws = Laws(*(self.part.waveform,) * len(Laws._fields))
        self._arrays = self.part.arrays
        if problem := self.part.generator.unreached_level():
            self.warn("steps", str(problem))

    def note_pulses(self) -> None:
        """Note whether the trigger input has started or stopped the generator."""
        if self.parameters.triggers.input.action in ("start", "hold"):
            self.running = self.row[signals.SOURCE_MODE] != STOPPED

    def before_step(self) -> None:
        """Put setpoint and pulses of the trigger input into the row."""
        super().before_step()
        self.row[signals.SETPOINT] = self.setpoint

    def connect(self) -> None:
        """Create the topics."""
        self._run = ExternalRun(self) if self.parameters.external_plant else None
        self._beginning = Beginning(self) if self.runner.by_message and not self.runner.exact else None
        super().connect()
        self.ready = ReadyTopics(self)
        self.trajectories = Trajectories(self)
        kind = action_type()
        self.action = TrajectoryAction(self, self.trajectories, kind) if kind else None
        self.follow_scan(self.parameters.waveform)

    def begin(self) -> None:
        """Start work, and monitor an external plant."""
        super().begin()
        self.forget_settled()
        if self.trajectories is not None:
            self.trajectories.begin()
        if self._run is not None:
            self._run.begin()

    def release(self) -> None:
        """Abort the moves in progress."""
        super().release()
        if self.trajectories is not None:
            self.trajectories.give_up("the node has stopped working")
        if self.ready is not None:
            self.ready.stop("the node has stopped working")

    def unbuild(self) -> None:
        """Remove the action."""
        if self.action is not None:
            self.action.server.destroy()
        if self.ready is not None:
            self.ready.end()
        self.trajectories = self.action = self.scan_clock = self.ready = None

    def forget_settled(self) -> None:
        """Restart the settling detection, because an axis without measurements has not settled."""
        self.settling.restart()
        if self.ready is not None:
            self.ready.fall_silent()

    @property
    def offset(self) -> float:
        """Preload offset of the controller [m], which the measurement contains but the reference does not."""
        return 0.0 if self.ready is None else self.ready.offset

    def look_at(self, rows) -> None:
        """Update the settling detection with samples."""
        look, offset = self.settling.look, self.offset
        for row in rows:
            if not row[signals.SKIPPED]:  # no measurement
                stopped = row[signals.TRIPPED] != 0.0
                look(row[signals.SETPOINT], row[signals.REFERENCE], row[signals.MEASURED] - offset, stopped)
        self.tell_settled(self.settling.settled)

    def show_all(self, first: int, table) -> None:
        """Take the new samples of a fused loop, beginning with number ``first``, shape (row length, N)."""
        super().show_all(first, table)
        if self.ready is not None:
            self.ready.look_at_all(first, table)
        clock = self.scan_clock
        if clock is not None:
            self.recorded(clock, CLOCK_NAMES)
            clock.take_all(first, table, self.fused.plant.stamps.of_all, self.scan_axis)

    def steer(self, action: str, parameters: dict | None = None) -> None:
        """Let the reference follow a trajectory, or come to rest, beginning with the next sample; log this change."""
        if self.is_fused:
            self.fused.apply(self.kind, action, parameters)
        else:
            getattr(self.part, action)(**(parameters or {}))
            self.log_change(action, parameters)

    @property
    def take_measurement(self):
        """Return the callback of ``joint_states``; measurements of an external plant outside the run are ignored."""
        awaited = [one for one in (self._beginning, self._run) if one is not None]
        taken = self.runner.measurement
        if not awaited:
            return taken
        return lambda message: taken(message) if all(one.take(message) for one in awaited) else None

    def begin_at(self, position: float) -> None:
        """Begin at the position of a running axis [m]; if a setpoint has arrived meanwhile, move to it from there."""
        asked = self.setpoint != self.parameters.initial_setpoint
        self.part.begin_at(position)
        if not asked:
            self.setpoint = self.part.generator.setpoint
        self.log_change("begin_at", {"position": position})

    @property
    def unasked(self) -> bool:
        """Whether the generator holds its initial position because it has received no request."""
        return self.part is not None and self.part.generator.unasked

    def on_running(self, running: bool) -> None:
        """Hold the reference (``~/stop``), or run the waveform from its beginning (``~/start``)."""
        if running and self.unasked:
            self.setpoint = self.parameters.initial_setpoint
        super().on_running(running)

    def _on_start(self, request, response):
        if self.running and self.part is not None and self.part.generator.waits and not self.is_fused:
            self.on_running(True)
        return super()._on_start(request, response)

    def reset_blocks(self) -> None:
        """Reset the waveform to its start, and the setpoint to the configured one."""
        super().reset_blocks()
        self.setpoint = self.parameters.initial_setpoint
        if self.ready is not None:
            self.ready.stop("the axis was reset")

    def take_setpoint(self, value: float) -> str:
        """Take a setpoint [m]; return why it is refused, or an empty text if it is taken."""
        reason = self.part.generator.refuse(value)
        if reason:
            return reason
        before, self.setpoint = self.setpoint, value
        if self.ready is not None and (value != before or self.ready.asked):
            self.ready.begin(before, value)
        if self.is_fused:
            self.fused.set(setpoint=self.setpoint)
        return ""

    def health(self):
        """Report refused setpoints and the present values."""
        # in real time, measurements are missing if the last answered sample is long ago
        stale = not self.runner.exact and self.pace.age > max(STALE, 3.0 / self.parameters.sample_rate)
        values = {"setpoint_m": f"{self.setpoint:.9g}", "setpoints_refused": self.refused, "stale": stale}
        lost = 0
        if self.trigger_out is not None:
            values["triggers_lost"] = self.trigger_out.lost
            lost = self.since_report("triggers_lost", self.trigger_out.lost)
        refused = self.since_report("refused", self.refused)
        if stale:
            return 2, "joint_states is stale", values
        if self.row[signals.TRIPPED]:
            return 2, "the plant has stopped the axis", values
        begun = "holds the initial position of the axis; send a setpoint, or call ~/start" if self.unasked else ""
        if lost:
            return 1, f"{lost} triggers followed too fast and were lost: move slower, or give a larger distance", values
        return (1, f"{refused} setpoints refused", values) if refused else (0, begun, values)


def main(arguments=None) -> int:
    """Run the node; return the exit code."""
    return run([ReferenceGeneratorNode], arguments, steered=True)


if __name__ == "__main__":
    raise SystemExit(main())
