# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Triggers as a topic, in the bag, at a device, and pulses of the trigger input as messages."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import SOON_AT_REST, axis_parameters, compose, until  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

from hysteresis_ros import signals  # noqa: E402
from hysteresis_ros.hardware.drivers.simulated import SimulatedDriver  # noqa: E402
from hysteresis_ros.hardware.registry import DRIVERS  # noqa: E402
from hysteresis_ros.nodes.triggers import NAMES, TriggerTopic  # noqa: E402

ROWS = signals.ACTUATOR_ROW


class Heard:
    """Stands in for a node: keeps what the topic publishes, as (sample, number, position, direction, delay, lost)."""

    def __init__(self):
        self.rows: list[tuple] = []
        self.runner = SimpleNamespace(keeps=False)
        self.topic = TriggerTopic(self)

    def publisher(self, message_type, topic, qos):
        return SimpleNamespace(topic_name=f"/{topic}", publish=self.keep)

    def keep(self, message: JointState) -> None:
        assert tuple(message.name) == NAMES
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        self.rows.append((stamp // 100_000, *message.position))


def test_messages_and_blocks_tell_the_same_and_which_triggers_were_lost():
    table = np.zeros((ROWS, 30_000))
    at = {3: 1.0, 4: 2.0, 17: 5.0, 20_000: 6.0}
    for sample, number in at.items():
        table[signals.TRIGGER : signals.TRIGGER_DELAY + 1, sample] = number, 1e-6 * number, -1.0, 2e-5
    by_message, by_block, recorded = Heard(), Heard(), []
    by_block.topic.record = lambda stamp, values: recorded.append((stamp // 100_000, *values))
    for sample in range(30_000):
        by_message.topic.take(sample * 100_000, table[:, sample])
    for begin, end in ((0, 4), (4, 4), (4, 25_000), (25_000, 30_000)):
        by_block.topic.take_all(begin, table[:, begin:end], lambda numbers: numbers * 100_000)
    lost = {17: 2.0}
    wanted = [(k, n, 1e-6 * n, -1.0, 2e-5, lost.get(k, 0.0)) for k, n in at.items()]
    assert by_message.rows == by_block.rows == recorded == wanted
    assert by_message.topic.lost == by_block.topic.lost == 2
    # also those before the first one that was published
    late = Heard()
    late.topic.take(0, table[:, 17])
    assert late.rows[-1][-1] == 4.0 == late.topic.lost
    # after a reset of the axis they are counted from 1 again
    by_message.topic.restart()
    by_message.topic.take(0, table[:, 3])
    assert by_message.rows[-1][-1] == 0.0


def test_the_triggers_of_a_run_in_lockstep_are_on_their_topic_and_in_the_bag(processes, observer, tmp_path):
    from rclpy.serialization import deserialize_message

    from hysteresis_ros.recordings.align import read_recording
    from hysteresis_ros.recordings.bag_reader import read_bag
    from hysteresis_ros.recordings.triggers import triggers_of

    words = ("--reference", "triangle", "--frequency", "10Hz", "--amplitude", "8um", "--offset", "1um")
    words += ("--trigger", "start=2um", "--trigger", "step=1um", "--trigger", "stop=8um", "--duration", "0.2s")
    bag = tmp_path / "bag"
    run = processes.command(
        "up", "kim2009", "--composed", "--rate", "lockstep", *words, "--record", str(bag), "--verify"
    )
    assert run.wait() == 0, run.output
    assert "equal the offline twin bit for bit, none missing" in run.output
    recording = read_recording(bag)  # without further signals: a run that triggers has those of its triggers
    found = triggers_of(recording)
    assert found.sample.size == 28 and found.lost == 0
    zero = round(recording.metadata.get("start_ns", 0))
    stored = read_bag(bag).topics
    states = [deserialize_message(data, JointState) for data in stored["/joint_states"].data]
    zero = states[0].header.stamp.sec * 10**9 + states[0].header.stamp.nanosec
    kept = [deserialize_message(data, JointState) for data in stored["/trigger_out"].data]
    for k, message in enumerate(kept):
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec - zero
        assert stamp == round(found.sample[k] * 1e9 / 3000.0)
        number, position, direction, delay, lost = message.position
        assert (number, position, direction, lost) == (k + 1, found.position[k], found.direction[k], 0.0)
        assert recording.time[found.sample[k]] - delay == found.time[k]
    assert len(kept) == 28


class Outputs(SimulatedDriver):
    """The simulated actuator with a trigger output and a trigger input."""

    def open(self, parameters, sample_rate):
        self.numbers: list = []
        self.waiting = 0
        Outputs.last = self
        return replace(super().open(parameters, sample_rate), trigger_rate=1e6, trigger_input=True)

    def output_trigger(self, number, delay):
        self.numbers.append(number)

    def pulses(self):
        count, self.waiting = self.waiting, 0
        return count


def test_pulses_of_a_message_and_of_a_device_step_an_axis_whose_triggers_reach_the_device(
    inside, observer, monkeypatch
):
    from std_msgs.msg import Empty

    monkeypatch.setitem(DRIVERS, "simulated", replace(DRIVERS["simulated"], driver=Outputs))
    source = {
        "waveform__type": "hold",
        "triggers__positions": (0.5e-6, 1.9e-6),  # the step to 1 µm overshoots 1.5 µm
        "triggers__direction": "up",
        "triggers__input__action": "step",
        "triggers__input__distance": 1e-6,
    }
    overrides = {
        **SOON_AT_REST,
        "plant_simulator": {"late_limit": -1, "driver": "simulated", "trigger_output": True, "trigger_input": True},
        "reference_generator": source,
    }
    compose(inside, axis_parameters("", overrides, sample_rate=50.0, time_mode="realtime"))
    heard, pulse = observer.listen(JointState, "/trigger_out"), observer.talk(Empty, "/trigger_in")
    states = observer.listen(JointState, "/reference_generator/state")
    inside.spin()
    until(lambda: states and pulse.get_subscription_count(), what="an axis that runs")
    pulse.publish(Empty())
    until(lambda: Outputs.last.numbers and heard, what="the first position")
    # on a busy machine late voltages move the axis to safe and back, across the same position again
    assert {message.position[1] for message in heard} == {0.5e-6}
    Outputs.last.waiting = 1
    until(lambda: heard[-1].position[1] == 1.9e-6, what="the second position")
    until(lambda: Outputs.last.numbers[: len(heard)] == [message.position[0] for message in heard], what="the device")
    assert Outputs.last.numbers[0] == 1
    setpoint = states[-1].name.index("setpoint")
    until(lambda: states[-1].position[setpoint] == 2e-6, what="the setpoint after both pulses")
