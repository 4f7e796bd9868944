# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The catalogue of fault cases: the action, its target, and the required behaviour."""

from __future__ import annotations

from dataclasses import dataclass

from hysteresis_ros.errors import ConfigurationError, did_you_mean

#: Ways in which the nodes of an axis run.
FUSED, COMPOSED, PROCESSES = WAYS = ("fused", "composed", "processes")
#: Ways in which the nodes exchange messages.
MESSAGES = (COMPOSED, PROCESSES)

#: Names of the time-outs after which the voltage goes to its safe value.
MEASUREMENT, COMMAND, VOLTAGE = TIMEOUTS = ("measurement", "command", "voltage")

#: Test equipment around an axis: a relay of its measurements, a nearly full disk, an emulated device instead of the
#: simulated plant, an adjustable time of day; ``FRESH``: a newly started axis without test equipment.
RELAY, SMALL_DISK, DEVICE, CLOCK, FRESH = GRAPHS = ("relay", "small disk", "device", "clock", "fresh")

#: Requirements of every fault case.
ALWAYS = (
    "every output voltage of the plant is within its limits, and changes between two samples by no more "
    "than the slew rate allows; no process ends unless it was ended on purpose; no process prints a "
    "traceback; nothing hangs; "
    "afterwards the axis follows setpoints again without a restart of parts that have not failed"
)


@dataclass(frozen=True)
class Mishap:
    """One fault case."""

    name: str  #: Name by which the case is selected.
    group: str  #: Heading in the page.
    done: str  #: Description of the action.
    claim: str  #: Required behaviour beyond :data:`ALWAYS`; empty: nothing more.
    action: str  #: Name of the action in ``laboratory/campaign/actions.py``.
    victim: str = ""  #: Target: a node or a topic.
    amounts: tuple[float, ...] = (0.0,)  #: Amounts of the action, in its unit; each is executed once.
    ways: tuple[str, ...] = WAYS  #: Entries of :data:`WAYS` to which the case applies.
    elsewhere: str = ""  #: Why the case does not apply to the other ways of running.
    #: One of :data:`TIMEOUTS`: the voltage must be safe within this time-out plus the time of its return to the safe
    #: value; empty: no such requirement.
    safe: str = ""
    #: Whether the displacement must stay between rest and setpoints, within a tolerance.
    bounded: bool = True
    #: Fault that a fused axis injects itself, one of :data:`hysteresis_ros.loop.faults.FAULTS`; empty: the action
    #: causes the fault, as with nodes that exchange messages.
    fault: str = ""
    graph: str = ""  #: One of :data:`GRAPHS`, or empty; only cases with the same entry share an axis.
    rate: float = 0.0  #: Sample rate [Hz]; 0: the rate of the campaign.


def chosen_ways(text: str) -> list[str]:
    """Return the ways of running in a comma-separated text."""
    found = [word.strip() for word in text.split(",") if word.strip()]
    for word in found:
        if word not in WAYS:
            raise ConfigurationError(
                f"--ways {text}: no way '{word}'{did_you_mean(word, WAYS)}; there are {', '.join(WAYS)}"
            )
    if not found:
        raise ConfigurationError(f"--ways: name at least one of {', '.join(WAYS)}")
    return found


#: Why a single node cannot be killed.
ONE_PROCESS = "all nodes are one process"
#: Why messages cannot be changed.
NO_MESSAGES = "the loop is closed inside one process, without messages"

_KILLED = {
    "motion_controller": (COMMAND, "the compensator brings the voltage to its safe value"),
    "hysteresis_compensator": (VOLTAGE, "the plant brings the voltage to its safe value"),
    "plant_simulator": ("", ""),
    "reference_generator": ("", "after its restart it does not move the axis without a setpoint"),
}
#: Killed nodes, each with the time-out after which the voltage becomes safe; sample rates of these cases [Hz].
_LOST = {"motion_controller": COMMAND, "hysteresis_compensator": VOLTAGE, "reference_generator": MEASUREMENT}
LOSS_RATES = (10.0, 200.0, 3000.0)
#: Durations for which a process is suspended [s].
STOPPED = (0.05, 0.3, 1.0, 3.0)


def _of_processes():
    for node, (safe, claim) in _KILLED.items():
        yield Mishap(
            f"kill {node}",
            "Processes",
            "SIGKILL; restarted when the voltage is safe" if safe else "SIGKILL; restarted after 1 s",
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
                f"SIGKILL at {rate:g} Hz; restarted when the axis has stopped",
                "the axis is latched, and the restarted node moves nothing before ~/start",
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
        "SIGKILL of all processes together; restarted after 0.1 and 2 s",
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


#: Faults of the measurement: name, description, name in the relay, name in the loop, amounts, safe within, bounded.
_MEASURED: tuple[tuple[str, str, str, str, tuple[float, ...], str, bool], ...] = (
    ("stopped", "no measurement arrives", "stopped", "stale", (0.0,), MEASUREMENT, True),
    ("not a number", "NaN in each message", "nan", "nan", (0.0,), MEASUREMENT, True),
    ("frozen", "the position stays constant while stamps continue, for 3 s", "frozen", "frozen", (0.0,), "", False),
    ("spikes", "one in ten measurements deviates by 20 % of the stroke, for 3 s", "spikes", "spike", (0.2,), "", False),
    ("out of order", "each pair of messages arrives in reverse order", "disordered", "disorder", (0.0,), "", True),
    ("delayed", "1, 5, 20 and 50 ms, for 3 s", "delayed", "late", (1e-3, 5e-3, 2e-2, 5e-2), "", False),
    ("dropped", "1, 10 and 30 % of them at random, for 3 s", "dropped", "drop", (0.01, 0.1, 0.3), "", False),
)
#: Faults that exist for messages only: name, description, required behaviour, name in the relay, amounts.
_MESSAGES: tuple[tuple[str, str, str, str, tuple[float, ...]], ...] = (
    ("duplicated", "each message comes twice", "", "duplicated", (0.0,)),
    (
        "without positions",
        "names without positions",
        "the voltage goes to its safe value, as if no measurement arrived",
        "partial",
        (0.0,),
    ),
    ("of another device", "joint_states of a gripper between the measurements", "no effect", "foreign", (0.0,)),
    ("clock of the driver", "stamps jump forward or back by 10 s", "", "stamped", (10.0, -10.0)),
)


def _of_measurements():
    heading = "Measurement"
    for name, done, relayed, fault, amounts, safe, bounded in _MEASURED:
        claim = "the command stays constant; if the fault lasts, it goes to its safe value" if safe else ""
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
        "random setpoints at 1 kHz and 10 kHz, one in seven invalid, all cores busy, for 3 s",
        "the displacement stays between rest and setpoints",
        "flood",
        "setpoint",
        amounts=(1e3, 1e4),
    )
    for topic in ("command", "voltage", "joint_states"):
        yield Mishap(
            f"second sender of {topic}",
            heading,
            f"another publisher of random {topic} at 200 Hz, for 3 s",
            "the displacement stays between rest and setpoints",
            "second sender",
            topic,
            amounts=(200.0,),
        )
    yield Mishap(
        "second graph",
        heading,
        "the same nodes with the same names are started a second time, in separate processes",
        "they are refused with exit code 2 and name the running nodes; nothing moves",
        "second graph",
    )
    yield Mishap(
        "storm of parameters",
        heading,
        "300 changes of random numerical parameters by 2 % during moves, one in three to an invalid value",
        "all are answered",
        "storm",
        amounts=(300.0,),
    )
    yield Mishap(
        "calls in any order",
        heading,
        "100 transitions of the lifecycle (some unknown) and ~/start, ~/stop, ~/reset of random nodes",
        "all are answered; the axis runs after configure, activate and start",
        "anything",
        amounts=(100.0,),
    )


def _of_machines():
    heading = "Machine"
    yield Mishap("busy cores", heading, "all cores busy for 5 s during moves", "", "load", amounts=(5.0,))
    recorded = "composed or as processes, the recorder is a separate process"
    yield Mishap(
        "killed while recording",
        heading,
        "SIGKILL of the recording process, which is restarted; fused, it is the process of the axis",
        "the recording is readable and lacks at most its last 1.5 s; an axis in other processes continues",
        "cut recording",
        amounts=(0.5,),
        graph=FRESH,
    )
    yield Mishap(
        "time of day",
        heading,
        "the time of day of the nodes jumps an hour forward, two hours back, then returns (DDS keeps its own clock)",
        "the displacement stays between rest and setpoints",
        "set clock",
        graph=CLOCK,
    )
    yield Mishap(
        "full disk",
        heading,
        "the disk becomes full during a recording",
        "the recording ends, the axis continues",
        "fill",
        ways=(FUSED,),
        elsewhere=recorded,
        graph=SMALL_DISK,
    )


def _of_devices():
    for fault, done in (
        ("busy", "an emulated GCS controller over TCP refuses commands as busy, for 1 s"),
        ("error", "it answers commands with an error, for 1 s"),
        ("slow", "each answer is delayed by 0.2 s, for 2 s"),
        ("silent", "it does not answer, for 2 s"),
        ("cut", "its link is cut, and refuses connections for 1 s"),
    ):
        yield Mishap(
            f"device {fault}",
            "Device",
            done,
            "if the axis stops, it continues with ~/start after the fault",
            "misbehave",
            fault,
            amounts=(2.0 if fault in ("slow", "silent") else 1.0,),
            graph=DEVICE,
        )


#: All fault cases, by name.
CATALOGUE: dict[str, Mishap] = {
    mishap.name: mishap
    for mishap in (*_of_processes(), *_of_measurements(), *_of_people(), *_of_machines(), *_of_devices())
}


def chosen(names: tuple[str, ...]) -> tuple[Mishap, ...]:
    """Return the fault cases with these names or groups, or all if none is given, in the order of the catalogue."""
    groups = {mishap.group for mishap in CATALOGUE.values()}
    for name in names:
        if name not in CATALOGUE and name not in groups:
            near = did_you_mean(name, [*CATALOGUE, *groups])
            raise ConfigurationError(f"no fault case '{name}'{near}; hysteresis faults --list shows all")
    return tuple(item for item in CATALOGUE.values() if not names or item.name in names or item.group in names)
