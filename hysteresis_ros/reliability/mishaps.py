# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Mishaps: what is done, to whom, and what must happen."""

from __future__ import annotations

from dataclasses import dataclass

from hysteresis_ros.errors import ConfigurationError, did_you_mean

#: Ways in which the nodes of an axis run.
FUSED, COMPOSED, PROCESSES = WAYS = ("fused", "composed", "processes")
#: Those in which the nodes exchange messages.
MESSAGES = (COMPOSED, PROCESSES)

#: What is named by a voltage that goes to safe: whose time-out it is that counts.
MEASUREMENT, COMMAND, VOLTAGE = TIMEOUTS = ("measurement", "command", "voltage")

#: What there may be in a graph besides the axis: a relay of its measurements, a disk that is nearly full, a device in
#: the simulated plant's place, a time of day that can be set; or nothing, and nothing has happened to it before.
RELAY, SMALL_DISK, DEVICE, CLOCK, FRESH = GRAPHS = ("relay", "small disk", "device", "clock", "fresh")

#: What must hold in every mishap.
ALWAYS = (
    "every voltage that the plant puts out is within its limits, and between two samples it changes by no more than "
    "the slew rate allows; no process ends that was not ended on purpose; nobody prints a traceback; nothing hangs; "
    "afterwards the axis follows setpoints again without a restart of what had not failed"
)


@dataclass(frozen=True)
class Mishap:
    """One thing that goes wrong.

    Parameters
    ----------
    name : str
        As it is chosen by.
    group : str
        Under which heading it stands.
    done : str
        What is done, in words.
    claim : str
        What must happen beyond :data:`ALWAYS`; empty: nothing.
    action : str
        Who does it, of ``nodes/campaign``.
    victim : str
        To whom: a node or a topic.
    amounts : tuple of float
        Of the action, in its unit; it is done once with each.
    ways : tuple of str
        Of :data:`WAYS`, in which it can be done.
    elsewhere : str
        Why it cannot be done in the others.
    safe : str
        Of :data:`TIMEOUTS`: the voltage must be safe within this time-out and the time of its return; empty: it need
        not be.
    bounded : bool
        Whether the displacement must stay between the rest position and what was asked for, by a part of the stroke.
    fault : str
        Of :data:`hysteresis_ros.loop.faults.FAULTS`: who does it where the nodes are fused; empty: the action, too.
    graph : str
        Of :data:`GRAPHS`, or empty; a mishap shares its axis only with others of the same.
    """

    name: str
    group: str
    done: str
    claim: str
    action: str
    victim: str = ""
    amounts: tuple[float, ...] = (0.0,)
    ways: tuple[str, ...] = WAYS
    elsewhere: str = ""
    safe: str = ""
    bounded: bool = True
    fault: str = ""
    graph: str = ""


def chosen_ways(text: str) -> list[str]:
    """Return the ways of running that a text names, with commas between them.

    Parameters
    ----------
    text : str

    Raises
    ------
    ConfigurationError
        One of them is none.
    """
    found = [word.strip() for word in text.split(",") if word.strip()]
    for word in found:
        if word not in WAYS:
            raise ConfigurationError(f"--ways {text}: no way '{word}'{did_you_mean(word, WAYS)}; {', '.join(WAYS)}")
    if not found:
        raise ConfigurationError(f"--ways: name at least one of {', '.join(WAYS)}")
    return found
