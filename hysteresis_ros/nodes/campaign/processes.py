# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Done to processes: killed, stopped, ended, and started again."""

from __future__ import annotations

import signal
import time

from hysteresis_ros.nodes.campaign.group import AXIS
from hysteresis_ros.nodes.campaign.rig import START, Rig
from hysteresis_ros.reliability.bounds import SLACK
from hysteresis_ros.reliability.mishaps import Mishap

#: Part of the stroke by which an axis that nobody asks may creep.
UNASKED = 0.03
#: Whose end is that of the plant.
WITH_PLANT = ("plant_simulator", AXIS)
#: All processes of an axis.
ALL = "all"


def kill(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Kill processes hard, and start them again.

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
        Its victim is a process, or :data:`ALL`.
    amount : float
        Seconds between; 0: until the voltage has had the time to become safe.
    """
    victims = rig.group.names if mishap.victim == ALL else (mishap.victim,)
    for victim in victims:
        rig.group.send(victim, signal.SIGKILL)
    time.sleep(amount or rig.bounds.timeouts[mishap.safe] + SLACK)
    place = rig.witness.displacement
    _again(rig, victims)
    if mishap.victim == "reference_generator":
        time.sleep(SLACK)
        moved = rig.witness.displacement - place
        if abs(moved) > UNASKED * rig.bounds.stroke and not rig.witness.tripped:
            rig.broken.append(f"started again, it sends the axis by {1e6 * moved:.2g} µm unasked")


def stop(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Stop processes for some time (SIGSTOP, SIGCONT).

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
        Its victim is a process, or :data:`ALL`.
    amount : float
        [s]
    """
    victims = rig.group.names if mishap.victim == ALL else (mishap.victim,)
    for victim in victims:
        rig.group.send(victim, signal.SIGSTOP)
    time.sleep(amount)
    for victim in victims:
        rig.group.send(victim, signal.SIGCONT)


def _again(rig: Rig, victims) -> None:
    """Start processes that have ended, and wait until they are at work."""
    if any(victim in WITH_PLANT for victim in victims):
        rig.witness.life += 1
    begun, rows = time.monotonic(), len(rig.witness.rows)
    for victim in victims:
        rig.group.start(victim)
    seen = rig.witness.until(lambda: len(rig.witness.rows) > rows, START)
    if not seen or not rig.runs(None if AXIS in victims else victims):
        rig.broken.append(f"not at work {START:g} s after it was started again")
    rig.notes.append(f"started again, at work after {time.monotonic() - begun:.1f} s")
