# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Fused mode: one compiled thread runs the loop of an axis; the nodes in the same process publish and control it.

The nodes keep their names, topics, parameters, services and diagnostics. Requests go to the loop
(:mod:`hysteresis_ros.loop.fused`), which applies them at the boundary of a sample; the nodes publish its samples at
``publish_rate``, with the stamps of the samples. The ring of the loop holds every sample.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time

from hysteresis_ros import signals
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.loop.axis import Axis, Change
from hysteresis_ros.loop.fused import BLOCKED, FusedLoop, require_speed
from hysteresis_ros.loop.parameters import AxisParameters, RecorderNodeParameters
from hysteresis_ros.nodes.realtime import RealTime
from hysteresis_ros.nodes.samples import SampleStream
from hysteresis_ros.nodes.timing import CountedRate
from hysteresis_ros.references import inchworm_layout as gait


class LoopPace:
    """Rate, jitter and missed deadlines of the loop, in the form of :class:`hysteresis_ros.nodes.timing.Pace`."""

    def __init__(self, fused):
        self._fused = fused
        self._last = 0.0
        self._rate = CountedRate()

    @property
    def total(self) -> int:
        """Samples so far."""
        loop = self._fused.loop
        return loop.sample if loop is not None else 0

    @property
    def overruns(self) -> int:
        """Samples so far that were skipped."""
        loop = self._fused.loop
        return loop.missed if loop is not None else 0

    @property
    def age(self) -> float:
        """Time since the last new sample [s]; infinite before the first."""
        return time.monotonic() - self._last if self._last else float("inf")

    def tick(self) -> None:
        """Record that there are new samples."""
        self._last = time.monotonic()

    def restart(self) -> None:
        """Discard the last samples, so that a pause does not affect the rate."""
        self._rate.restart()
        self._rate.begin(time.monotonic(), self.total)

    def read(self) -> tuple[float, float]:
        """Return the rate of the last second [Hz] and the lateness that 99 % of all samples do not exceed [s]."""
        rate = self._rate.read(time.monotonic(), self.total)
        loop = self._fused.loop
        return rate, loop.lateness().p99 if loop is not None else 0.0


#: Time for the voltage to reach its safe value before the loop of an exiting node ends [s].
RETURN = 2.0
#: Maximum time that Python blocks the loop when it applies a change [s].
SWITCH_INTERVAL = 5e-4

#: Time after which a loop that is not ready yet is being compiled [s]: one from the cache takes less.
COMPILING = 2.0
COMPILING_TEXT = (
    "compiling the loop, which takes 10 to 60 s once; the nodes do not answer meanwhile, and the next start takes it "
    "from the cache"
)

#: Parts that are stopped while their nodes are inactive, in the order of their restart.
STOPPABLE = ("hysteresis_compensator", "motion_controller")


class FusedAxis:
    """The nodes of one axis in this process, and the loop that runs once all of them are active."""

    def __init__(self) -> None:
        self.nodes: dict = {}
        self.loop: FusedLoop | None = None
        self.axis: Axis | None = None
        self._told: set[int] = set()
        self._over = self._leaving = False

    def join(self, node):
        """Add a node to the axis, and return it."""
        node.fused = self
        self.nodes[node.kind] = node
        return node

    def leave(self, node) -> None:
        """Remove a node; the loop ends with the first one."""
        self.end()
        self.nodes.pop(node.kind, None)
        node.fused = None

    @property
    def plant(self):
        """The node of the plant."""
        return self.nodes["plant_simulator"]

    @property
    def source(self):
        """The node of the reference source."""
        return self.nodes[signals.kind_of(self.nodes).source]

    # -- beginning and end ---------------------------------------------------------------------------------------

    def activated(self, node) -> None:
        """Record an activated node; the last one starts the loop."""
        if self.loop is not None:
            if node.kind in STOPPABLE and node.running:
                self.apply(node.kind, "start")
            elif node.kind == "plant_simulator":
                self._leaving = False
                if node.running:
                    self.go_on()
        elif all(other.active for other in self.nodes.values()):
            self._begin()

    def deactivated(self, node) -> None:
        """Move the outputs of a deactivated node to their safe values; for the plant, those of all nodes."""
        if self.loop is None or self.loop.is_blocked:
            return
        if node.kind in STOPPABLE:
            self.apply(node.kind, "stop")
        elif node.kind == "plant_simulator":
            self._make_safe()

    def _begin(self) -> None:
        parameters = self._parameters()
        plant = parameters.plant_simulator
        with self._compilation_reported():
            require_speed(parameters)
            device = self.plant.part if plant.driver else None
            if device is not None:
                device.reset()
            axis = Axis(parameters, device)
            first = axis.sample
            loop = FusedLoop(axis, plant.real_time_factor, plant.samples, warn=self._warn)
        for name, part in axis.by_node.items():
            self.nodes[name].take_part(part)
        for name in STOPPABLE:
            if not self.nodes[name].running:
                loop.apply(Change(first, name, "stop"))
        source = self.source
        if source.setpoint != source.parameters.initial_setpoint:
            loop.set(setpoint=source.setpoint)
        self.axis, self.loop = axis, loop
        self._over = self._leaving = False
        self._told.clear()
        self._reader = loop.reader()
        sys.setswitchinterval(SWITCH_INTERVAL)
        if "recorder" in self.nodes:
            self.nodes["recorder"].record_loop(self)
        loop.start()
        self.plant.begin_run(loop.origin)
        if not self.plant.running:
            loop.halt()

    @contextlib.contextmanager
    def _compilation_reported(self):
        """Log that the loop is being compiled if what is done here takes long."""
        report = threading.Timer(COMPILING, self.plant.get_logger().info, [COMPILING_TEXT])
        report.start()
        try:
            yield
        finally:
            report.cancel()

    def _parameters(self) -> AxisParameters:
        plant = self.plant
        parts = {name: self.nodes[name].parameters for name in plant.axis_kind.nodes}
        recorder = self.nodes["recorder"].parameters if "recorder" in self.nodes else RecorderNodeParameters()
        return AxisParameters.of_nodes(plant.get_namespace().rstrip("/"), {**parts, "recorder": recorder})

    def _warn(self, text: str) -> None:
        self.plant.get_logger().warning(f"real time: {text}")

    def end(self) -> None:
        """End the loop, if there is one; its samples are still published and recorded.

        When a device does not return, its loop remains until the process ends, and no other thread may call the device.
        """
        if self.loop is None:
            return
        ended = self.loop.leave()
        self.show()
        if not ended:
            return
        if "recorder" in self.nodes:
            self.nodes["recorder"].take_samples()
        self.plant.make_safe()
        self.loop = None

    def lose_a_part(self) -> None:
        """Move all outputs to safe values and end the loop; a new one starts when all nodes are active again."""
        self._make_safe()
        self.end()

    def _make_safe(self) -> None:
        """Stop all parts and wait until the voltage has its safe value."""
        loop = self.loop
        assert loop is not None
        self._leaving = True
        loop.halt()
        safe = self.plant.parameters.safe_voltage
        patience = time.monotonic() + RETURN
        while loop.running and not loop.is_blocked and time.monotonic() < patience:
            sample, row = loop.latest()
            if sample >= 0 and row[signals.TRIPPED] and abs(row[signals.PLANT_VOLTAGE] - safe) < 1e-2:
                return
            time.sleep(1e-3)

    def await_samples(self, count: int) -> None:
        """Wait for a number of further samples, as long as the loop advances."""
        loop = self.loop
        if loop is None:
            return
        first, patience = loop.sample, time.monotonic() + RETURN
        while loop.running and not loop.is_blocked and loop.sample < first + count and time.monotonic() < patience:
            time.sleep(1e-3)

    def reset(self, node) -> None:
        """Let the part of a node begin again with everything at rest, of the plant all parts; samples count on."""
        if self.loop is None or self.axis is None:
            return
        whole = node.kind == "plant_simulator"
        if whole:
            self._make_safe()  # a part at rest has no voltage: from any other state that would be a step
        for name in reversed(self.plant.axis_kind.nodes) if whole else (node.kind,):
            if name in self.axis.by_node:
                self.apply(name, "reset")
        if node in (self.source, self.plant):
            self.source.setpoint = self.source.parameters.initial_setpoint
            self.loop.set(setpoint=self.source.setpoint)
        if whole:
            self._leaving = False
            if node.running:
                self.go_on()
            else:
                self.halt()

    # -- steering ------------------------------------------------------------------------------------------------

    def apply(self, name: str, action: str, parameters: dict | None = None) -> None:
        """Apply a change from a sample on, and wait until it is in effect."""
        assert self.loop is not None
        self.loop.apply(Change(self.loop.sample, name, action, parameters or {}))

    def halt(self) -> None:
        """Stop all parts within one sample, until :meth:`go_on`."""
        if self.loop is not None:
            self.loop.halt()

    def go_on(self) -> None:
        """Restart all parts after an emergency stop or a trip, without a step."""
        if self.loop is None:
            return
        self.apply("plant_simulator", "start")
        for name in STOPPABLE:
            if self.nodes[name].running:
                self.apply(name, "start")
        if self.plant.axis_kind.motor:
            self.loop.set(request=float(gait.START_REQUEST))
        elif self.source.running:
            self.apply(self.source.kind, "start")

    # -- showing -------------------------------------------------------------------------------------------------

    def show(self) -> None:
        """Publish the last sample, the changes, and the end of the run."""
        loop = self.loop
        if loop is None or self._over:
            return
        ended = not loop.running
        samples = self._reader.take()
        if samples.table.shape[1]:
            self._show(samples)
        if self.plant.runner.samples is not None:
            self.plant.runner.samples.show(loop, ended)
        self.tell_changes()
        if loop.failure or loop.is_blocked:
            self._over = True
            self.plant.fail(loop.failure or self._explain_blocked())
        elif ended and loop.sample >= self.plant.parameters.samples > 0:
            self._over = True
            self.plant.make_safe()
            self.plant.finish()

    def _explain_blocked(self) -> str:
        assert self.loop is not None
        driver = self.plant.parameters.driver
        watchdog = self.plant.part.capabilities.watchdog if driver else None
        acts = f"acts after {watchdog:g} s without a voltage" if watchdog else "does not exist"
        return (
            f"driver {driver} has not returned from sample {self.loop.sample} for {BLOCKED:g} s: no voltage is "
            f"put out, and only the device's own watchdog, which {acts}, makes it safe; end what holds the driver up"
        )

    def _show(self, samples) -> None:
        number = samples.first + samples.table.shape[1] - 1
        values = samples.table[:, -1].tolist()
        before = samples.table[signals.MEASURED, -2] if samples.table.shape[1] > 1 else values[signals.MEASURED]
        for node in self.nodes.values():
            node.pace.tick()
            node.sample = number + 1
        for name in self.plant.axis_kind.nodes:
            row = self.nodes[name].row
            row[: len(values)] = values
        self.source.look_at(samples.table.T.tolist())
        stamp = self.plant.show(number, before, self._leaving)
        for name in self.plant.axis_kind.nodes:
            if name != "plant_simulator":
                self.nodes[name].show(stamp, self._leaving)

    def tell_changes(self) -> None:
        """Publish the changes since the last call, each with its first sample."""
        for change in self.loop.changes if self.loop is not None else ():
            if id(change) not in self._told:
                self._told.add(id(change))
                self.nodes[change.node].changes.publish(
                    {
                        "sample": change.sample,
                        "node": change.node,
                        "action": change.action,
                        "parameters": change.parameters,
                    }
                )


class Fused(RealTime):
    """Runner of a node whose samples a fused loop computes."""

    by_message = False
    silent = False
    is_measured = False
    is_quiet = True

    def __init__(self, node):
        if node.fused is None:
            remedy = "needs the whole axis in one process: run hysteresis_axis, or hysteresis up CONFIG --fused"
            raise ParameterError([Problem("time_mode", node.parameters.time_mode, remedy)])
        super().__init__(node)
        #: Publisher of all samples; for the node of the plant only.
        self.samples: SampleStream | None = None

    def connect(self) -> None:
        """Create the topics of the node, and for the plant the topic with all samples."""
        super().connect()
        if self.node.kind == "plant_simulator":
            self.samples = SampleStream(self.node)

    @property
    def fused(self) -> FusedAxis:
        """The axis of the node."""
        return self.node.fused

    @property
    def is_live(self) -> bool:
        """Whether there are samples."""
        return self.fused.loop is not None and self.fused.loop.running

    def make_pace(self) -> LoopPace:
        """Return the statistics of the sample times."""
        return LoopPace(self.fused)

    def begin(self) -> None:
        """Report that this node is active; the last one of an axis starts the loop."""
        super().begin()
        self.fused.activated(self.node)

    def begin_again(self) -> None:
        """Reset the part."""
        self.fused.reset(self.node)

    def clear(self) -> None:
        """Clear the end of the last run."""
        self.node.end_of_run = -1
        self.node.finished = False

    def go_safe(self) -> None:
        """Move the outputs to their safe values."""
        self.fused.deactivated(self.node)

    # -- of the plant --------------------------------------------------------------------------------------------

    def start_time(self) -> None:
        """Publish the samples of the loop."""
        self.node.timer(1.0 / self.node.parameters.publish_rate, self.fused.show)

    def stop_time(self) -> None:
        """End the loop with the process; otherwise it continues in the safe state."""
        if self.node.leaving:
            self.fused.end()

    @property
    def late_samples(self) -> int:
        """Samples so far that were skipped."""
        loop = self.fused.loop
        return loop.missed if loop is not None else 0

    def timeliness(self) -> dict:
        """Return how late samples began so far, and their computing time."""
        loop = self.fused.loop
        if loop is None:
            return {}
        found = loop.lateness()
        late = {"p50": found.p50, "p90": found.p90, "p99": found.p99, "p99_9": found.p999, "max": found.max}
        values = {f"lateness_{name}_us": f"{1e6 * value:.3g}" for name, value in late.items()}
        return {
            **values,
            "cost_us": f"{1e6 * found.cost:.3g}",
            "spin_us": f"{1e6 * found.ahead:.3g}",
            "spin_percent_of_a_core": f"{100.0 * found.looked * loop.rate:.3g}",
        }

    def restart(self) -> None:
        """Restart the loop with all nodes."""

    def align(self) -> None:
        """Do nothing: every voltage belongs to its own sample."""

    def hold(self, held: bool) -> None:
        """Stop all parts within a sample, or resume."""
        if held:
            self.fused.halt()
        else:
            self.fused.go_on()

    def missing_voltage(self) -> str:
        """Return '': no partner is awaited."""
        return ""

    def explain_trip(self) -> str:
        """Return why the plant has stopped the axis."""
        loop = self.fused.loop
        if loop is None:
            return "stopped; ~/start lets it go on"
        rate, limit = self.node.parameters.sample_rate, self.node.parameters.allowed_late
        found = loop.lateness()
        return (
            f"more than {limit} samples within a second were skipped at {rate:g} Hz "
            f"({found.missed} so far; 99 % of all began within {1e6 * found.p99:.3g} µs): give the loop a processor "
            "and priority of its own (realtime.cpu, realtime.priority), or lower sample_rate; then call ~/start"
        )
