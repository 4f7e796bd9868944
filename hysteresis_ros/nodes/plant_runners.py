# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Runners of the plant: a sample begins when all nodes have answered the previous one, or at its scheduled time."""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from array import array

from std_msgs.msg import String

from hysteresis_ros.hardware.device import METHOD_PATIENCE
from hysteresis_ros.nodes.lockstep import STARTUP_TIMEOUT, TOGETHER, Lockstep
from hysteresis_ros.nodes.qos import latched_qos
from hysteresis_ros.nodes.realtime import (
    ANOTHER_PROCESS,
    AT_WORK,
    GONE,
    HEARD,
    HERE,
    LEAST_MISSED,
    LONGEST_CHECK,
    LOST,
    PLANT,
    PRESENCES,
    STARTED,
    STARTING,
    AwakeTime,
    RealTime,
)
from hysteresis_ros.nodes.spin import QUIET

#: Real time: the last part of a wait [s] is a sleep, which is more accurate but cannot be interrupted.
EXACT_WAIT = 0.02

#: Interval at which the output of a device is repeated while no samples are computed [s].
PAUSE = 0.01

#: Number of nodes of an axis that read joint_states.
READERS = 3

#: Delay [periods] above which the schedule is shifted; the loop catches up on smaller delays.
FAR_BEHIND = 10.0

#: After this time without a voltage [s], no voltage is pending, unless ALIGN_PERIODS periods are longer.
ALIGN_QUIET = 0.1
#: After this number of periods without a voltage, no voltage is pending, unless ALIGN_QUIET is longer.
ALIGN_PERIODS = 3.0
#: The maximum wait is this multiple of the longer of both times.
ALIGN_PATIENCE = 5.0

#: Nodes whose absence opens the loop.
CLOSERS = frozenset({"motion_controller", "hysteresis_compensator", "inchworm_sequencer"})

#: After a node has joined the loop, voltages are counted again when this number of consecutive samples has been
#: answered.
SETTLED = 10
#: After a node has joined the loop, voltages are counted again after this number of samples at the latest.
LONGEST_SETTLING = 100

#: Number of samples whose publication time is stored.
PUBLISHED = 1024

#: Number of stored response times, from which the achievable rate is estimated.
ANSWERS = 256


class LockstepPlant(Lockstep):
    """Publishes sample k, and continues with k + 1 when all voltages of k have arrived."""

    def clear(self) -> None:
        """Reset the run: the next sample is number 0."""
        super().clear()
        self.restart()

    def restart(self) -> None:
        """Start at sample 0."""
        self.is_measured = False
        self._ended = False
        self._came: set[str] = set()
        self._acknowledged = 0

    def connect(self) -> None:
        """Create the topics of the protocol."""
        super().connect()
        if self.node.parameters.wait_for_recorder:
            self._acknowledged = -1

    def start_time(self) -> None:
        """Publish whether the time is running or paused."""
        self.say("running" if self.node.running else "paused")

    def stop_time(self) -> None:
        """Do nothing: lockstep advances with messages only."""

    def hold(self, held: bool) -> None:
        """Pause the time of the axis, or resume it."""
        self.say("paused" if held else "running")
        self.advance()

    def go_on(self) -> None:
        """Do nothing: every voltage belongs to the present sample, and the next sample shows that the axis runs."""

    is_quiet = True

    def advance(self) -> None:
        """Publish the present sample if partners and recorder are ready."""
        if self.may_begin() and self.begin_sample():
            self.node.publish_sample()

    def may_begin(self) -> bool:
        """Return whether the present sample can begin: it has not begun yet, and partners and recorder are ready."""
        node = self.node
        if self.is_measured or self._ended or node.failure or not node.running or not node.active:
            return False
        return self.matched() and not self._recorder_behind()

    def begin_sample(self) -> bool:
        """Let the present sample wait for its voltages; after the last sample, end the run and return False."""
        node = self.node
        if node.parameters.samples and node.sample >= node.parameters.samples:
            self._ended = True
            node.finish()
            return False
        self.is_measured = True
        self._came.clear()
        self.reset_pending = False
        node.pace.tick()
        return True

    @property
    def is_answered(self) -> bool:
        """Whether all voltages of the present sample have arrived."""
        return self.is_measured and len(self._came) == len(self.node.inputs)

    def finish_sample(self) -> None:
        """Apply the voltages of the present sample and advance to the next one."""
        self.is_measured = False
        self.node.finish_sample()
        self.advance()

    def _recorder_behind(self) -> bool:
        parameters = self.node.parameters
        if not parameters.wait_for_recorder:
            return False
        return self._acknowledged < 0 or self.node.sample - self._acknowledged >= parameters.lead

    def voltage(self, input_, message) -> None:
        """Receive the voltage of the present sample; any other voltage ends the run with an error."""
        node = self.node
        if self._ended or not node.active or node.failure:
            return
        again = input_.topic in self._came
        if not self.is_measured or again:
            # a voltage before sample 0, or of a compensator that exits while the time is paused, is ignored
            if (self.is_measured and again) or (node.sample and node.running and not self._recorder_behind()):
                text = f"a voltage on {input_.topic} does not belong to sample {node.sample}"
                node.fail(f"{text}: {input_.partner} was restarted, or there are two; {TOGETHER}")
            return
        self.heard()
        node.receive(input_, message.data)
        self._came.add(input_.topic)
        if self.is_answered:
            self.finish_sample()

    def acknowledged_by_recorder(self, message) -> None:
        """Store the last sample acknowledged by the recorder."""
        self._acknowledged = message.data
        self.heard()
        self.advance()

    def missing_voltage(self) -> str:
        """Return the partner whose input for the present sample is missing."""
        if not self.matched():
            return "every reader of joint_states"
        if self.is_measured:
            missing = [input_ for input_ in self.node.inputs if input_.topic not in self._came]
            # the voltage of the extender depends on the other inputs, so the partner of a later missing input is closer
            # to the cause
            return f"{missing[-1].partner} (topic {missing[-1].topic})"
        return "recorder" if self._recorder_behind() else ""

    @property
    def late_samples(self) -> int:
        """Number of samples so far whose voltage was late."""
        return self.node.part.late

    def explain_trip(self) -> str:
        """Return why the plant has stopped the axis."""
        limit = self.node.parameters.allowed_late
        return f"more than {limit} voltages were missing in a row or within a second; call ~/start to resume"


def remedy_for_late_voltages(device: bool, alone: bool) -> str:
    """Return a remedy for late voltages, with a ``device`` or simulated; ``alone``: no other node in the process."""
    remedies = ["lower sample_rate" if device else "lower sample_rate or real_time_factor"]
    remedies += ["run the nodes composed"] if alone else []
    remedies += ["run the axis fused" if device else "run in lockstep"]
    return f"{', '.join(remedies[:-1])}, or {remedies[-1]}"


#: Number of looks at a driver in the time after which it is reported as blocked.
LOOKS = 10


def blocked_text(node, sample: int, patience: float) -> str:
    """Return that the driver of a plant has not returned for ``patience`` [s], and what becomes of the voltage."""
    watchdog = node.part.capabilities.watchdog if node.parameters.driver else 0.0  # another axis of a stage has one
    acts = (
        f"makes the device safe after {watchdog:g} s without a voltage"
        if watchdog
        else "does not exist, so the device keeps its last voltage"
    )
    return (
        f"driver {node.parameters.driver} has not returned from sample {sample} for {patience:g} s: no voltage is "
        f"sent; the device's own watchdog {acts}; remove what blocks the driver"
    )


class RealTimePlant(RealTime):
    """Starts each sample at its scheduled time, in a thread with absolute deadlines.

    A voltage carries no number, so it is assigned to a sample by count. A voltage that answers an earlier sample is
    late; the last punctual voltage is held instead, unless ``late_limit`` allows any number of late voltages or the
    loop is open. When the first voltages arrive, after a reset, and after ``~/start`` of a stopped axis, the number of
    unanswered samples is unknown. The next sample then waits until no voltage is pending, and the count starts with
    this sample. A node that joins a running axis does not delay the samples: voltages are accepted as they arrive, and
    counted again when some consecutive samples have been answered.
    """

    def __init__(self, node):
        self._thread = None
        self._leaving = threading.Event()
        self._runs = 0
        self._ended = False
        self._acknowledged = -1
        self.is_measured = False
        self._published = array("d", bytes(8 * PUBLISHED))
        self._answers = array("d", bytes(8 * ANSWERS))
        self._answered = 0
        # the timing thread writes _asked, the executor writes _given
        self._asked = 0
        self._given: dict[str, int] = {}
        self._heard: dict[str, float] = {}  #: Time of the last voltage on each topic [s], see :class:`.AwakeTime`.
        self._unaligned = False
        self._settling = self._unsettled = 0
        super().__init__(node)
        self._awake_time = AwakeTime(min(max(LONGEST_CHECK, 2.0 * self.period), 0.5 * self._loss_time))

    def connect(self) -> None:
        """Subscribe to the presence of the nodes."""
        super().connect()
        self._known: set[str] = set()
        self._gone: set[str] = set()
        self._coming: set[str] = set()
        self._lost: dict[str, str] = {}
        self.node.subscriber(String, "run_state", self._on_presence, latched_qos(PRESENCES))

    def _on_presence(self, message) -> None:
        node = self.node
        state, partner, reporter, name = (*message.data.split(" "), "", "", "", "")[:4]
        if state in (GONE, HERE) and partner != PLANT:
            self._lost.pop(partner, None)
            if partner in CLOSERS and state == GONE:
                self._gone.add(partner)
            elif partner in CLOSERS:
                self._known.add(partner)
                if partner in self._gone:
                    self._gone.discard(partner)
                    self._coming.add(partner)
                    self._await_voltages()
                self.settle()
        elif state in (LOST, HEARD) and node.active and node.running and reporter != node.kind:
            if state == LOST:
                self._lost[reporter] = name
            else:
                self._lost.pop(reporter, None)
            # a plant that was restarted after its loss may have missed the first message, so the message is repeated
            if state == LOST or (partner == PLANT and not node.part.tripped):
                with node.lock:
                    node.lose(name)

    def clear(self) -> None:
        """Reset to the initial state."""
        super().clear()
        self._lost = {}

    def missing_partners(self) -> str:
        """Return the lost nodes without which the axis cannot continue; empty if all are present."""
        now = self._awake_time.at(time.monotonic())
        stopped = self.node.inputs if self.node.part.silent else ()
        silent = {input_.partner for input_ in stopped if self._is_silent(input_, now)}
        return " and ".join(sorted({*self._lost.values(), *silent}))

    @property
    def _loss_time(self) -> float:
        """Time of silence after which a partner is lost [s]."""
        return max(self.node.patience * self.period * self.node.parameters.sample_rate, LEAST_MISSED * self.period)

    def _is_silent(self, input_, now: float) -> bool:
        """Return whether an active node is silent for more than its time-out; ``now`` [s]: :class:`.AwakeTime`."""
        limit = self._loss_time
        if input_.received - input_.first < STARTING:
            limit = max(limit, STARTING)
        at_work = input_.count >= (1 if input_.partner in self._known else AT_WORK)
        return at_work and now - self._heard.get(input_.topic, now) > limit

    def replaced(self, topic: str, name: str) -> None:
        """Handle voltages from a new process of a node; the old process is lost unless it announced its stop."""
        node = self.node
        for input_ in node.inputs:
            partner = input_.partner
            if input_.full_name != topic or not input_.count or partner in self._gone or partner in self._coming:
                continue
            if node.active and node.running and not node.part.lost:
                node.warn("lost", f"{name or partner} is lost: {ANOTHER_PROCESS}", every=0.0, error=True)
                with node.lock:
                    node.lose(name or partner)

    def _await_voltages(self) -> None:
        """Restart the measurement of silence, because no voltage could be sent while a partner was inactive."""
        now = time.monotonic()
        for input_ in self.node.inputs:
            input_.first = now
            self._heard[input_.topic] = self._awake_time.at(now)

    def _look_for_losses(self) -> None:
        """Stop the axis if voltages have stopped without an announcement; called with the lock held."""
        node, part = self.node, self.node.part
        now = self._awake_time.look(time.monotonic())
        if part.silent and not self._gone and not node.leaving and not self._lost:
            silent = [input_.partner for input_ in node.inputs if self._is_silent(input_, now)]
            if silent and not part.lost:
                node.lose(silent[0])
        if part.lost:
            part.lose(part.lost)  # the loss remains the reason, even after many late voltages

    def align(self) -> None:
        """Restart the count of voltages before the next sample, which waits until no voltage is pending."""
        self._unaligned = True

    def go_on(self) -> None:
        """Restart the count of voltages, and announce that the user has started the axis; called with the lock held."""
        self.align()
        self._presence.publish(String(data=f"{STARTED} {PLANT}"))

    def settle(self) -> None:
        """Restart the count of voltages while the samples continue."""
        self._settling, self._unsettled = SETTLED, LONGEST_SETTLING

    def _settle(self) -> bool:
        """Return whether this sample is not counted, after a node has joined; called with the lock held."""
        if not self._settling:
            return False
        answered = all(math.isfinite(input_.value) for input_ in self.node.inputs)
        self._settling = self._settling - 1 if answered else SETTLED
        self._unsettled -= 1
        if not self._unsettled:
            self._settling = 0
        self._given = dict.fromkeys(self._given, self._asked)
        self.node.part.forgive()
        return True

    @property
    def thread(self):
        """The timing thread, or None."""
        return self._thread

    def start_time(self) -> None:
        """Start the timing thread."""
        self.node.stamps.go_on(self.node.sample)
        self._start()

    def _start(self) -> None:
        self._ended = False
        self._leaving.clear()
        self._thread = threading.Thread(target=self._keep_time, name="plant_time", daemon=True)
        self._thread.start()
        if any(node.parameters.driver for node in self.plants):
            threading.Thread(target=self._watch_drivers, args=(self._thread,), daemon=True).start()

    @property
    def plants(self) -> list:
        """The plants whose samples the timing thread computes."""
        return [self.node]

    def _watch_drivers(self, thread: threading.Thread) -> None:
        """End this process if a call of a driver does not return, because other threads wait for the sample.

        Looks are counted, not the time, which also passes while this process is suspended.
        """
        driven = [node for node in self.plants if node.parameters.driver]
        before, looks = [None] * len(driven), 0
        while thread.is_alive():
            thread.join(METHOD_PATIENCE / LOOKS)
            begun = [node.part.called_at for node in driven]
            stuck = [node for node, now, then in zip(driven, begun, before, strict=True) if now and now == then]
            before, looks = begun, looks + 1 if stuck else 0
            if looks >= LOOKS:
                stuck[0].get_logger().fatal(blocked_text(stuck[0], stuck[0].sample, METHOD_PATIENCE))
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(1)

    def stop_time(self) -> None:
        """Stop the timing thread."""
        self._leaving.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def restart(self) -> None:
        """Start at sample 0; called with the lock held."""
        self._runs += 1
        self.align()
        self._ended = False
        self.is_measured = False
        self.node.stamps.go_on(self.node.sample)
        if self._thread is not None and not self._thread.is_alive():
            self._start()  # it has ended with the last run

    def hold(self, held: bool) -> None:
        """Pause or resume the time of the axis; inform the other nodes, so that they do not count the plant as lost."""
        self._excuse(held)
        if not held:
            with self.node.lock:
                self.node.stamps.go_on(self.node.sample)

    def _excuse(self, held: bool) -> None:
        """Publish that samples pause or resume."""
        self._presence.publish(String(data=f"{GONE if held else HERE} {self.node.kind}"))

    def voltage(self, input_, message) -> None:
        """Receive a voltage; the last voltage before the deadline is used."""
        node = self.node
        if not input_.received:
            self.align()
        elif node.part.silent:
            self.settle()
        self._coming.discard(input_.partner)
        given = self._given[input_.topic] = min(self._given.get(input_.topic, 0) + 1, self._asked)
        node.receive(input_, message.data)
        if math.isfinite(message.data):
            self._heard[input_.topic] = self._awake_time.at(time.monotonic())
        if input_.received:
            self._answers[self._answered % ANSWERS] = input_.received - self._published[given % PUBLISHED]
            self._answered += 1

    def acknowledged_by_recorder(self, message) -> None:
        """Store that the recorder is present."""
        self._acknowledged = message.data

    def missing_voltage(self) -> str:
        """Return an empty text, because in real time the plant waits for no partner."""
        return ""

    @property
    def is_quiet(self) -> bool:
        """Whether no voltage has arrived for ``QUIET`` seconds, so that no voltage is pending."""
        return all(time.monotonic() - input_.received > QUIET for input_ in self.node.inputs)

    @property
    def late_samples(self) -> int:
        """Number of samples so far whose voltage was late."""
        return self.node.part.late

    def explain_trip(self) -> str:
        """Return why the plant has stopped the axis, the rate that this graph achieves, and a remedy."""
        parameters = self.node.parameters
        rate = parameters.sample_rate * parameters.real_time_factor
        text = f"more than {parameters.allowed_late} voltages came late within a second, at {rate:.6g} Hz"
        answers = sorted(self._answers[: min(self._answered, ANSWERS)])
        if answers:
            slow = max(answers[int(0.99 * (len(answers) - 1))], 1e-9)
            text += f"; this graph answers within {1e3 * slow:.3g} ms (99 %), which is enough for {0.5 / slow:.3g} Hz"
        executor = self.node.executor
        alone = executor is None or len(executor.get_nodes()) < 2
        remedy = remedy_for_late_voltages(bool(parameters.driver), alone)
        return f"{text}; {remedy}; then call ~/start (late_limit sets how many may be late)"

    def _keep_time(self) -> None:
        try:
            self._keep_time_until_left()
        except BaseException as error:  # otherwise the thread would end without a message
            self.node.fail(f"the timing thread failed: {type(error).__name__}: {error}")

    def _keep_time_until_left(self) -> None:
        node, period = self.node, self.period
        if node.sample == 0 and node.parameters.samples:
            self._await_partners()
        deadline = time.monotonic()
        while not self._leaving.is_set() and not self._ended:
            if not node.running:
                self._pause(PAUSE)
                deadline = time.monotonic()
                continue
            if self.align_now():
                deadline = time.monotonic()
            with node.lock:
                self.begin_sample()
                published = self._runs
            deadline += period
            if not self._wait_until(deadline):
                return
            behind = time.monotonic() - deadline > FAR_BEHIND * period
            if behind:
                deadline = time.monotonic()  # shift the schedule; samples are never dropped
            with node.lock:
                if self._runs != published:
                    continue  # after a reset there is no sample to end
                self.end_sample(behind)

    def begin_sample(self) -> None:
        """Publish the present sample; called with the lock held."""
        self.ask()
        self.node.publish_sample()

    def ask(self) -> None:
        """Record that the voltages of the present sample are expected."""
        self.node.pace.tick()
        self.is_measured = True
        self._published[(self._asked + 1) % PUBLISHED] = time.monotonic()
        self._asked += 1

    def end_sample(self, behind: bool) -> None:
        """Apply the voltages that have arrived and advance to the next sample; called with the lock held."""
        self.close_answers()
        before = self.node.part.tripped
        self.node.finish_sample()
        self.go_to_next(before, behind)

    def close_answers(self) -> None:
        """Accept no more voltages for the present sample, and drop those that are late.

        Voltages that are missing because this node exits do not count as late.
        """
        self.is_measured = False
        if not self._settle():
            self._drop_late()
        if self.node.leaving:
            self.node.part.forgive()

    def go_to_next(self, before: bool, behind: bool) -> None:
        """Handle a stop of the axis, unless it was stopped ``before``; shift the schedule if it is ``behind``."""
        node = self.node
        late = node.part.tripped and not before and not node.part.failure
        if late and self._is_open:
            node.part.start()
        self._look_for_losses()
        if behind or node.stamps.are_off_clock:
            node.stamps.go_on(node.sample)
        if node.parameters.samples and node.sample >= node.parameters.samples:
            self._ended = True
            node.finish()

    def _pause(self, duration: float) -> None:
        """Wait for a moment while no samples are computed, and repeat the output of a device."""
        with self.node.lock:
            self.node.part.refresh()
        self._leaving.wait(duration)

    @property
    def _is_open(self) -> bool:
        """Whether the loop is open, so that voltages do not answer samples."""
        return bool(self._gone) or not self.node.loop_complete()

    def _drop_late(self) -> None:
        """Drop voltages that answer earlier samples, because an unknown delay may make the loop unstable."""
        node = self.node
        behind = [input_ for input_ in node.inputs if self._is_behind(input_)]
        if not behind or self._is_open:
            return
        if not node.parameters.allowed_late:
            if all(math.isfinite(input_.value) for input_ in node.inputs):
                node.part.count_late()
            return
        node.part.await_voltages()
        for input_ in behind:
            input_.value = math.nan

    def _is_behind(self, input_) -> bool:
        """Return whether, by count, only voltages of earlier samples have arrived."""
        return bool(input_.received) and self._given.get(input_.topic, 0) < self._asked

    @property
    def is_unaligned(self) -> bool:
        """Whether the count of voltages must restart before the next sample."""
        return self._unaligned

    def align_now(self) -> bool:
        """If the count must restart, wait until no voltage is pending and restart it; return whether it did."""
        if self._unaligned:
            self._align()
            return True
        return False

    def _align(self) -> None:
        """Wait until no voltage is pending, and then start the count."""
        node = self.node
        self._unaligned = False
        self._settling = 0
        self._excuse(True)
        quiet = max(ALIGN_QUIET, ALIGN_PERIODS * self.period)
        until = time.monotonic() + ALIGN_PATIENCE * quiet
        while not self._leaving.is_set() and time.monotonic() < until:
            idle = time.monotonic() - max(
                self._published[self._asked % PUBLISHED], *(input_.received for input_ in node.inputs)
            )
            if idle > quiet:
                break
            self._pause(min(PAUSE, 0.1 * quiet))
        with node.lock:
            self._given = dict.fromkeys(self._given, self._asked)
            node.part.forgive()
            node.pace.restart()
            node.stamps.go_on(node.sample)
        self._excuse(False)

    def _await_partners(self) -> None:
        """Let a run of given length wait until the loop is complete; a run without end does not wait."""
        node = self.node
        waits = node.parameters.wait_for_recorder
        patience = time.monotonic() + STARTUP_TIMEOUT
        while time.monotonic() < patience and not self._leaving.wait(0.02):
            if self.is_awaited(waits):
                break
        with node.lock:
            if not node.sample:
                node.stamps.go_on(node.sample)

    def is_awaited(self, recorded: bool) -> bool:
        """Return whether the loop is complete and, if ``recorded`` is set, the recorder is present."""
        node = self.node
        complete = node.readers() >= READERS + recorded
        complete = complete and all(node.count_publishers(input_.full_name) for input_ in node.inputs)
        return complete and not (recorded and self._acknowledged < 0)

    def _wait_until(self, deadline: float) -> bool:
        """Wait until ``deadline``; return False if the node exits."""
        wait = deadline - time.monotonic()
        if wait > EXACT_WAIT:
            self._leaving.wait(wait - EXACT_WAIT)
            wait = deadline - time.monotonic()
        if wait > 0.0 and not self._leaving.is_set():
            time.sleep(wait)
        return not self._leaving.is_set()
