# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Allowed requests of a page, its access rights, and its data: without nodes, without a web server."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros import signals
from hysteresis_ros.laboratory.watch.access import (
    ACTIONS,
    Access,
    Control,
    RequestError,
    is_loopback,
    new_token,
    read_request,
)
from hysteresis_ros.laboratory.watch.views import LOOP, SHOWN, History, View, extremes, limits_of, table_of
from hysteresis_ros.loop.parameters import NODE_PARAMETERS, NodeParameters

ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
WORDS = ("id", "do", "value", "values", "node", "window", "columns", "on", "text", "by_force")


@settings(max_examples=200)
@given(st.text(max_size=60) | st.dictionaries(st.sampled_from(WORDS), ANYTHING | st.sampled_from(list(ACTIONS))))
def test_garbage_is_refused_in_words_and_nothing_else_happens(garbage):
    text = garbage if isinstance(garbage, str) else json.dumps(garbage)
    try:
        request = read_request(text)
    except RequestError as error:
        assert str(error) and len(str(error)) < 400
    else:
        assert request.action in ACTIONS and request.number >= 0


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ("[1]", "must be an object"),
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ('{"do": "stop"}', "id = None"),
        ('{"id": 1, "do": "stpo"}', "did you mean stop"),
        ('{"id": 1, "do": "setpoint", "value": "5kg"}', "5kg"),
        ('{"id": 1, "do": "setpoint", "value": "5V"}', "must be a length"),
        ('{"id": 1, "do": "setpoint", "value": "nan"}', "nan"),
        ('{"id": 1, "do": "view", "window": 1e9, "columns": 500}', "0.02 … 60 s"),
        ('{"id": 1, "do": "view", "window": 1, "columns": NaN}', "finite"),
        ('{"id": 1, "do": "set", "node": "motion_controller", "values": {}}', "1 … 50 parameters"),
        ('{"id": 1, "do": "marker", "text": "   "}', "1 … 200 characters"),
        ('{"id": 1, "do": "record", "on": 1}', "true or false"),
        ('{"id": -1, "do": "stop"}', "id = -1: must be a whole number"),
    ],
)
def test_what_is_wrong_with_a_request_is_named(asked, words):
    with pytest.raises(RequestError) as caught:
        read_request(asked)
    assert words in str(caught.value)


@pytest.mark.parametrize(("count", "fits"), [(1, True), (50, True), (51, False)])
def test_so_many_parameters_are_set_at_once(count, fits):
    values = {f"pid.K{number}": "1" for number in range(count)}
    text = json.dumps({"id": 1, "do": "set", "node": "motion_controller", "values": values})
    if fits:
        assert read_request(text)[2] == {"node": "motion_controller", "values": values}
    else:
        with pytest.raises(RequestError, match="1 … 50 parameters"):
            read_request(text)


@pytest.mark.parametrize(("node", "name", "value"), [(100, 200, 4096), (101, 1, 1), (1, 201, 1), (1, 1, 4097)])
def test_names_and_values_of_parameters_have_a_longest_length(node, name, value):
    values = {"p" * name: "1" * value}
    text = json.dumps({"id": 1, "do": "set", "node": "n" * node, "values": values})
    if node == 100:
        assert read_request(text)[2] == {"node": "n" * 100, "values": values}
    else:
        with pytest.raises(RequestError, match=f"1 … {max(node, name, value) - 1} characters"):
            read_request(text)


def test_a_request_is_read_with_its_unit():
    assert read_request('{"id": 7, "do": "setpoint", "value": " 5 um"}') == (7, "setpoint", {"metres": 5e-6})
    assert read_request('{"id": 7, "do": "setpoint", "value": "-2e-6"}').values == {"metres": -2e-6}


def test_only_its_own_names_call_the_page_of_this_machine():
    here = Access("127.0.0.1", "")
    for host in ("127.0.0.1:8642", "localhost:8642", "LOCALHOST", "[::1]:8642", "127.0.0.1"):
        assert not here.refuses_host(host)
    for host in ("evil.example:8642", "127.0.0.1.evil.example", "", "192.168.1.7:8642", "localhost.evil.org", "[::1"):
        assert "localhost" in here.refuses_host(host)
    there = Access("192.168.1.7", "secret")
    assert not there.refuses_host("192.168.1.7:8642") and there.refuses_host("evil.example:8642")


def test_only_its_own_page_may_change_something():
    here = Access("127.0.0.1", "")
    own = {"Host": "localhost:8642"}
    assert not here.refuses_origin({**own, "Origin": "http://localhost:8642"})
    for origin in (
        "http://evil.example",
        "null",
        "http://localhost:9999",
        "https://localhost:8642",
        "http://localhost",
    ):
        assert origin in here.refuses_origin({**own, "Origin": origin})
    assert "X-Hysteresis" in here.refuses_origin(own)
    assert not here.refuses_origin({**own, "X-Hysteresis": "1"})
    assert here.refuses_origin({**own, "Origin": "http://evil.example", "X-Hysteresis": "1"})


def test_beyond_this_machine_a_token_is_needed_that_nobody_guesses():
    assert is_loopback("127.0.0.1") and is_loopback("::1") and not is_loopback("0.0.0.0") and not is_loopback("::")
    assert new_token("127.0.0.1") == "" and not Access("127.0.0.1", "").refuses_token("")
    token = new_token("0.0.0.0")
    assert len(token) >= 32 and token != new_token("0.0.0.0")
    access = Access("0.0.0.0", token)
    assert not access.refuses_token(token)
    for wrong in ("", token[:-1], f"{token}x", "ü\ud800"):
        assert access.refuses_token(wrong)


def test_one_page_writes_at_a_time():
    control = Control()
    assert control.refuses(1) == "no page controls the axis: take control first"
    assert control.ask(1, "10.0.0.1") and not control.ask(2, "10.0.0.2")
    assert not control.refuses(1) and "another page controls the axis (10.0.0.1" in control.refuses(2)
    control.leave(2)
    assert not control.refuses(1)
    assert control.ask(2, "10.0.0.2", by_force=True) and control.refuses(1) and not control.refuses(2)
    control.leave(2)
    assert control.ask(1, "10.0.0.1") and control.told(1)["mine"] and not control.told(2)["mine"]


def test_the_page_that_has_the_control_has_it_since_it_took_it(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("hysteresis_ros.laboratory.watch.access.time.time", lambda: now[0])
    control = Control()
    control.ask(1, "10.0.0.1")
    now[0] = 200.0
    assert control.ask(1, "10.0.0.9", by_force=True) and not control.ask(2, "10.0.0.2")
    assert control.told(2) == {"mine": False, "holder": "10.0.0.1", "since": 100.0}


def test_a_page_without_new_samples_gets_nothing_and_goes_on_where_it_was():
    history, view = History(len(SHOWN), 10_000), View(1.0, 100, 1000.0, 0)
    history.append(np.ones((len(SHOWN), 500)))
    assert parts_of(view.frame(history))[0]["fresh"]
    assert view.frame(history) is None
    history.append(np.ones((len(SHOWN), 100)))
    header, bins = parts_of(view.frame(history))
    assert not header["fresh"] and header["first"] * header["length"] == 500 and bins.shape[1] == 10


def test_a_page_shows_as_many_bins_as_its_window_has_and_begins_with_the_first():
    """A window of 1 s at 1000 samples per second, in 100 bins: the last 1000 samples; of fewer samples, all."""
    history = History(len(SHOWN), 10_000)
    history.append(np.ones((len(SHOWN), 10)))
    header, _ = parts_of(View(1.0, 100, 1000.0, 0).frame(history))
    assert (header["first"], header["bins"]) == (0, 1)
    history.append(np.ones((len(SHOWN), 4990)))
    header, _ = parts_of(View(1.0, 100, 1000.0, 0).frame(history))
    assert (header["length"], header["first"], header["bins"]) == (10, 400, 100)


@pytest.mark.parametrize(("window", "shown"), [(0.6, 600), (1.0, 1000), (60.0, 4000)])
def test_the_loops_are_those_of_the_window_and_at_most_of_four_seconds(window, shown):
    """The points of the loops are the newest samples, each of them up to four seconds at 1000 samples per second."""
    history, view = History(len(SHOWN), 10_000), View(window, 100, 1000.0, 0)
    table = np.arange(len(SHOWN) * 5000.0).reshape(len(SHOWN), 5000)
    history.append(table)
    frame = view.frame(history)
    header, bins = parts_of(frame)
    (length,) = struct.unpack("<I", frame[:4])
    points = np.frombuffer(frame[4 + length :], "<f4")[bins.size :].reshape(len(LOOP), header["points"])
    rows = [SHOWN.index(name) for name in LOOP]
    np.testing.assert_array_equal(points, table[rows, -shown:].astype("<f4"))
    assert (header["loop"], header["kept"], header["loop_fresh"]) == (shown, shown, True)


def parts_of(frame: bytes) -> tuple[dict, np.ndarray]:
    """Return the header of a frame and its signals, shape (signals, bins, 2)."""
    (length,) = struct.unpack("<I", frame[:4])
    header = json.loads(frame[4 : 4 + length])
    numbers = np.frombuffer(frame[4 + length :], "<f4")
    count = len(SHOWN) * header["bins"] * 2
    return header, numbers[:count].reshape(len(SHOWN), header["bins"], 2)


@given(st.lists(st.integers(0, 300), min_size=1, max_size=12), st.integers(50, 120), st.sampled_from([0.1, 0.37, 1.0]))
def test_a_page_gets_every_bin_once_however_its_frames_come(counts, columns, window):
    random = np.random.default_rng(sum(counts))
    history, view = History(len(SHOWN), 10_000), View(window, columns, 1000.0, 0)
    whole, heard, begun = np.empty((len(SHOWN), 0)), [], 0
    for count in counts:
        table = random.normal(size=(len(SHOWN), count))
        whole = np.concatenate([whole, table], axis=1)
        history.append(table)
        frame = view.frame(history)
        if frame is None:
            continue
        header, bins = parts_of(frame)
        if header["fresh"]:
            heard, begun = [], header["first"]
        assert header["first"] == begun + sum(part.shape[1] for part in heard)
        heard.append(bins)
    length = header["length"]
    found = np.concatenate(heard, axis=1)
    expected = extremes(whole[:, begun * length : (begun + found.shape[1]) * length], length)
    assert np.array_equal(found, expected.astype("f4"))
    assert whole.shape[1] - (begun + found.shape[1]) * length < length, "a complete bin is missing"


def test_only_parameters_are_shown_that_something_hangs_on_and_that_may_change():
    given_values = NODE_PARAMETERS["motion_controller"]().to_mapping() | {"type": "pid"}
    rows = {row["name"]: row for row in table_of("motion_controller", given_values)}
    assert given_values["learning.type"] == "none" and {"learning.type", "learning.gain"} & set(rows) <= {
        "learning.type"
    }
    # a block that is off can be switched on where that is possible while running
    assert given_values["damping.type"] == "none" and "damping.type" in rows and "damping.irc.k" not in rows
    assert "pid.Kp" in rows and not any(name.startswith("sliding_mode.") for name in rows)
    table = NODE_PARAMETERS["motion_controller"].table()
    fixed = {row.name for row in table if row.read_only} - {row.name for row in NodeParameters.table()}
    assert fixed and not fixed & set(rows), "read-only parameters cannot be tuned"
    row = next(row for row in table if row.name == "pid.Kp")
    assert rows["pid.Kp"] | {"allowed": row.allowed(), "unit": row.unit, "low": row.low} == rows["pid.Kp"]
    assert json.dumps(list(rows.values()))
    assert set(SHOWN) - {"error"} <= {signal.name for signal in signals.SIGNALS}


def test_setpoints_leave_room_for_the_waveform_around_them():
    source = NODE_PARAMETERS["reference_generator"].from_mapping({"minimum": 0.0, "maximum": 12e-6})
    values = {row.name: getattr(source, row.name, None) for row in NodeParameters.table()}
    flat = {"sample_rate": 1000.0, "minimum": 0.0, "maximum": 12e-6}
    assert values["sample_rate"] and limits_of({"reference_generator": flat})["slider"] == [0.0, 12e-6]
    triangle = {"waveform.type": "triangle", "waveform.amplitude": 7e-6, "waveform.frequency": 5.0}
    found = limits_of({"reference_generator": flat | triangle | {"waveform.offset": 1e-6}})
    assert found["setpoint"] == [0.0, 12e-6] and found["slider"] == pytest.approx([-1e-6, 4e-6])
    assert limits_of({"reference_generator": {"maximum": 12e-6}}) == {}
