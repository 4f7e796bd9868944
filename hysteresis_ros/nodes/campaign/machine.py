# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Done to the machine: its cores are taken, its disk is full."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace

from hysteresis_ros.nodes.campaign.group import AXIS, RECORDER
from hysteresis_ros.nodes.campaign.processes import kill
from hysteresis_ros.nodes.campaign.rig import START, Rig
from hysteresis_ros.nodes.campaign.surroundings import ROOM, Clock, Device
from hysteresis_ros.nodes.launcher import node_environment, started
from hysteresis_ros.recordings.align import read_recording
from hysteresis_ros.reliability.mishaps import FUSED, Mishap

#: Keeps a core busy.
BURN = "while True: sum(range(100000))"
#: Part of a small disk that is taken when nothing further fits, and seconds that are looked at then.
FILLED, AFTERWARDS = 0.75, 3.0
#: Seconds in which a small disk is full.
FULL = 60.0
#: A recording that is cut off may lack so much of its end [s], and how long it is before.
LOST, RECORDED = 1.5, 2.0
#: The time of day jumps to so far from what it is, and stays there [s].
OFFSETS, APART = (3600, -3600, 0), 1.5


@contextlib.contextmanager
def busy() -> Iterator[None]:
    """Keep all cores busy as long as the block runs."""
    environment = node_environment()
    command = [sys.executable, "-c", BURN]
    burning = [started(command, environment, stderr=subprocess.DEVNULL) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for process in burning:
            process.kill()
            process.wait()


def load(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Keep all cores busy while the axis moves to and fro.

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
    amount : float
        [s]
    """
    until = time.monotonic() + amount
    with busy():
        while time.monotonic() < until:
            rig.ask(rig.anywhere())
            time.sleep(0.25)


def fill(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Wait until the disk of a fused axis, which records all of its samples, is full.

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
    amount : float
    """

    def is_full() -> bool:
        sizes = [path.stat().st_size for path in rig.group.bags[-1].glob("*.mcap")]
        return sum(sizes) > FILLED * ROOM * 1024 or bool(rig.group.died())

    if not rig.witness.until(is_full, FULL):
        rig.broken.append(f"the disk is not full after {FULL:g} s")
    time.sleep(AFTERWARDS)


def cut_recording(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Kill a process that records, read what it has left, and start it again.

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
    amount : float
    """
    if rig.way != FUSED:
        rig.group.start(RECORDER)
        rig.witness.until(lambda: rig.witness.is_active(RECORDER), START)
        time.sleep(RECORDED)
    bag = rig.group.bags[-1]
    killed = time.time()
    kill(rig, replace(mishap, victim=AXIS if rig.way == FUSED else RECORDER), amount)
    run = read_recording(bag, rig.axis.namespace, further=True)
    lost = killed - (run.time[-1] + 1e-9 * run.metadata["start_time_ns"])
    rig.notes.append(f"the recording lacks its last {lost:.2f} s")
    missing = run.metadata["missing_samples"] if rig.way == FUSED else 0  # messages of a busy machine may come late
    if lost > LOST or missing:
        rig.broken.append(f"the recording lacks {lost:.2f} s, and {missing} samples amid the rest")


def set_clock(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Let the time of day jump, while the axis moves.

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
    amount : float
    """
    assert isinstance(rig.beside, Clock)
    for offset in OFFSETS:
        rig.beside.set(offset)
        rig.ask(rig.anywhere())
        time.sleep(APART)


def misbehave(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Let a device go wrong, and wait until it does not any more.

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
        Its victim is the fault.
    amount : float
        [s]
    """
    assert isinstance(rig.beside, Device)
    rig.beside.go_wrong(mishap.victim, amount)
    time.sleep(amount + 0.5)
