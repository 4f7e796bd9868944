# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The fixture of a campaign: an axis in separate processes, its test equipment, and its observer.

Each process can be killed, suspended and started separately. The test equipment is an emulated device with faults, a
nearly full disk, or an adjustable time of day.
"""

from __future__ import annotations

import math
import os
import pathlib
import signal
import socket
import struct
import subprocess
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np

from hysteresis_ros.configuration import NODE_NAMES
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.laboratory.campaign.judging import REACHED, Samples, Trace, bounds_of
from hysteresis_ros.laboratory.campaign.mishaps import FUSED, PROCESSES, Mishap
from hysteresis_ros.laboratory.campaign.witness import REMAP, Relay, Witness
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.plant import DEVICE_FAILED
from hysteresis_ros.nodes.axis import WITH_RECORDER
from hysteresis_ros.nodes.launcher import PATIENCE, STOP_ORDER, node_command, node_environment, started
from hysteresis_ros.recordings.align import read_recording

#: Name of the process that contains all nodes.
AXIS = "hysteresis_axis"
#: Name of the separate recorder of nodes that exchange messages.
RECORDER = "recorder"

#: Number of last words of the output that a report about an ended process quotes.
LAST_WORDS = 30


class Group:
    """The processes of one axis."""

    def __init__(
        self,
        axis: AxisParameters,
        way: str,
        folder: pathlib.Path,
        remap: tuple[str, ...] = (),
        prefix: tuple[str, ...] = (),
        environment: dict[str, str] | None = None,
    ):
        self.names = NODE_NAMES[:4] if way == PROCESSES else (AXIS,)
        self.log = folder / "log.txt"
        self.bags: list[pathlib.Path] = []
        self._axis, self._way, self._folder = axis, way, folder
        self._more = [word for rule in remap for word in ("-r", rule)]
        self._prefix = list(prefix)
        self._environment = {**node_environment(), **(environment or {}), "PYTHONUNBUFFERED": "1"}
        self._processes: dict[str, subprocess.Popen] = {}
        self._ended: set[str] = set()
        for name in self.names:
            self.start(name)

    def start(self, name: str) -> None:
        """Start or restart a process."""
        axis, more = self._axis, []
        if self._way == FUSED or name == RECORDER:
            self.bags.append(self._folder / f"bag{len(self.bags)}")
            axis, more = axis.with_recorder(str(self.bags[-1])), [] if name == RECORDER else [WITH_RECORDER]
        path = self._folder / f"{name}.yaml"
        path.write_text(axis.configuration_text(), encoding="utf-8")
        command = [*self._prefix, *node_command(name, axis.namespace, path, *more, log_level="info"), *self._more]
        self._ended.discard(name)
        with open(self.log, "a", encoding="utf-8") as log:
            self._processes[name] = started(command, self._environment, stdout=log, stderr=subprocess.STDOUT)

    def send(self, name: str, number: signal.Signals) -> None:
        """Send a signal to a process; wait for its end after ``SIGKILL``."""
        if number == signal.SIGKILL:
            self._ended.add(name)
        self._processes[name].send_signal(number)
        if number == signal.SIGKILL:
            self._processes[name].wait()

    def identifier(self, name: str) -> int:
        """Return the id of a process."""
        return self._processes[name].pid

    def end(self, name: str) -> int | None:
        """End a process as Ctrl-C does; return its exit code, or None if it had to be killed."""
        self._ended.add(name)
        process = self._processes[name]
        process.send_signal(signal.SIGCONT)
        process.send_signal(signal.SIGTERM)
        try:
            return process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            return None

    def codes(self) -> list[int | None]:
        """Return the exit codes of the processes; None for a running process."""
        return [process.poll() for process in self._processes.values()]

    def died(self) -> list[str]:
        """Return a line for each process that ended by itself."""
        found = []
        for name, process in self._processes.items():
            code = process.poll()
            if code is not None and name not in self._ended:
                found.append(f"{name} ended by itself with exit code {code}")
        return found

    def printed(self, since: int = 0) -> str:
        """Return the output of the processes from byte ``since`` of the log."""
        with open(self.log, "rb") as log:
            log.seek(since)
            return log.read().decode("utf-8", "replace")

    def close(self) -> list[str]:
        """End all processes; return the problems."""
        found = []
        begun = time.monotonic()
        for name in sorted(self._processes, key=STOP_ORDER.index):
            if self._processes[name].poll() is not None:
                continue
            code = self.end(name)
            # with a full disk, exit code 1 is expected: the recording is incomplete
            if code and not (code == 1 and self._prefix):
                last = " ".join(self.printed().split()[-LAST_WORDS:])
                found.append(f"{name} ended with exit code {code}: {last}")
            elif code is None:
                found.append(f"{name} had to be killed after {time.monotonic() - begun:.0f} s")
        return found


#: Largest size of a file on the small disk [KiB].
ROOM = 1024
#: Time in which an emulated device must start [s].
DEVICE_START = 60.0
#: Polling interval while an emulated device starts, and time-out of each attempt to connect to it [s].
DEVICE_LOOK = 0.05
#: Code that Python runs first in a process with an adjustable time of day.
TIME_OF_DAY = """import os, struct, time
_time, _time_ns, _file = time.time, time.time_ns, os.open({path!r}, os.O_RDONLY)
def _offset():
    return struct.unpack("q", os.pread(_file, 8, 0))[0]
time.time = lambda: _time() + _offset()
time.time_ns = lambda: _time_ns() + 1_000_000_000 * _offset()
"""


def small_disk() -> tuple[str, ...]:
    """Return the prefix of a command that imitates a nearly full disk by a limit on the size of files."""
    return "bash", "-c", f'ulimit -f {ROOM}; exec "$@"', "bash"


class Clock:
    """An adjustable time of day for processes; monotonic clocks and DDS keep the machine's time.

    Libraries that replace the clocks of the C library (libfaketime 0.9.10) make every sleep of Python 3.11 fail, and
    changing the clock of the machine would affect all processes. Therefore Python's own functions are replaced, before
    any other import.
    """

    def __init__(self, folder: pathlib.Path):
        self._folder, self._file = folder, folder / "time_of_day"
        self.set(0)
        (folder / "sitecustomize.py").write_text(TIME_OF_DAY.format(path=str(self._file)), encoding="utf-8")

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables of the processes."""
        paths = (str(self._folder), node_environment().get("PYTHONPATH", ""))
        return {"PYTHONPATH": os.pathsep.join(path for path in paths if path)}

    def set(self, offset: int) -> None:
        """Shift the time of day.

        Units: ``offset`` [s].
        """
        with open(self._file, "r+b" if self._file.exists() else "wb") as file:
            file.write(struct.pack("q", offset))

    def close(self) -> None:
        """Do nothing; the campaign removes the folder with the offset's file."""


class Device:
    """An emulated controller with its own plant, which replaces the simulated plant."""

    def __init__(self, config: str):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = probe.getsockname()[1]
        words = ["emulate", "gcs", "--port", str(self._port), "--plant", config]
        command = [sys.executable, "-m", "hysteresis_ros.cli.main", *words]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "text": True}
        self._process = started(command, node_environment(), **pipes)
        patience = time.monotonic() + DEVICE_START
        while not self._answers():
            if self._process.poll() is not None or time.monotonic() > patience:
                self.close()
                raise HysteresisError(f"the emulated controller does not start: hysteresis {' '.join(words)}")
            time.sleep(DEVICE_LOOK)

    def _answers(self) -> bool:
        with socket.socket() as probe:
            probe.settimeout(DEVICE_LOOK)
            return probe.connect_ex(("127.0.0.1", self._port)) == 0

    def driven(self, axis: AxisParameters) -> AxisParameters:
        """Return the axis with this device as its plant."""
        plant = axis.plant_simulator
        back = (plant.limits.maximum - plant.limits.minimum) / plant.safe_slew_rate
        plant, given = replace(plant, driver="gcs"), {"port": self._port, "safe_time": back}
        own: dict[str, Any] = {"gcs": replace(plant.driver_parameters, **given)}  # parameters that the driver declares
        return replace(axis, plant_simulator=replace(plant, **own))

    def go_wrong(self, fault: str, seconds: float) -> None:
        """Start a fault that lasts for ``seconds``."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{fault}:0:{seconds:g}\n")
        self._process.stdin.flush()

    def close(self) -> None:
        """End the controller's process."""
        self._process.kill()
        self._process.wait()


#: Time allowed for an axis to start for the first time, including compilation on a busy machine [s].
FIRST_START = 300.0
#: Time allowed for nodes to start again [s].
START = 60.0
#: Time allowed for an axis to follow a setpoint again [s].
RECOVERY = 40.0
#: Number of unsuccessful moves after which an axis counts as not running.
TRIES = 3
#: Interval at which a setpoint is repeated [s], because a starting node may have missed it.
AGAIN = 1.0
#: Time for which an axis must stay at a setpoint so that the setpoint counts as reached [s].
KEPT = 0.1
#: Longest time from the start of a move to the fault [s].
MOVING = 0.4
#: Text that no process may print.
TRACEBACK = "Traceback (most recent call last)"


class Rig:
    """A running axis and its observer."""

    def __init__(
        self,
        axis: AxisParameters,
        way: str,
        folder: pathlib.Path,
        random: np.random.Generator,
        relayed: bool = False,
        beside: Device | Clock | None = None,
        **options,
    ):
        self.beside = beside
        self.axis, self.way, self.random = axis, way, random
        self.bounds = bounds_of(axis)
        self.broken: list[str] = []
        self.notes: list[str] = []
        self.asked: list[float] = []
        self.starts = 0
        self.begun = math.nan
        self.group = Group(axis, way, folder, remap=REMAP if relayed else (), **options)
        self.witness = Witness(axis.namespace)
        self.relay = Relay(self.witness, self.bounds.stroke, random) if relayed else None
        self.witness.until(lambda: len(self.witness.rows) > 5 or self.group.died(), FIRST_START)
        if not self.witness.rows:
            self._give_up("does not start")
        self.rest = self.witness.displacement
        # at first, voltages may be late, because four processes start together on a busy machine
        if not any(self.follows() for _ in range(TRIES)):
            self._give_up("does not follow setpoints")

    def _give_up(self, what: str) -> None:
        """Raise an error for an axis that does not run before any fault."""
        printed = self.group.printed().strip().splitlines()[-3:]
        self.close()
        raise HysteresisError(f"the axis {what} ({self.way}) before any fault: {' / '.join(printed)}")

    def _go_on(self) -> None:
        """Restart a tripped axis, as an operator would do after a check."""
        if self.witness.tripped and self.witness.trigger("plant_simulator", "start"):
            self.starts += 1

    # -- moving ----------------------------------------------------------------------------------------------------

    def ask(self, setpoint: float) -> None:
        """Publish and store a setpoint.

        Units: ``setpoint`` [m].
        """
        self.asked.append(setpoint)
        self.witness.ask(setpoint)

    def anywhere(self) -> float:
        """Return a random setpoint of the axis [m]."""
        return float(self.random.uniform(self.bounds.low, self.bounds.high))

    def follows(self, seconds: float = RECOVERY) -> bool:
        """Move the axis to the farther end of its range; return whether it arrives and stays."""
        low, high = self.bounds.low, self.bounds.high
        target = low if self.witness.displacement > 0.5 * (low + high) else high
        since = math.inf
        asked = 0.0

        def there() -> bool:
            nonlocal since, asked
            now = time.monotonic()
            if now - asked > AGAIN:
                self._go_on()
                self.ask(target)
                asked = now
            if not abs(self.witness.displacement - target) <= REACHED * self.bounds.stroke:  # also for NaN
                since = math.inf
            else:
                since = min(since, now)
            return now - since > KEPT

        return self.witness.until(there, seconds)

    def runs(self, nodes=None) -> bool:
        """Wait until nodes are active; return whether they are."""
        names = nodes or ("plant_simulator", "reference_generator", "motion_controller", "hysteresis_compensator")
        return all(self.witness.until(lambda node=node: self.witness.is_active(node), START) for node in names)

    # -- fault cases -----------------------------------------------------------------------------------------------

    def endure(self, mishap: Mishap, amount: float, action) -> Trace:
        """Execute an action during a move, and return the record."""
        self.broken, self.notes, self.asked, self.starts = [], [], [self.rest, self.witness.displacement], 0
        witness, printed = self.witness, self.group.log.stat().st_size
        witness.rows.clear()
        self.ask(self.anywhere())
        time.sleep(self.random.uniform(0.0, MOVING))
        self.begun = time.time()
        action(self, mishap, amount)
        begun, ended = self.begun, time.time()
        recovered = time.time() if self.follows() else math.nan
        if self.starts:
            self.notes.append("it trips, and continues with ~/start")
        self.broken += self.group.died()
        if TRACEBACK in self.group.printed(printed):
            self.broken.append("a traceback is printed")
        return Trace(
            mishap.name,
            self.way,
            amount,
            os.getloadavg()[0],
            begun,
            ended,
            recovered,
            (float(np.nanmin(self.asked)), float(np.nanmax(self.asked))),
            Samples.of(witness.rows).between(begun, math.inf),
            tuple(self.broken),
            witness.gravest(begun),
            tuple(self.notes),
        )

    def close(self) -> list[str]:
        """End the axis; return the problems."""
        found = self.group.close()
        for other in (self.relay, self.beside):
            if other is not None:
                other.close()
        self.witness.close()
        return found

    def recorded(self) -> Samples:
        """Return the samples of all recordings of a fused axis, in order."""
        if self.way != FUSED:
            return Samples.of(())
        found = []
        for life, bag in enumerate(self.group.bags):
            run = read_recording(bag, self.axis.namespace, further=True)
            time_ = run.time + 1e-9 * run.metadata["start_time_ns"]
            # a device failure counts as a restart: the output of a device that does not answer is unknown
            lives = life * len(run) + np.cumsum(run["tripped"] == DEVICE_FAILED)
            columns = (time_, run.time, run["plant_voltage"], run["displacement"], lives)
            found.append(np.vstack(columns).T)
        return Samples.of(np.vstack(found) if found else ())
