# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Channel Access: motor records by caproto (extra ``[epics]``), and the process of ``hysteresis ioc`` that serves them.

Its argument is the JSON object of :mod:`hysteresis_ros.laboratory.epics.server_process`.
"""

from __future__ import annotations

import asyncio
import json
import logging
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable

import caproto
import rclpy
from caproto.asyncio.server import Context
from caproto.server import PVGroup, PvpropertyDouble, pvproperty
from rclpy.signals import SignalHandlerOptions

from hysteresis_ros.laboratory.epics.link import AxisLink
from hysteresis_ros.laboratory.epics.record import SILENT, Alarm, Axis, MotorRecord, MotorSettings
from hysteresis_ros.nodes.domain import stay_on_this_machine
from hysteresis_ros.nodes.security.policy import RECORDS, enclave_of
from hysteresis_ros.nodes.spin import LOOK, make_executor

#: Interval at which records read their axes and publish changes [s].
PERIOD = 0.02

#: Delay of an answer [s], so that changed values are published first.
BEHIND = 0.05

#: Fields that clients write: name in caproto → name of the field.
WRITTEN = {
    "dial_desired_value": "DVAL",
    "relative_value": "RLV",
    "tweak_motor_forward": "TWF",
    "tweak_motor_reverse": "TWR",
    "tweak_step_size": "TWV",
    "stop": "STOP",
    "stop_pause_move_go": "SPMG",
    "set_use_switch": "SET",
    "set_set_mode": "SSET",
    "set_use_mode": "SUSE",
    "offset_freeze_switch": "FOFF",
    "user_offset": "OFF",
    "user_direction": "DIR",
    "user_high_limit": "HLM",
    "user_low_limit": "LLM",
    "dial_high_limit": "DHLM",
    "dial_low_limit": "DLLM",
    "sync_position": "SYNC",
    "velocity": "VELO",
    "seconds_to_velocity": "ACCL",
    "max_velocity": "VMAX",
    "retry_deadband": "RDBD",
    "setpoint_deadband": "SPDB",
    "home_forward": "HOMF",
    "home_reverse": "HOMR",
    "jog_motor_forward": "JOGF",
    "jog_motor_reverse": "JOGR",
}
#: Fields for which a waiting client gets its confirmation at the end of the move.
MOVING = ("VAL", "DVAL", "RLV", "TWF", "TWR")


def _writer(field: str):
    """Return the function that caproto calls when a client writes a field of a record."""

    async def write(fields, instance, value):
        return await fields.parent.group.write(field, value)

    return write


async def _write_value(group, instance, value):
    """Take a value that a client writes to the record itself."""
    return await group.write("VAL", value)


class Position(PvpropertyDouble):
    """A position; the record refuses an invalid value with an alarm, where caproto would raise an exception."""

    async def verify_value(self, value):
        """Pass a value from a client to the record."""
        return await self.putter(self, float(list(value)[0] if isinstance(value, Iterable) else value))


class Motor(PVGroup):
    """A motor record on Channel Access."""

    motor = pvproperty(value=0.0, name="", dtype=Position, record="motor", put=_write_value)
    ready = pvproperty(value=0, name=":Ready", read_only=True, doc="1: within the tolerance")
    ready_in = pvproperty(value=0.0, name=":ReadyIn", read_only=True, doc="Time from the setpoint until ready [s]")

    def __init__(self, settings: MotorSettings, axis: Axis):
        super().__init__(prefix=settings.name)
        self.settings = settings
        self.record = MotorRecord(settings, axis)
        found = self.motor.field_inst
        self._places = {prop.pvspec.name: getattr(found, name) for name, prop in type(found)._pvs_.items()}
        self._places |= {"VAL": self.motor, "READY": self.ready, "READYIN": self.ready_in}
        self._shown: dict[str, object] = {}
        self._alarm: Alarm | None = None
        self._telling = asyncio.Lock()

    async def write(self, field: str, value):
        """Write a field as a client does; a client that waits for completion waits until the end of the move."""
        taken = self.record.put(field, value, time.monotonic())
        await self.tell()
        if field in MOVING:
            while not self.record.fields["DMOV"]:
                await asyncio.sleep(PERIOD)
            await self.tell()
        await asyncio.sleep(BEHIND)
        if field in self.record.fields:
            raise caproto.SkipWrite
        return taken

    async def begin(self) -> None:
        """Publish the constant fields once."""
        unit, digits = self.settings.unit, self.settings.precision
        for place in (self.motor, *self._places.values()):
            if isinstance(place, caproto.ChannelDouble):
                await place.write_metadata(units=unit, precision=digits)
        await self.ready_in.write_metadata(units="s", precision=6)
        await self._places["EGU"].write(unit, verify_value=False)
        await self._places["DESC"].write(f"hysteresis {self.settings.namespace or 'axis'}"[:40], verify_value=False)
        await self._places["UDF"].write(b"\0", verify_value=False)

    async def tell(self) -> None:
        """Publish the changes to clients.

        The alarm is published first and the end of a move last: a client that waits for the end then finds all other
        fields updated.
        """
        async with self._telling:
            record = self.record
            if record.alarm != self._alarm:
                await self._tell_alarm(record.alarm)
            changed = {name: value for name, value in record.fields.items() if self._shown.get(name) != value}
            if {"HLM", "LLM"} & changed.keys():
                await self._tell_limits()
            for name in sorted(changed, key=lambda name: name == "DMOV"):
                self._shown[name] = changed[name]
                await self._places[name].write(changed[name], verify_value=False)

    async def _tell_alarm(self, alarm: Alarm) -> None:
        self._alarm = alarm
        status = caproto.AlarmStatus[alarm.status]
        severity = getattr(caproto.AlarmSeverity, f"{alarm.severity}_ALARM".replace("NO_ALARM_ALARM", "NO_ALARM"))
        for name in ("VAL", "RBV"):  # the fields share one timestamp
            await self._places[name].alarm.write(status=status, severity=severity)
        await self._places["STAT"].write(alarm.status, verify_value=False)
        await self._places["SEVR"].write(alarm.severity, verify_value=False)

    async def _tell_limits(self) -> None:
        low, high = self.record.fields["LLM"], self.record.fields["HLM"]
        for name in ("VAL", "RBV"):
            await self._places[name].write_metadata(
                lower_ctrl_limit=low, upper_ctrl_limit=high, lower_disp_limit=low, upper_disp_limit=high
            )

    async def look(self) -> None:
        """Update the record, and publish the changes."""
        self.record.tick(time.monotonic())
        await self.tell()


for _name, _field in WRITTEN.items():
    getattr(Motor.motor.fields, _name).putter(_writer(_field))


class RefusedWrites(logging.Filter):
    """Logs a refused write in one line, with the reason that the client gets, without the traceback of caproto."""

    def filter(self, record) -> bool:
        """Remove the traceback from the log record of a refused write."""
        if record.exc_info and str(record.msg).startswith("Invalid write request"):
            user, host, *_ = (*tuple(record.args or ()), "", "")
            error = record.exc_info[1]
            record.msg, record.args = "write by %s on %s refused: %s: %s", (user, host, type(error).__name__, error)
            record.exc_info = record.exc_text = None
        return True


async def serve(motors: list[Motor], interfaces: list[str], over: Callable[[], bool], ready: Callable[[], object]):
    """Serve records until ``over`` returns True."""
    logging.getLogger("caproto").setLevel(logging.ERROR)  # suppress messages about short overloads
    logging.getLogger("caproto.circ").addFilter(RefusedWrites())
    records = {name: channel for motor in motors for name, channel in motor.pvdb.items()}

    async def started(library) -> None:
        for motor in motors:
            await motor.begin()
            await motor.look()
        ready()

    context = Context(records, interfaces)
    server = asyncio.create_task(context.run(log_pv_names=False, startup_hook=started))
    try:
        while not over() and not server.done():
            await asyncio.sleep(PERIOD)
            for motor in motors:
                await motor.look()
    finally:
        server.cancel()
        await asyncio.gather(server, return_exceptions=True)


def main() -> int:
    """Serve the records that the JSON argument describes until a signal arrives; return the exit code."""
    request = json.loads(sys.argv[1])
    over = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda signum, frame: over.set())
    stay_on_this_machine()
    rclpy.init(
        args=["--ros-args", "--enclave", enclave_of("", RECORDS)], signal_handler_options=SignalHandlerOptions.NO
    )
    node = rclpy.create_node(RECORDS, start_parameter_services=False)
    executor = make_executor()
    executor.add_node(node)
    settings = [MotorSettings(**motor) for motor in request["motors"]]
    links = [AxisLink(node, motor) for motor in settings]
    hearing = threading.Thread(target=_hear, args=(executor, over), daemon=True)
    hearing.start()
    while request["wait"] and not over.is_set() and any(link.look(time.monotonic()).alarm == SILENT for link in links):
        time.sleep(LOOK)
    try:
        motors = [Motor(motor, link) for motor, link in zip(settings, links, strict=True)]
        names = ", ".join(motor.name for motor in settings)
        asyncio.run(serve(motors, request["interfaces"], over.is_set, lambda: print(f"serving {names}", flush=True)))
    except OSError as error:
        print(f"hysteresis: {' '.join(request['interfaces'])}: cannot listen on it: {error}", file=sys.stderr)
        return 2
    finally:
        over.set()
        hearing.join()
        executor.remove_node(node)
        node.destroy_node()
        rclpy.shutdown()
    return 0


def _hear(executor, over: threading.Event) -> None:
    """Process messages until ``over`` is set; the main function of a thread."""
    while not over.is_set():
        executor.spin_once(timeout_sec=LOOK)


if __name__ == "__main__":
    raise SystemExit(main())
