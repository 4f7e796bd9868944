# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The mishaps of a campaign, each one entry."""

from __future__ import annotations

from hysteresis_ros.errors import ConfigurationError, did_you_mean
from hysteresis_ros.reliability.mishaps import COMMAND, PROCESSES, VOLTAGE, Mishap

#: Why a single node cannot be killed there.
ONE_PROCESS = "all nodes are one process"
FOUR_PROCESSES = "every node is a process of its own"

_KILLED = {
    "motion_controller": (COMMAND, "the compensator brings the voltage to safe"),
    "hysteresis_compensator": (VOLTAGE, "the plant brings the voltage to safe"),
    "plant_simulator": ("", "the others wait, and take it up again"),
    "reference_generator": ("", "the axis stays where it is; the controller says that nobody sends references"),
}
#: [s]
STOPPED = (0.05, 0.3, 1.0, 3.0)


def _of_processes():
    for node, (safe, claim) in _KILLED.items():
        yield Mishap(
            f"kill {node}",
            "Processes",
            "SIGKILL; started again when the voltage is safe" if safe else "SIGKILL; started again after 1 s",
            claim,
            "kill",
            node,
            amounts=(0.0,) if safe else (1.0,),
            ways=(PROCESSES,),
            elsewhere=ONE_PROCESS,
            safe=safe,
        )
    for node in _KILLED:
        yield Mishap(
            f"stop {node}",
            "Processes",
            "SIGSTOP, and SIGCONT after 0.05, 0.3, 1 and 3 s",
            "nothing that has waited meanwhile is answered",
            "stop",
            node,
            amounts=STOPPED,
            ways=(PROCESSES,),
            elsewhere=ONE_PROCESS,
        )
    yield Mishap(
        "kill all",
        "Processes",
        "SIGKILL of all processes at once; started again after 0.1 and 2 s",
        "",
        "kill",
        "all",
        amounts=(0.1, 2.0),
    )
    yield Mishap(
        "stop all",
        "Processes",
        "SIGSTOP of all processes, and SIGCONT after 0.05, 0.3, 1 and 3 s",
        "",
        "stop",
        "all",
        amounts=STOPPED,
    )


def _of_people():
    yield Mishap(
        "flood of setpoints",
        "People and programs",
        "1 kHz and 10 kHz of setpoints anywhere, one in seven garbage, all cores busy, for 3 s",
        "garbage is refused, the displacement stays within what was asked for",
        "flood",
        "setpoint",
        amounts=(1e3, 1e4),
    )


def _of_machines():
    yield Mishap("busy cores", "Machine", "all cores busy for 5 s amid moves", "", "load", amounts=(5.0,))


#: All mishaps, by their names.
CATALOGUE: dict[str, Mishap] = {mishap.name: mishap for mishap in (*_of_processes(), *_of_people(), *_of_machines())}


def chosen(names: tuple[str, ...]) -> tuple[Mishap, ...]:
    """Return the mishaps of these names or groups, in the order of the catalogue; all when there are none.

    Parameters
    ----------
    names : tuple of str

    Raises
    ------
    ConfigurationError
        There is none of a name.
    """
    groups = {mishap.group for mishap in CATALOGUE.values()}
    for name in names:
        if name not in CATALOGUE and name not in groups:
            near = did_you_mean(name, [*CATALOGUE, *groups])
            raise ConfigurationError(f"no mishap '{name}'{near}; hysteresis faults --list says what there is")
    return tuple(item for item in CATALOGUE.values() if not names or item.name in names or item.group in names)
