# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Changes of a running axis in lockstep: logged where they take effect, and repeated bit for bit from the log."""

from __future__ import annotations

import itertools
import signal

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import (  # noqa: E402
    REAL,
    SINE,
    RecordedRun,
    axis_parameters,
    shortened,
    until,
    write_axis,
)

CONTROLLER, COMPENSATOR, PLANT = "motion_controller", "hysteresis_compensator", "plant_simulator"
SOURCE = "reference_generator"
#: One of each kind of change, each of which may occur any number of times. False: it is refused.
RETUNED = (
    (CONTROLLER, {"type": "pid"}, True),
    (CONTROLLER, {"pid__Ki": 30.0}, True),
    (CONTROLLER, {"type": "sliding_mode"}, True),
    (CONTROLLER, {"sliding_mode__phi": 0.9, "sliding_mode__delta": 0.02}, True),
    (CONTROLLER, {"type": "open_loop"}, True),
    (CONTROLLER, {"type": "pid", "handover_time": -1.0}, False),
    (CONTROLLER, {"safe_slew_rate": 2.0e-4}, True),
    (CONTROLLER, {"model__preload__force": 0.4}, True),
    (COMPENSATOR, {"hysteresis__polynomial__scale": 1.02}, True),
    (COMPENSATOR, {"hysteresis__polynomial__scale": 0.98}, True),
    (COMPENSATOR, {"limits__maximum": -40.0}, False),
    (PLANT, {"preload__force": 0.3}, True),
    (PLANT, {"sensor__noise": 2.0e-9}, True),
    (PLANT, {"hysteresis__polynomial__scale": 1.03}, True),
    (PLANT, {"sample_rate": 100.0}, False),
    (SOURCE, {"waveform__frequency": 12.0}, False),
)


def walking_axis(samples: int):
    overrides = {node: dict(values) for node, values in REAL.items()}
    overrides[SOURCE] |= SINE
    overrides[CONTROLLER] |= {"pid__Ki": 20.0, "safe_slew_rate": 1.0e-4}
    overrides[CONTROLLER] |= {"learning__type": "repetitive", "learning__period": 0.05, "learning__maximum": 1.0e-7}
    overrides[CONTROLLER] |= {"learning__error_filter": (0.2, 0.3), "learning__robustness_filter": (0.5, 0.25)}
    return shortened(axis_parameters(overrides=overrides, time_mode="lockstep", exit_at_end=True), samples)


def names_of(values: dict) -> set[str]:
    return {name.replace("__", ".") for name in values}


@pytest.mark.parametrize(("how", "moments"), [("--composed", 700), ("--processes", 400)])
def test_changes_at_any_moment_are_repeated_bit_for_bit(processes, observer, tmp_path, how, moments):
    from rcl_interfaces.srv import SetParametersAtomically
    from sensor_msgs.msg import JointState
    from std_srvs.srv import Trigger

    from hysteresis_ros.loop.simulation import differences
    from hysteresis_ros.recordings.files import load_run

    random = np.random.default_rng(3)
    heard = observer.listen(JointState, "/plant_simulator/state")
    # endless, because a run that ends before all requests would not answer them
    axis = walking_axis(0)
    path = write_axis(tmp_path / "axis.yaml", axis)
    run = processes.command("up", path, how, "--record", str(tmp_path / "bag"))
    moments = np.sort(random.integers(50, moments, len(RETUNED) + 11))
    asked = [("set", change) for change in RETUNED]
    asked += [("call", (node, action)) for node in (CONTROLLER, COMPENSATOR, SOURCE) for action in ("stop", "start")]
    asked += [("call", (CONTROLLER, action)) for action in ("freeze", "learn", "forget")]
    order = random.permutation(len(RETUNED))
    sequence = [asked[index] for index in order]
    for place, step in zip((3, 6, 8, 12, 14, 17, 5, 10, 18), asked[len(RETUNED) :], strict=True):
        sequence.insert(place, step)
    for kind, what in sequence:  # discovery lasts many samples, with a new client for each request
        service = SetParametersAtomically if kind == "set" else Trigger
        name = f"/{what[0]}/{'set_parameters_atomically' if kind == 'set' else what[1]}"
        if name not in observer.kept_clients:
            observer.keep_client(service, name)
    first, wanted = len(heard), 0
    for moment, (kind, what) in zip(moments, sequence, strict=False):
        until(lambda moment=moment: len(heard) >= first + moment or run.popen.poll() is not None, what="the run")
        if kind == "set":
            node, values, accepted = what
            success, reason = observer.set_parameters(f"/{node}", **values)
            # a waveform may change while its node is stopped
            assert success == accepted or node == SOURCE, (values, reason)
        else:
            success = observer.trigger(f"/{what[0]}/{what[1]}").success
        wanted += success
    last = len(heard)
    until(lambda: len(heard) > last + 100 or run.popen.poll() is not None, what="samples after the last change")
    assert run.leave(signal.SIGINT)[0] == 0, run.output
    recorded = load_run(tmp_path / "bag", further=True)
    assert recorded.time.size > last and recorded.metadata.get("missing_changes", 0) == 0
    assert differences(recorded, axis) == {}
    changes = recorded.metadata["changes"]
    assert len(changes) == wanted
    assert {change["node"] for change in changes} == {CONTROLLER, COMPENSATOR, PLANT, SOURCE}
    assert {change["action"] for change in changes} == {"retune", "start", "stop", "freeze", "learn", "forget"}


def test_a_change_between_any_two_inputs_of_a_sample_is_repeated_bit_for_bit(inside, tmp_path):
    """Each change falls between two messages of a sample, at a different place each time."""
    from rclpy.parameter import Parameter

    from hysteresis_ros.loop.simulation import differences

    run = RecordedRun(inside, walking_axis(1500), tmp_path / "bag")
    nodes = {PLANT: run.plant, COMPENSATOR: run.compensator, CONTROLLER: run.controller, SOURCE: run.source}
    # before a node answers, after it has answered, and after the plant has received the voltage
    places = [
        *((run.source, "before_step"), (run.source, "after_step"), (run.controller, "before_step")),
        *((run.controller, "after_step"), (run.compensator, "before_step"), (run.plant, "finish_sample")),
    ]
    changes = itertools.cycle(
        (node, place, values, accepted)
        for place in range(len(places))
        for node, values, accepted in RETUNED
        if node != SOURCE
    )
    made, due = [], [next(changes)]

    def change(place: int) -> None:
        node, where, values, accepted = due[0]
        if place != where or nodes[PLANT].sample < 20 + 14 * len(made):
            return
        due[0] = next(changes)
        given = [Parameter(name.replace("__", "."), value=value) for name, value in values.items()]
        result = nodes[node].set_parameters_atomically(given)
        assert result.successful == accepted, (values, result.reason)
        made.append((node, values, accepted))

    for place, (node, method) in enumerate(places):
        usual = getattr(node, method)
        setattr(node, method, lambda usual=usual, place=place: (usual(), change(place)))
    inside.spin()
    recorded = run.result()
    assert len(made) > len(places) * 14 - 2
    assert differences(recorded, run.axis) == {}
    log = recorded.metadata["changes"]
    assert len(log) == sum(accepted for _, _, accepted in made)
    # the log contains the differences from the previous values, and the place where they took effect
    assert all(set(entry["parameters"]) <= names_of(dict.fromkeys(k for _, v, _ in made for k in v)) for entry in log)
    stages = {(entry["node"], entry.get("after", "")) for entry in log}
    assert {(PLANT, "measured"), (PLANT, ""), (CONTROLLER, "answered"), (CONTROLLER, ""), (COMPENSATOR, "")} == stages
    late = [entry for entry in log if entry.get("after") == "answered"]
    assert any("type" in entry["parameters"] for entry in late)


def test_a_change_before_activation_is_part_of_the_run(inside, observer, tmp_path):
    from hysteresis_ros.loop.simulation import differences

    axis = walking_axis(200)
    run = RecordedRun(inside, axis, tmp_path / "bag")
    assert run.controller.trigger_deactivate() is not None
    inside.spin()
    assert observer.set_parameters(f"/{CONTROLLER}", type="pid")[0]
    assert observer.trigger(f"/{COMPENSATOR}/stop").success
    assert observer.transition(f"/{CONTROLLER}", "activate")
    recorded = run.result()
    log = recorded.metadata["changes"]
    assert log[0]["sample"] == 0 and log[0]["parameters"] == {"type": "pid"}
    assert differences(recorded, run.axis) == {}
    assert np.max(np.abs(recorded["voltage"])) < 0.01
