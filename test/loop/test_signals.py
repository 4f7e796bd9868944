# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The table of signals: indices, names and units; and consistency of states, topics and recordings with it."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from loop_support import assert_same_bits, axis, parameters

from hysteresis_ros import signals
from hysteresis_ros.configuration import NODE_NAMES
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.recordings import load_run, save_run
from hysteresis_ros.recordings.run_bag import write_recording

NODES = (*signals.WRITERS,)


def test_every_place_has_the_name_of_its_signal():
    for index, signal in enumerate(signals.SIGNALS):
        assert getattr(signals, signal.name.upper()) == index == signals.place(signal.name), signal.name
    with pytest.raises(KeyError):
        signals.place("voltages")


def test_what_only_a_motor_has_stands_behind_what_every_axis_has():
    motor = [signal.motor for signal in signals.SIGNALS]
    assert motor == sorted(motor)
    assert signals.ACTUATOR_ROW == motor.index(True) == len(signals.ACTUATOR.row)
    assert signals.MOTOR_ROW == len(signals.SIGNALS) == len(signals.INCHWORM.row)
    # the row of an actuator's axis contains only the first two requests
    assert max(signals.ASKED[:2]) < signals.ACTUATOR_ROW <= min(signals.ASKED[2:])
    assert {signals.SIGNALS[place].name for place in signals.ASKED} == {
        signal.name for signal in signals.SIGNALS if signal.writer == signals.USER
    }


def test_a_kind_of_axis_is_found_by_its_nodes_and_those_write_what_it_has():
    actuator, inchworm = signals.ACTUATOR, signals.INCHWORM
    assert actuator.nodes == NODE_NAMES
    assert inchworm.nodes == tuple(signals.MOTOR_SOURCE if n == signals.SOURCE else n for n in NODE_NAMES)
    for kind in (actuator, inchworm):
        assert signals.kind_of(kind.nodes) is kind and kind.source in kind.nodes
        assert {writer for *_, writer in kind.voltages} <= {*kind.nodes}
        assert all(place < len(kind.row) for place in kind.given)
        assert {signal.name for signal in kind.row} >= {
            name for node in kind.nodes for name in kind.state(node).values()
        }
    assert [topic for topic, *_ in inchworm.voltages] == ["voltage", "front_clamp/voltage", "rear_clamp/voltage"]
    assert [topic for topic, *_ in actuator.voltages] == ["voltage"]
    assert inchworm.own_topics == ("origin", "front_clamp/voltage", "rear_clamp/voltage") and not actuator.own_topics


def test_names_topics_and_entries_of_states_are_unique():
    assert max(Counter(signal.name for signal in signals.SIGNALS).values()) == 1
    assert max(Counter(signal.topic for signal in signals.SIGNALS if signal.topic).values()) == 1
    assert max(Counter(entry for signal in signals.SIGNALS for entry in signal.state).values()) == 1
    assert {node for signal in signals.SIGNALS for node, _ in signal.state} == set(NODES)
    assert all(signal.unit and signal.description for signal in signals.SIGNALS)
    assert signals.UNITS["time"] == "s" and signals.UNITS["voltage"] == "V" and signals.UNITS["seen"] == "m"


@pytest.mark.parametrize("node", NODES)
def test_a_state_has_every_signal_that_says_so_once_and_its_first_entries_first(node):
    for kind in (signals.ACTUATOR, signals.INCHWORM):
        state = kind.state(node)
        expected = {name: signal.name for signal in kind.row for where, name in signal.state if where == node}
        assert state == expected
        first = [name for name in signals.STATE_FIRST.get(node, ()) if name in state]
        assert list(state)[: len(first)] == first
        rest = [signals.place(state[name]) for name in list(state)[len(first) :]]
        assert rest == sorted(rest)
    assert set(signals.STATE_FIRST.get(node, ())) <= set(signals.state_signals(node))


def test_every_signal_of_a_part_stands_in_a_state_or_on_a_topic():
    for signal in signals.SIGNALS:
        if signal.writer == signals.USER:
            continue
        nodes = {node for node, _ in signal.state}
        twin = {signals.SOURCE: signals.MOTOR_SOURCE}.get(signal.writer, signal.writer)
        assert {signal.writer, twin} <= nodes or signal.topic, signal.name


def test_topics_come_in_the_order_of_a_sample_and_an_origin_before_its_reference():
    topics = list(signals.float_topics())
    assert topics.index("origin") < topics.index("reference") < topics.index("command") < topics.index("voltage")
    assert set(topics) == {s.topic for s in signals.SIGNALS if s.topic and s.writer != signals.USER}
    assert "setpoint" not in topics


def test_a_signal_is_found_where_it_was_written_and_in_its_substitute_after_that():
    assert signals.sources("voltage") == (
        ("hysteresis_compensator", "voltage"),
        ("plant_simulator", "voltage"),
    )
    assert signals.sources("measured")[0] == ("plant_simulator", "measured")
    assert signals.sources("measured")[-1] == ("motion_controller", "measured")
    assert signals.sources("phase") == ((signals.MOTOR_SOURCE, "phase"),)


@pytest.mark.parametrize("name", ["kim2009", "inchworm_travel"])
@pytest.mark.parametrize("kind", ["bag", "run.mcap", "run.npz"])
def test_a_recording_that_is_read_back_has_every_signal_bit_for_bit(tmp_path, name, kind):
    given = parameters(name, every={"faults": ["stale:0.01:0.01", "late_voltage:0.0:1.0:0.3"]})
    run = simulate(given, duration=300 / given.plant_simulator.sample_rate)
    row = tuple(signal.name for signal in given.kind.row)
    assert tuple(run.signals) == (*row, signals.ASKED_VOLTAGE)  # a late voltage is not what was put out
    (write_recording if kind == "bag" else save_run)(run, tmp_path / kind)
    back = load_run(tmp_path / kind, further=True)
    assert set(run.signals) <= set(back.signals)
    assert_same_bits({"time": run.time, **run.signals}, {"time": back.time, **back.signals})
    assert all(back.units[signal] == signals.UNITS[signal] for signal in run.signals)


@pytest.mark.parametrize("name", ["kim2009", "inchworm_travel"])
def test_a_run_fills_every_place_of_the_row(name):
    """A sample overwrites every entry of the row, so nothing depends on earlier contents."""
    one, other = axis(name), axis(name)
    size = len(one.kind.row)
    columns = np.zeros((size, 1))
    if one.kind.motor:
        columns[signals.SPEED] = np.nan
    dirty = columns.copy()
    for _ in range(5):
        one._run(columns, row=np.zeros(size))
        rubbish = np.full(size, 17.0)
        other._run(dirty, row=rubbish)
        np.testing.assert_array_equal(columns, dirty)
        columns[list(signals.ASKED[: 4 if one.kind.motor else 2])] = 0.0
        dirty[list(signals.ASKED[: 4 if one.kind.motor else 2])] = 0.0
