# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The mishaps of a campaign: what is done, to which part, and what must happen then."""

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
    """One thing that goes wrong."""

    name: str  #: As it is chosen by.
    group: str  #: Under which heading it stands.
    done: str  #: What is done, in words.
    claim: str  #: What must happen beyond :data:`ALWAYS`; empty: nothing.
    action: str  #: Of ``laboratory/campaign/actions.py``.
    victim: str = ""  #: To whom: a node or a topic.
    amounts: tuple[float, ...] = (0.0,)  #: Of the action, in its unit; it is done once with each.
    ways: tuple[str, ...] = WAYS  #: Of :data:`WAYS`, in which it can be done.
    elsewhere: str = ""  #: Why it cannot be done in the others.
    #: Of :data:`TIMEOUTS`: the voltage must be safe within this time-out and the time of its return; empty: it need
    #: not be.
    safe: str = ""
    #: Whether the displacement must stay between the rest position and what was asked for, by a part of the stroke.
    bounded: bool = True
    #: Of :data:`hysteresis_ros.loop.faults.FAULTS`: who does it where the nodes are fused; empty: the action, too.
    fault: str = ""
    graph: str = ""  #: Of :data:`GRAPHS`, or empty; a mishap shares its axis only with others of the same.
    rate: float = 0.0  #: Sample rate [Hz] at which it is done; 0: that of the campaign.


def chosen_ways(text: str) -> list[str]:
    """Return the ways of running that a text names, with commas between them."""
    found = [word.strip() for word in text.split(",") if word.strip()]
    for word in found:
        if word not in WAYS:
            raise ConfigurationError(f"--ways {text}: no way '{word}'{did_you_mean(word, WAYS)}; {', '.join(WAYS)}")
    if not found:
        raise ConfigurationError(f"--ways: name at least one of {', '.join(WAYS)}")
    return found


#: Why a single node cannot be killed there.
ONE_PROCESS = "all nodes are one process"
#: Why nothing can be done to messages there.
NO_MESSAGES = "the loop is closed within, without messages"

_KILLED = {
    "motion_controller": (COMMAND, "the compensator brings the voltage to safe"),
    "hysteresis_compensator": (VOLTAGE, "the plant brings the voltage to safe"),
    "plant_simulator": ("", ""),
    "reference_generator": ("", "started again, it sends the axis nowhere unasked"),
}
#: What is lost at each of these sample rates [Hz], and whose time-out makes the voltage safe.
_LOST = {"motion_controller": COMMAND, "hysteresis_compensator": VOLTAGE, "reference_generator": MEASUREMENT}
LOSS_RATES = (10.0, 200.0, 3000.0)
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
            "",
            "stop",
            node,
            amounts=STOPPED,
            ways=(PROCESSES,),
            elsewhere=ONE_PROCESS,
        )
    for rate in LOSS_RATES:
        for node, safe in _LOST.items():
            yield Mishap(
                f"lose {node} at {rate:g} Hz",
                "Processes",
                f"SIGKILL at {rate:g} Hz; started again when the axis has stopped",
                "the axis is stopped, latched, and the node that is started again moves nothing before ~/start",
                "lose",
                node,
                ways=(PROCESSES,),
                elsewhere=ONE_PROCESS,
                safe=safe,
                rate=rate,
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


#: What is done to the measurement: what of it, in words, by a relay, by the loop, amounts, safe within, bounded.
_MEASURED: tuple[tuple[str, str, str, str, tuple[float, ...], str, bool], ...] = (
    ("stopped", "no measurement comes", "stopped", "stale", (0.0,), MEASUREMENT, True),
    ("not a number", "NaN in each", "nan", "nan", (0.0,), MEASUREMENT, True),
    ("frozen", "the position stays, stamps go on, for 3 s", "frozen", "frozen", (0.0,), "", False),
    ("spikes", "one in ten is off by 20 % of the stroke, for 3 s", "spikes", "spike", (0.2,), "", False),
    ("out of order", "every second one comes before the first", "disordered", "disorder", (0.0,), "", True),
    ("delayed", "1, 5, 20 and 50 ms, for 3 s", "delayed", "late", (1e-3, 5e-3, 2e-2, 5e-2), "", False),
    ("dropped", "1, 10 and 30 % of them by chance, for 3 s", "dropped", "drop", (0.01, 0.1, 0.3), "", False),
)
#: The same where only messages can be so: what of it, in words, what must happen, by a relay, amounts.
_MESSAGES: tuple[tuple[str, str, str, str, tuple[float, ...]], ...] = (
    ("duplicated", "each comes twice", "", "duplicated", (0.0,)),
    ("without positions", "names, and no positions", "it goes safe as without measurements", "partial", (0.0,)),
    ("somebody else's", "between them joint_states of a gripper", "it does not matter", "foreign", (0.0,)),
    ("clock of the driver", "stamps jump by 10 s forward, and by 10 s back", "", "stamped", (10.0, -10.0)),
)


def _of_measurements():
    heading = "Measurement"
    for name, done, relayed, fault, amounts, safe, bounded in _MEASURED:
        claim = "held; when it lasts, the command goes to safe" if safe else ""
        yield Mishap(
            f"measurement {name}",
            heading,
            done,
            claim,
            "measure",
            relayed,
            amounts,
            WAYS,
            "",
            safe,
            bounded,
            fault,
            RELAY,
        )
    for name, done, claim, relayed, amounts in _MESSAGES:
        safe = MEASUREMENT if relayed == "partial" else ""
        bounded = relayed != "stamped"
        yield Mishap(
            f"measurement {name}" if name != "clock of the driver" else name,
            heading,
            done,
            claim,
            "measure",
            relayed,
            amounts,
            MESSAGES,
            NO_MESSAGES,
            safe,
            bounded,
            "",
            RELAY,
        )


def _of_people():
    heading = "People and programs"
    yield Mishap(
        "flood of setpoints",
        heading,
        "1 kHz and 10 kHz of setpoints anywhere, one in seven garbage, all cores busy, for 3 s",
        "the displacement stays within what was asked for",
        "flood",
        "setpoint",
        amounts=(1e3, 1e4),
    )
    for topic in ("command", "voltage", "joint_states"):
        yield Mishap(
            f"second sender of {topic}",
            heading,
            f"somebody else publishes {topic} at 200 Hz, anywhere, for 3 s",
            "the displacement stays within what was asked for",
            "second sender",
            topic,
            amounts=(200.0,),
        )
    yield Mishap(
        "second graph",
        heading,
        "the same nodes of the same names are started again, in processes of their own",
        "they are refused with exit code 2 and say who is there; nothing moves",
        "second graph",
    )
    yield Mishap(
        "storm of parameters",
        heading,
        "300 changes of any number of any node amid moves, each by 2 %, one in three to nonsense",
        "all are answered",
        "storm",
        amounts=(300.0,),
    )
    yield Mishap(
        "calls in any order",
        heading,
        "100 transitions of the lifecycle (some that there are not) and ~/start, ~/stop, ~/reset of any node",
        "all are answered; then configured, activated and started the axis runs",
        "anything",
        amounts=(100.0,),
    )


def _of_machines():
    heading = "Machine"
    yield Mishap("busy cores", heading, "all cores busy for 5 s amid moves", "", "load", amounts=(5.0,))
    recorded = "composed and as processes the recorder is a process of its own"
    yield Mishap(
        "killed while recording",
        heading,
        "SIGKILL of the process that records: fused that of the axis, which is started again",
        "the recording is readable and lacks at most its last 1.5 s; an axis of other processes goes on",
        "cut recording",
        amounts=(0.5,),
        graph=FRESH,
    )
    yield Mishap(
        "time of day",
        heading,
        "the time of day that the nodes see jumps an hour forward, two back, and is right again (DDS keeps its own)",
        "the displacement stays within what was asked for",
        "set clock",
        graph=CLOCK,
    )
    yield Mishap(
        "full disk",
        heading,
        "nothing further can be written while it records",
        "the recording ends, the axis goes on",
        "fill",
        ways=(FUSED,),
        elsewhere=recorded,
        graph=SMALL_DISK,
    )


def _of_devices():
    for fault, done in (
        ("busy", "an emulated GCS controller over TCP refuses commands as long as something else is done, for 1 s"),
        ("error", "it answers commands with an error, for 1 s"),
        ("slow", "each answer comes 0.2 s later, for 2 s"),
        ("silent", "it does not answer, for 2 s"),
        ("cut", "its link is cut, and nobody can connect for 1 s"),
    ):
        yield Mishap(
            f"device {fault}",
            "Device",
            done,
            "where the axis stops, ~/start lets it go on when the device is mended",
            "misbehave",
            fault,
            amounts=(2.0 if fault in ("slow", "silent") else 1.0,),
            ways=MESSAGES,
            elsewhere="its driver is written in Python, which a fused loop refuses",
            graph=DEVICE,
        )


#: All mishaps, by their names.
CATALOGUE: dict[str, Mishap] = {
    mishap.name: mishap
    for mishap in (*_of_processes(), *_of_measurements(), *_of_people(), *_of_machines(), *_of_devices())
}


def chosen(names: tuple[str, ...]) -> tuple[Mishap, ...]:
    """Return the mishaps of these names or groups, in the order of the catalogue; all when there are none."""
    groups = {mishap.group for mishap in CATALOGUE.values()}
    for name in names:
        if name not in CATALOGUE and name not in groups:
            near = did_you_mean(name, [*CATALOGUE, *groups])
            raise ConfigurationError(f"no mishap '{name}'{near}; hysteresis faults --list says what there is")
    return tuple(item for item in CATALOGUE.values() if not names or item.name in names or item.group in names)
