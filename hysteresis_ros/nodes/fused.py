# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Fused mode: one compiled thread runs the loop of an axis or a stage; the nodes in its process are its interface.

The nodes keep their names, topics, parameters, services and diagnostics. The nodes pass requests to the loop
(:mod:`hysteresis_ros.loop.fused`), which applies them at the boundary of a sample. They publish the loop's last sample
at ``publish_rate``, with the stamp of that sample. The ring of the loop contains every sample.
"""

from __future__ import annotations

import contextlib
import gc
import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hysteresis_ros import signals
from hysteresis_ros.errors import HysteresisError, ParameterError, Problem
from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.loop.axis import Axis, Change
from hysteresis_ros.loop.fused import FusedLoop, boost, require_speed
from hysteresis_ros.loop.pacing import Lateness, Reader
from hysteresis_ros.loop.parameters import AxisParameters, RealtimeParameters, RecorderNodeParameters
from hysteresis_ros.loop.stage import Stage
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.nodes.plant_runners import blocked_text
from hysteresis_ros.nodes.realtime import RealTime
from hysteresis_ros.nodes.samples import SampleStream
from hysteresis_ros.nodes.timing import COMPILING_TEXT, CountedRate
from hysteresis_ros.references import inchworm_layout as gait
from hysteresis_ros.units import readable

#: Duration of the longest sample [periods] from which the driver is named as the cause of skipped samples.
IN_DRIVER = 10.0


class LoopPace:
    """Rate, jitter and missed deadlines of the loop; same interface as :class:`hysteresis_ros.nodes.timing.Pace`."""

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
        """Number of skipped samples so far."""
        return self._fused.missed

    @property
    def age(self) -> float:
        """Time since the last new sample [s]; infinite before the first."""
        return time.monotonic() - self._last if self._last else float("inf")

    def tick(self) -> None:
        """Record that there are new samples."""
        self._last = time.monotonic()

    def restart(self) -> None:
        """Discard the samples so far, so that a pause does not affect the rate."""
        self._rate.restart()
        self._rate.begin(time.monotonic(), self.total)

    def read(self) -> tuple[float, float]:
        """Return the rate of the last second [Hz] and the lateness that 99 % of all samples do not exceed [s]."""
        rate = self._rate.read(time.monotonic(), self.total)
        loop = self._fused.loop
        return rate, loop.lateness().p99 if loop is not None else 0.0


#: Time in which the voltage can reach its safe value before the loop of an exiting node ends [s].
RETURN = 2.0
#: Switch interval of Python's threads, which limits how long they delay a loop that applies a change [s].
SWITCH_INTERVAL = 5e-4

#: Maximum time for which Python blocks a loop that calls a driver in Python [s].
PYTHON_SWITCH_INTERVAL = 1e-4

#: Time after which a loop that is not ready is assumed to be compiling [s]; loading it from the cache takes less.
COMPILING = 2.0

#: Nodes whose parts of the loop are stopped while the nodes are inactive, in the order of their restart.
STOPPABLE = ("hysteresis_compensator", "motion_controller")


class FusedAxis:
    """The nodes of one axis in this process, and its loop, which runs once all nodes of the loop are active.

    The axes of a stage share one loop, in which each axis has an index; they start, stop and reset together.
    """

    def __init__(self, first: FusedAxis | None = None, stage: StageParameters | None = None):
        self.nodes: dict = {}
        self.loop: FusedLoop | None = None
        self._missed = 0
        self.axis: Axis | None = None
        #: The axes that share the loop, in the order of their indices.
        self.together: list[FusedAxis] = [] if first is None else first.together
        self.place = len(self.together)
        self.together.append(self)
        self._stage = stage
        self._told: set[int] = set()
        self._over = self._leaving = False
        self._reader: Reader | None = None

    def join(self, node):
        """Add a node to the axis, and return it."""
        node.fused = self
        self.nodes[node.kind] = node
        return node

    def leave(self, node) -> None:
        """Remove a node; the removal of the first node ends the loop."""
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

    # -- start and end -------------------------------------------------------------------------------------------

    def activated(self, node) -> None:
        """Record an activated node; when all nodes are active, start the loop."""
        if self.loop is not None:
            if node.kind in STOPPABLE and node.running:
                self.apply(node.kind, "start")
            elif node.kind == "plant_simulator":
                self._leaving = False
                if node.running:
                    self.go_on()
        elif self._is_complete and all(other.active for one in self.together for other in one.nodes.values()):
            self._begin()

    @property
    def _is_complete(self) -> bool:
        """Whether all nodes exist; the nodes of another axis of the stage may not have been created yet."""
        if self._stage is None:
            return True
        return len(self.together) == len(self._stage.axes) and all(
            set(signals.ACTUATOR.nodes) <= set(one.nodes) for one in self.together
        )

    def deactivated(self, node) -> None:
        """Move the outputs of a deactivated node to their safe values; for the plant, move all outputs."""
        if self.loop is None or self.loop.is_blocked:
            return
        if node.kind in STOPPABLE:
            self.apply(node.kind, "stop")
        elif node.kind == "plant_simulator":
            self._make_safe()

    def _begin(self) -> None:
        given = self._given()
        plant = self.together[0].plant
        with self._compilation_reported():
            require_speed(given)
            devices = [one.plant.part for one in self.together if one.plant.parameters.driver]
            for device in devices:
                device.reset()
            axis = Stage(given, devices) if isinstance(given, StageParameters) else Axis(given, *devices)
            loop = FusedLoop(axis, plant.parameters.real_time_factor, plant.parameters.samples, warn=self._warn)
            if any(device.calls_python for device in devices):
                self._compile_predictions()
        for one, part in zip(self.together, axis.axes, strict=True):
            one._enter(loop, part)
        sys.setswitchinterval(SWITCH_INTERVAL)
        if any(device.calls_python for device in devices):
            _hold_the_lock_briefly(plant.parameters.realtime)
        for one in self.together:
            if "recorder" in one.nodes:
                one.nodes["recorder"].record_loop(one)
        loop.start()
        for one in self.together:
            one.plant.begin_run(loop.origin)
        if not all(one.plant.running for one in self.together):
            loop.halt()

    def _compile_predictions(self) -> None:
        """Compile the predictions of moves before the loop needs Python's lock, which compiling holds, in each sample.

        Otherwise the first move would delay so many samples that the axis trips.
        """
        from hysteresis_ros.loop.ready import Predictor, model_of

        for one in self.together:
            given = one.present_parameters()
            source = given.reference_generator
            if source is not None and source.waveform.type == "hold":
                with contextlib.suppress(HysteresisError):  # a move reports why it is not predicted
                    Predictor(model_of(source, given.motion_controller, given.hysteresis_compensator))

    def _enter(self, loop: FusedLoop, axis: Axis) -> None:
        """Give the nodes their parts of a loop before it starts, and apply the state of the nodes to the loop."""
        self.axis, self.loop = axis, loop
        self._over = self._leaving = False
        self._told.clear()
        for name, part in axis.by_node.items():
            self.nodes[name].take_part(part)
        for name in STOPPABLE:
            if not self.nodes[name].running:
                self.apply(name, "stop")
        source = self.source
        if source.setpoint != source.parameters.initial_setpoint:
            self.set(setpoint=source.setpoint)
        self._reader = self.reader()

    def _given(self) -> AxisParameters | StageParameters:
        """Return the present parameters of the nodes of the axis, or of all axes of the stage."""
        found = tuple(one.present_parameters() for one in self.together)
        return found[0] if self._stage is None else replace(self._stage, axes=found)

    @contextlib.contextmanager
    def _compilation_reported(self):
        """Report that the loop is being compiled if the enclosed code takes longer than ``COMPILING``."""
        report = threading.Timer(COMPILING, self._report_compilation)
        report.start()
        try:
            yield
        finally:
            report.cancel()

    def _report_compilation(self) -> None:
        """Log that the loop is being compiled, and publish it as diagnostics, which also arrive while it compiles."""
        self.plant.get_logger().info(COMPILING_TEXT)
        for one in self.together:
            for node in one.nodes.values():
                node.tell_health(COMPILING_TEXT)

    def present_parameters(self) -> AxisParameters:
        """Return the present parameters of the nodes of the axis."""
        plant = self.plant
        parts = {name: self.nodes[name].parameters for name in plant.axis_kind.nodes}
        recorder = self.nodes["recorder"].parameters if "recorder" in self.nodes else RecorderNodeParameters()
        return AxisParameters.of_nodes(plant.get_namespace().rstrip("/"), {**parts, "recorder": recorder})

    def _warn(self, text: str) -> None:
        self.plant.get_logger().warning(f"real time: {text}")

    def end(self) -> None:
        """End the loop if it runs; the samples that it has computed are still published and recorded.

        While a call of a device does not return, the loop exists until the process ends, and no other thread may call
        the device.
        """
        if self.loop is None:
            return
        ended = self.loop.leave()
        self.show()
        if not ended:
            return
        for one in self.together:
            if "recorder" in one.nodes:
                one.nodes["recorder"].take_samples()
            one.plant.make_safe()
        missed = self.loop.missed
        for one in self.together:
            one.loop, one._missed = None, missed

    @property
    def missed(self) -> int:
        """Number of skipped samples of the present loop, or of the last loop if no loop exists."""
        return self._missed if self.loop is None else self.loop.missed

    def lose_a_part(self) -> None:
        """Move all outputs to safe values and end the loop; a new loop starts when all nodes are active again."""
        self._make_safe()
        self.end()

    def _make_safe(self) -> None:
        """Stop all parts and wait until the voltages have their safe values."""
        loop = self.loop
        assert loop is not None
        for one in self.together:
            one._leaving = True
        loop.halt()
        patience = time.monotonic() + RETURN
        while loop.running and not loop.is_blocked and time.monotonic() < patience:
            if all(one.is_safe for one in self.together):
                return
            time.sleep(1e-3)

    @property
    def is_safe(self) -> bool:
        """Whether the plant has stopped the axis and its voltage has the safe value."""
        sample, row = self.latest()
        safe = self.plant.parameters.safe_voltage
        return bool(sample >= 0 and row[signals.TRIPPED] and abs(row[signals.PLANT_VOLTAGE] - safe) < 1e-2)

    def await_samples(self, count: int) -> None:
        """Wait for ``count`` further samples, as long as the loop advances."""
        loop = self.loop
        if loop is None:
            return
        first, patience = loop.sample, time.monotonic() + RETURN
        while loop.running and not loop.is_blocked and loop.sample < first + count and time.monotonic() < patience:
            time.sleep(1e-3)

    def reset(self, node) -> None:
        """Reset the node's part of the loop to rest; for the plant, reset all parts. The sample counter continues."""
        if self.loop is None or self.axis is None:
            return
        whole = node.kind == "plant_simulator"
        if whole:
            # first make safe: a part that is reset outputs its voltage at rest, so the voltage could step
            self._make_safe()
        axes = self.together if whole else [self]
        for name in reversed(self.plant.axis_kind.nodes) if whole else (node.kind,):
            if name in self.axis.by_node:
                self.apply_together({one: Change(self.loop.sample, name, "reset") for one in axes})
        for one in axes:
            if whole or node is one.source:
                one.source.setpoint = one.source.parameters.initial_setpoint
                one.set(setpoint=one.source.setpoint)
        if whole:
            for one in axes:
                one._leaving = False
            if node.running:
                self.go_on()
            else:
                self.halt()

    # -- steering ------------------------------------------------------------------------------------------------

    def apply(self, name: str, action: str, parameters: dict | None = None) -> None:
        """Apply a change, and wait until it is in effect."""
        assert self.loop is not None
        self.apply_together({self: Change(self.loop.sample, name, action, parameters or {})})

    def apply_together(self, changes: Mapping[FusedAxis, Change]) -> None:
        """Apply a change to each of several axes before the same sample, and wait until they are in effect."""
        assert self.loop is not None
        self.loop.apply_together({one.place: change for one, change in changes.items()})

    def set(self, setpoint: float | None = None, request: float | None = None, speed: float | None = None) -> None:
        """Request a setpoint [m], a motor's request or speed for the next sample; None: no change."""
        if self.loop is not None:
            self.loop.set(setpoint, request, speed, self.place)

    def pulse(self) -> None:
        """Give the trigger input of the axis a pulse in the next sample."""
        if self.loop is not None:
            self.loop.pulse(self.place)

    def halt(self) -> None:
        """Stop all parts of all axes within one sample, until :meth:`go_on`."""
        if self.loop is not None:
            self.loop.halt()

    def go_on(self) -> None:
        """Restart all parts without a step after an emergency stop or a trip, unless a device does not recover."""
        if self.loop is None:
            return
        try:
            recovered = [one.plant.part.recover() for one in self.together]
        except DriverError:
            return  # the plant reports this error, and stays tripped
        if any(recovered):
            self.await_samples(2)  # one of them is complete, and outputs the safe voltage of the stopped axis
        self._start("plant_simulator", self.together)
        for name in STOPPABLE:
            self._start(name, [one for one in self.together if one.nodes[name].running])
        if self.plant.axis_kind.motor:
            self.set(request=float(gait.START_REQUEST))
        else:
            self._start(self.source.kind, [one for one in self.together if one.source.running])

    def _start(self, name: str, axes: list[FusedAxis]) -> None:
        if axes and self.loop is not None:
            self.apply_together({one: Change(self.loop.sample, name, "start") for one in axes})

    # -- showing -------------------------------------------------------------------------------------------------

    def reader(self) -> Reader:
        """Return a reader of the samples of the axis, which begins with the next sample."""
        assert self.loop is not None
        return self.loop.reader(self.place)

    def latest(self) -> tuple[int, np.ndarray]:
        """Return number and row of the last sample of the axis."""
        assert self.loop is not None
        return self.loop.latest(self.place)

    def show(self) -> None:
        """Publish the last sample, with the same number for all axes, the changes, and the end of the run."""
        loop = self.loop
        if loop is None or self._over:
            return
        ended = not loop.running
        until = loop.sample
        shown = [one._show_axis(until, ended) for one in self.together if one.plant.active or one.plant.leaving]
        if self._stage is not None and shown and all(shown):
            self.plant.group.publish_joint_states()
        if loop.failure or loop.is_blocked:
            for one in self.together:
                one._over = True
                one.plant.fail(loop.failure or blocked_text(one.plant, loop.sample, loop.patience))
        elif ended and loop.sample >= self.plant.parameters.samples > 0:
            for one in self.together:
                one._over = True
                one.plant.make_safe()
                one.plant.finish()

    def _show_axis(self, until: int, ended: bool) -> bool:
        """Publish this axis' changes and last new sample before ``until``; return whether there was a new sample."""
        assert self._reader is not None
        samples = self._reader.take(until)
        if samples.table.shape[1]:
            self._show(samples)
        if self.plant.runner.samples is not None:
            self.plant.runner.samples.show(self, ended)
        self.tell_changes()
        return bool(samples.table.shape[1])

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
        self.source.show_all(samples.first, samples.table)
        stamp = self.plant.show(number, before, self._leaving)
        for name in self.plant.axis_kind.nodes:
            if name != "plant_simulator":
                self.nodes[name].show(stamp, self._leaving)

    def tell_changes(self) -> None:
        """Publish the changes since the last call, each with the first sample that it affects."""
        for change in self.loop.changes_of(self.place) if self.loop is not None else ():
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


def skipped_text(rate: float, limit: int, found: Lateness, driver: str) -> str:
    """Return why the loop at ``rate`` [Hz] has stopped after more than ``limit`` skipped samples, and a remedy.

    If a sample took several periods and there is a ``driver``, the driver is the cause and not the processor.
    """
    remedy = "give the loop a core and a priority of its own (realtime.cpu, realtime.priority), or lower sample_rate"
    taken = f"99 % of all samples began within {1e6 * found.p99:.3g} µs"
    if driver and found.highest_cost * rate >= IN_DRIVER:
        taken = f"the longest sample took {readable(found.highest_cost, 's')}"
        remedy = (
            f"the calls of the driver {driver} in a sample must return within its period, "
            f"{readable(1.0 / rate, 's')}; if they do, {remedy}"
        )
    return (
        f"more than {limit} samples within a second were skipped at {rate:g} Hz ({found.missed} so far; {taken}): "
        f"{remedy}; then call ~/start"
    )


def _hold_the_lock_briefly(realtime: RealtimeParameters) -> None:
    """Shorten the times for which this process holds Python's lock, which the loop needs in each sample.

    Afterwards the garbage collector examines only new objects, and other programs do not interrupt the calling thread,
    which publishes the samples.
    """
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(PYTHON_SWITCH_INTERVAL)
    boost(realtime)


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
        """Whether the loop delivers samples."""
        return self.fused.loop is not None and self.fused.loop.running

    def make_pace(self) -> LoopPace:
        """Return the statistics of the sample times."""
        return LoopPace(self.fused)

    def begin(self) -> None:
        """Report that this node is active; the last node of an axis to become active starts the loop."""
        super().begin()
        self.fused.activated(self.node)

    def begin_again(self) -> None:
        """Reset the node's part of the loop."""
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
        if self.fused.place == 0:
            self.node.timer(1.0 / self.node.parameters.publish_rate, self.fused.show)

    def stop_time(self) -> None:
        """End the loop if the process exits; otherwise the loop continues in the safe state."""
        if self.node.leaving:
            self.fused.end()

    @property
    def late_samples(self) -> int:
        """Number of skipped samples so far."""
        return self.fused.missed

    def timeliness(self) -> dict:
        """Return the lateness of the samples so far, and their computing time."""
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
        """Do nothing, because the loop restarts with all nodes."""

    def align(self) -> None:
        """Do nothing: every voltage belongs to its own sample."""

    def hold(self, held: bool) -> None:
        """Stop all parts within a sample, or resume."""
        if held:
            self.fused.halt()
        else:
            self.fused.go_on()

    def missing_voltage(self) -> str:
        """Return an empty text, because the loop waits for no partner."""
        return ""

    def explain_trip(self) -> str:
        """Return why the plant has stopped the axis."""
        loop = self.fused.loop
        if loop is None:
            return "stopped; call ~/start to resume"
        own = self.node.parameters
        return skipped_text(own.sample_rate, own.allowed_late, loop.lateness(), own.driver)
