# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An axis as an ophyd-async device for bluesky: readable, movable and flyable; a flight yields its samples.

The device talks to the nodes of a running axis over ROS; it needs the extra ``bluesky``. Lengths are in the
engineering unit of the device, µm by default.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import threading
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from typing import Any

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import HysteresisError, MissingExtraError
from hysteresis_ros.loop.reach import single_axis

try:
    from ophyd_async.core import (
        AsyncStatus,
        StandardReadable,
        StandardReadableFormat,
        WatchableAsyncStatus,
        WatcherUpdate,
        soft_signal_r_and_setter,
    )
except ImportError:
    raise MissingExtraError("ophyd-async", "bluesky", "devices for bluesky need it") from None

import rclpy
from builtin_interfaces.msg import Duration
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from hysteresis_ros.laboratory.epics.link import AxisLink
from hysteresis_ros.laboratory.epics.record import Alarm, RecordOptions, motor_settings, stage_at_rest
from hysteresis_ros.nodes.domain import stay_on_this_machine
from hysteresis_ros.nodes.qos import sensor_qos, setpoint_qos

#: Interval at which a move, and the answers of the axis, are checked [s].
LOOK = 0.005
#: Interval at which the progress of a move is reported to watchers [s].
TELL = 0.1
#: Time in which the axis must accept a flight [s].
TAKEN = 2.0
#: The state of an axis without a problem.
SOUND = Alarm()
#: Default duration of the run-up, as a fraction of the duration of the flight at constant velocity.
RUN_UP = 0.1


@dataclass(frozen=True)
class Flight:
    """A flight: constant velocity between two positions, with a run-up before and a run-down after.

    Parameters
    ----------
    start_position, end_position : float
        Ends of the part with constant velocity [engineering unit].
    time_for_move : float
        Duration of this part [s].
    run_up : float, optional
        Duration of run-up and run-down, with constant acceleration [s]; a tenth of ``time_for_move`` by default.
    every : int
        Report only every n-th sample, with n = ``every``.
    """

    start_position: float
    end_position: float
    time_for_move: float
    run_up: float | None = None
    every: int = 1


@dataclass(frozen=True)
class _Plan:
    """A flight in metres and seconds."""

    start: float
    end: float
    duration: float
    run_up: float
    every: int

    @property
    def velocity(self) -> float:
        """Velocity between run-up and run-down [m/s]."""
        return (self.end - self.start) / self.duration

    @property
    def ends(self) -> tuple[float, float]:
        """Positions at rest before the run-up and after the run-down [m]."""
        ramp = 0.5 * self.velocity * self.run_up
        return self.start - ramp, self.end + ramp

    def message(self, joint: str) -> JointTrajectory:
        """Return the trajectory from rest to rest; its first point is reached after the run-up."""
        rest = self.ends[1]
        points = [(self.run_up, self.start, self.velocity), (self.run_up + self.duration, self.end, self.velocity)]
        points.append((2.0 * self.run_up + self.duration, rest, 0.0))
        found = JointTrajectory(joint_names=[joint])
        for at, position, velocity in points:
            nanoseconds = round(1e9 * at)
            since = Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
            point = JointTrajectoryPoint(positions=[position], velocities=[velocity], time_from_start=since)
            found.points.append(point)
        return found


class HysteresisAxis(StandardReadable):
    """A running axis as a device: ``bps.mv(axis, 3.0)``, ``bp.scan([…], axis, 1, 9, 5)``, ``bp.fly([axis])``.

    Parameters
    ----------
    config : str or path-like
        Configuration of the axis, which already runs (``hysteresis up CONFIG --reference hold``).
    namespace : str
        The axis to use, if the configuration describes several axes or a stage.
    name : str
        Name of the device.
    unit : str
        Engineering unit, a unit of length.
    tolerance : float, optional
        A move is complete when the position has stayed within this distance of the target [unit] for the dwell time;
        by default the tolerance of the axis.
    timeout : float
        Time-out of a move in addition to its duration [s].
    """

    def __init__(
        self,
        config,
        *,
        namespace: str = "",
        name: str = "axis",
        unit: str = "um",
        tolerance: float | None = None,
        timeout: float = 10.0,
    ):
        configuration = load_configuration(config)
        stage = stage_at_rest(configuration)
        axis = stage.axes[stage.place(namespace)] if stage else single_axis(configuration, namespace or None)
        self.settings = motor_settings(axis, RecordOptions("", unit, 4, timeout, tolerance))
        self._link: _Link | None = None
        with self.add_children_as_readables(StandardReadableFormat.HINTED_SIGNAL):
            self.readback, self._set_readback = soft_signal_r_and_setter(float, 0.0, units=unit, precision=4)
        with self.add_children_as_readables():
            self.setpoint, self._set_setpoint = soft_signal_r_and_setter(float, 0.0, units=unit, precision=4)
        self._moving = self._stopped = False
        self._plan: _Plan | None = None
        self._flown: list[tuple[float, float]] = []
        super().__init__(name=name)

    async def connect(self, mock: Any = False, timeout: float = 10.0, force_reconnect: bool = False) -> None:
        """Find the axis.

        Parameters
        ----------
        mock : bool
            Make no connection.
        timeout : float
            Time-out [s].
        force_reconnect : bool
            Connect again, even if the device is connected.
        """
        await super().connect(mock, timeout, force_reconnect)
        if mock or (self._link is not None and not force_reconnect):
            return
        self.close()
        link = self._link = _Link(self.settings)
        deadline = time.monotonic() + timeout
        while link.look().alarm != SOUND and time.monotonic() < deadline:
            await asyncio.sleep(LOOK)
        if link.look().alarm != SOUND:
            self.close()
            space = self.settings.namespace or "/"
            raise HysteresisError(f"no axis in {space} within {timeout:g} s: start it, or use its ROS domain")
        self._show()

    def close(self) -> None:
        """Leave the graph of ROS nodes."""
        if self._link is not None:
            self._link.close()
            self._link = None

    def set_name(self, name: str, **options: Any) -> None:
        """Name the device and its signals; the position has the name of the device."""
        super().set_name(name, **options)
        self.readback.set_name(name)

    def _connected(self) -> _Link:
        if self._link is None:
            raise HysteresisError(f"{self.name}: not connected; call connect() first")
        return self._link

    def _show(self) -> float:
        """Update the signals from the axis; return the position [m]."""
        seen = self._connected().look()
        self._set_readback(seen.position / self.settings.metres)
        self._set_setpoint(seen.setpoint / self.settings.metres)
        return seen.position

    async def read(self) -> dict:
        """Return position and setpoint with the time of the measurement."""
        self._show()
        return await super().read()

    async def locate(self) -> dict[str, float]:
        """Return the present setpoint and position."""
        self._show()
        return {"setpoint": await self.setpoint.get_value(), "readback": await self.readback.get_value()}

    def _require_position(self, value: float, what: str) -> float:
        """Return a position in metres; refuse a position that is out of range."""
        low, high = self.settings.low / self.settings.metres, self.settings.high / self.settings.metres
        if not low <= value <= high:
            raise HysteresisError(
                f"{self.name}: {what} {value:g} {self.settings.unit} is out of the range of this axis, "
                f"{low:g} … {high:g} {self.settings.unit}"
            )
        return value * self.settings.metres

    def set(self, value: float, timeout: float | None = None) -> WatchableAsyncStatus:
        """Move, and finish when the position has stayed within the tolerance of ``value`` for the dwell time.

        Parameters
        ----------
        value : float
            Position [unit].
        timeout : float, optional
            Time-out [s], in addition to the duration of the move; by default the time-out of the device.

        Raises
        ------
        HysteresisError
            The position is out of range, the axis has tripped or is silent, or it did not arrive.
        """
        return WatchableAsyncStatus(self._move(value, timeout))

    async def _move(self, value: float, timeout: float | None) -> AsyncIterator[WatcherUpdate]:
        link, settings = self._connected(), self.settings
        target = self._require_position(value, "position")
        initial = self._show()
        allowed = settings.timeout if timeout is None else timeout
        allowed += abs(target - initial) / settings.velocity if settings.velocity else 0.0
        self._stopped = False
        self._require_sound(link)
        self._moving = True
        try:
            link.axis.move(target)
            async for update in self._arrival(target, initial, allowed):
                yield update
        finally:
            self._moving = False

    async def _arrival(self, target: float, initial: float, allowed: float) -> AsyncIterator[WatcherUpdate]:
        """Wait at most ``allowed`` [s] until the axis has arrived at ``target`` [m], and report the progress."""
        link, settings = self._connected(), self.settings
        begun = told = time.monotonic()
        inside: float | None = None
        while True:
            await asyncio.sleep(LOOK)
            now, position = time.monotonic(), self._show()
            self._require_sound(link)
            if self._stopped:
                raise HysteresisError(f"{self.name}: stopped at {position / settings.metres:g} {settings.unit}")
            near = abs(position - target) <= settings.tolerance
            inside = (now if inside is None else inside) if near else None
            if inside is not None and now - inside >= settings.dwell:
                return
            if now - begun > allowed:
                shown = [f"{one / settings.metres:g}" for one in (position, settings.tolerance, target)]
                raise HysteresisError(
                    f"{self.name}: {shown[0]} {settings.unit} after {allowed:g} s, not {shown[2]} ± {shown[1]}; "
                    "give a larger tolerance, or use a controller"
                )
            if now - told >= TELL:
                told = now
                yield WatcherUpdate(
                    current=position / settings.metres,
                    initial=initial / settings.metres,
                    target=target / settings.metres,
                    name=self.name,
                    unit=settings.unit,
                    time_elapsed=now - begun,
                )

    def _require_sound(self, link: _Link) -> None:
        if link.look().alarm != SOUND:
            raise HysteresisError(f"{self.name}: the axis has stopped or is silent; see `hysteresis status`")

    async def stop(self, success: bool = True) -> None:
        """Stop a motion in progress, which then fails; at rest, send nothing: bluesky calls stop after every plan."""
        if self._moving or self._connected().flying:
            self._stopped = True
            self._connected().axis.stop()

    @AsyncStatus.wrap
    async def prepare(self, value) -> None:
        """Check a flight and move to the beginning of its run-up.

        Parameters
        ----------
        value : Flight
            The flight, or any object with ``start_position``, ``end_position`` and ``time_for_move``, such as
            ophyd-async's ``FlyMotorInfo``.

        Raises
        ------
        HysteresisError
            A position is out of range, or the flight exceeds the velocity or acceleration limit of the approach.
        """
        plan = self._planned(value)
        begin = plan.ends[0] / self.settings.metres
        async for _ in self._move(begin, None):
            pass
        self._plan = plan

    def _planned(self, value) -> _Plan:
        settings, duration = self.settings, float(value.time_for_move)
        run_up = getattr(value, "run_up", None)
        plan = _Plan(
            self._require_position(float(value.start_position), "start"),
            self._require_position(float(value.end_position), "end"),
            duration,
            RUN_UP * duration if run_up is None else float(run_up),
            int(getattr(value, "every", 1)),
        )
        if not (duration > 0.0 and plan.run_up > 0.0 and plan.every > 0) or plan.start == plan.end:
            raise HysteresisError(
                f"{self.name}: {value}: durations and every must be > 0, and the start and end positions must differ"
            )
        for what, position in zip(("run-up", "run-down"), plan.ends, strict=True):
            self._require_position(position / settings.metres, what)
        for what, needed, limit, unit in (
            ("velocity", abs(plan.velocity), settings.velocity, "m/s"),
            ("acceleration", abs(plan.velocity) / plan.run_up, settings.acceleration, "m/s²"),
        ):
            if limit and needed > limit * (1.0 + 1e-9):
                raise HysteresisError(
                    f"{self.name}: {what} of the flight = {needed:.4g} {unit}: the approach allows {limit:.4g} "
                    f"{unit}; give the flight more time"
                )
        return plan

    @AsyncStatus.wrap
    async def kickoff(self) -> None:
        """Begin the flight, and finish when the axis has accepted it."""
        link, plan = self._connected(), self._plan
        if plan is None:
            raise HysteresisError(f"{self.name}: call prepare() before kickoff()")
        self._require_sound(link)
        self._stopped = False
        link.begin(plan.message(self.settings.joint))
        deadline = time.monotonic() + TAKEN
        while not link.answer and time.monotonic() < deadline:
            await asyncio.sleep(LOOK)
        if "taken" not in link.answer:
            link.end()
            raise HysteresisError(f"{self.name}: the flight did not begin: {link.answer or 'the axis does not answer'}")

    @AsyncStatus.wrap
    async def complete(self) -> None:
        """Finish when the axis has arrived at the end of the run-down.

        Raises
        ------
        HysteresisError
            The axis did not follow the flight to its end; the samples received so far are still collected.
        """
        link, plan = self._connected(), self._plan
        if plan is None or not link.flying:
            raise HysteresisError(f"{self.name}: call kickoff() before complete()")
        deadline = time.monotonic() + plan.duration + 2.0 * plan.run_up + self.settings.timeout
        try:
            while link.ending is None:
                await asyncio.sleep(LOOK)
                self._show()
                self._require_sound(link)
                if self._stopped or time.monotonic() > deadline:
                    raise HysteresisError(f"{self.name}: {'stopped' if self._stopped else 'no end'} of the flight")
            if "arrived" not in link.ending:
                raise HysteresisError(f"{self.name}: the flight ended early: {link.ending}")
        finally:
            self._flown = link.end()[:: plan.every]
            self._plan = None

    async def describe_collect(self) -> dict:
        """Return the description of the samples of a flight."""
        key = {"source": f"ros://{self.settings.namespace}/joint_states", "dtype": "number", "shape": []}
        return {self.name: {self.name: {**key, "units": self.settings.unit, "precision": 4}}}

    def collect(self) -> Iterator[dict]:
        """Yield the samples of the last flight: the position [unit], with the sample's stamp [s] as time."""
        flown, self._flown = self._flown, []
        for stamp, position in flown:
            data = {self.name: position / self.settings.metres}
            yield {"time": stamp, "data": data, "timestamps": {self.name: stamp}}


class _Link:
    """A node in a separate thread: the link of a motor record, which also collects the samples of a flight."""

    def __init__(self, settings):
        stay_on_this_machine()
        self._settings = settings
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node(
            "_hysteresis_bluesky", context=self._context, start_parameter_services=False, enable_rosout=False
        )
        self._lock = threading.Lock()
        self.axis = AxisLink(self._node, settings)
        self.flying = False
        self.answer, self.ending = "", None
        self._samples: list[tuple[float, float]] = []
        space = settings.namespace
        self._paths = self._node.create_publisher(JointTrajectory, f"{space}/joint_trajectory", setpoint_qos())
        self._node.create_subscription(JointState, f"{space}/joint_states", self._on_sample, sensor_qos())
        self._node.create_subscription(String, f"{space}/{settings.source}/trajectory", self._on_answer, setpoint_qos())
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name="bluesky", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        with contextlib.suppress(rclpy.executors.ExternalShutdownException):
            self._executor.spin()

    def look(self):
        """Return the state of the axis."""
        return self.axis.look(time.monotonic())

    def begin(self, message: JointTrajectory) -> None:
        """Send a trajectory and begin to collect samples."""
        with self._lock:
            self._samples, self.answer, self.ending, self.flying = [], "", None, True
        self._paths.publish(message)

    def end(self) -> list[tuple[float, float]]:
        """Return stamps [s] and positions [m] of the samples of the flight."""
        with self._lock:
            self.flying = False
            return self._samples

    def _on_sample(self, message: JointState) -> None:
        if not self.flying or self._settings.joint not in message.name:
            return
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        position = message.position[list(message.name).index(self._settings.joint)]
        with self._lock:
            if math.isfinite(position):
                self._samples.append((stamp, position))

    def _on_answer(self, message: String) -> None:
        with self._lock:
            if not self.flying:
                return
            if not self.answer:
                self.answer = message.data
            elif self.ending is None:
                self.ending = message.data

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._context.try_shutdown()
        self._thread.join()
