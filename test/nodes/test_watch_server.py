# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The server of the page with an emulated axis: access, write access, and invalid data."""

from __future__ import annotations

import asyncio
import json
import struct
from concurrent.futures import Future
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")
aiohttp = pytest.importorskip("aiohttp", reason="aiohttp is not installed: no page")

from pretended_axis import PATIENCE, served  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

from hysteresis_ros import signals  # noqa: E402
from hysteresis_ros.errors import HysteresisError  # noqa: E402
from hysteresis_ros.laboratory.watch import link as linking  # noqa: E402
from hysteresis_ros.laboratory.watch import server  # noqa: E402
from hysteresis_ros.laboratory.watch.link import AxisLink  # noqa: E402
from hysteresis_ros.laboratory.watch.memory import Collector  # noqa: E402
from hysteresis_ros.laboratory.watch.server import FILES  # noqa: E402
from hysteresis_ros.nodes.remote.client import AbsentError  # noqa: E402

#: Nodes of an actuator, in the order in which they are started.
NODES = ("plant_simulator", "hysteresis_compensator", "motion_controller", "reference_generator")


def test_the_files_are_there_and_nothing_changes_by_get():
    async def check(bench):
        for path in FILES:
            async with bench.session.get(bench.origin + path) as response:
                assert response.status == 200 and "default-src 'self'" in response.headers["Content-Security-Policy"]
        assert {"/", "/main.js", "/charts.js", "/tuning.js", "/watch.css", "/uPlot.iife.min.js"} <= set(FILES)
        for path in ("/stop", "/start", "/../setup.py", "/socket", "/main.py"):
            async with bench.session.get(bench.origin + path) as response:
                assert response.status in (403, 404, 405), path
        assert bench.link.asked == []

    served(check)


def test_a_foreign_page_neither_hears_nor_stops_anything():
    async def check(bench):
        for headers in ({"Origin": "http://evil.example"}, {"Host": "evil.example"}, {"Origin": "null"}):
            with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
                await bench.page(**headers)
            assert caught.value.status == 403
            sent = {"Origin": bench.origin, **headers}
            async with bench.session.post(f"{bench.origin}/stop", headers=sent) as response:
                assert response.status == 403 and "hysteresis watch: " in await response.text()
        async with bench.session.post(f"{bench.origin}/stop") as response:
            assert response.status == 403
        assert bench.link.asked == []

    served(check)


def test_connections_that_ask_for_nothing_are_closed_and_pages_are_few(monkeypatch):
    monkeypatch.setattr(server, "FIRST_REQUEST", 0.2)
    monkeypatch.setattr(server, "MOST_PAGES", 2)

    async def check(bench):
        host, port = bench.origin.removeprefix("http://").split(":")
        pages = [await bench.page(), await bench.page()]
        with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
            await bench.page()
        assert caught.value.status == 503
        reader, writer = await asyncio.open_connection(host, int(port))
        writer.write(b"GET / HTTP/1.1\r\nHost: ")  # the rest of the header never comes
        assert await asyncio.wait_for(reader.read(), 60.0) == b"", "the server closes the connection"
        writer.close()
        # opened before the connection that was closed
        assert (await pages[0].ask(do="start"))["ok"], "a connection with a request stays open"
        monkeypatch.setattr(server, "CONNECTIONS", 0)
        reader, writer = await asyncio.open_connection(host, int(port))
        assert await asyncio.wait_for(reader.read(), 60.0) == b""
        writer.close()

    served(check)


def test_stop_also_works_without_a_socket_and_waits_until_the_axis_stands():
    async def check(bench):
        async with bench.session.post(f"{bench.origin}/stop", headers={"X-Hysteresis": "1"}) as response:
            assert response.status == 200 and "safe voltage" in await response.text()
        assert bench.link.asked == ["stop", "stop"]

    served(check)


def test_the_token_comes_from_the_address_and_goes_into_a_cookie():
    async def check(bench):
        for path in ("/", "/main.js", "/?token=wrong"):
            async with bench.session.get(bench.origin + path) as response:
                assert response.status == 403
        with pytest.raises(aiohttp.WSServerHandshakeError):
            await bench.page()
        async with bench.session.get(f"{bench.origin}/?token=secret", allow_redirects=False) as response:
            assert response.status == 303 and response.headers["Location"] == "/"
            assert "HttpOnly" in response.headers["Set-Cookie"] and "SameSite=Strict" in response.headers["Set-Cookie"]
        page = await bench.page()
        assert (await page.ask(do="start"))["ok"]

    served(check, token="secret")


def test_one_page_writes_the_others_look_on_and_stop():
    async def check(bench):
        first, second = await bench.page(), await bench.page()
        refused = await second.ask(do="set", node="motion_controller", values={"pid.Kp": "1"})
        assert not refused["ok"] and "another page controls the axis (127.0.0.1" in refused["text"]
        assert bench.link.asked == []
        stopped = await second.ask(do="stop")
        assert stopped["ok"] and bench.link.asked == ["stop", "stop"]
        assert not (await second.ask(do="control"))["ok"]
        assert (await second.ask(do="control", by_force=True))["ok"]
        await first.until(lambda said: said.get("control", {}).get("mine") is False)
        assert not (await first.ask(do="start"))["ok"] and (await second.ask(do="start"))["ok"]
        await second.socket.close()
        await first.until(lambda said: said.get("pages") == 1)
        assert (await first.ask(do="control"))["ok"] and (await first.ask(do="start"))["ok"]

    served(check)


def test_a_setpoint_is_answered_and_a_refusal_is_the_nodes_own():
    async def check(bench):
        page = await bench.page()
        taken = await page.ask(do="setpoint", value="5um")
        assert taken["ok"] and bench.link.asked == [5e-6]
        refused = await page.ask(do="setpoint", value="50um")
        assert not refused["ok"] and refused["text"] == "setpoint 50 µm refused: out of range"
        again = await page.ask(do="setpoint", value="50um")
        assert not again["ok"] and again["text"] == refused["text"], "the same refusal twice"
        refused = await page.ask(do="set", node="motion_controller", values={"pid.Kp": "nan"})
        assert not refused["ok"] and refused["text"] == "/motion_controller refuses: must be finite"

    served(check)


def test_the_tables_of_an_axis_are_sent_once_and_again_after_a_change():
    async def check(bench):
        page = await bench.page()

        def heard(what: str) -> int:
            return sum(what in said for said in page.said)

        await page.until(lambda said: heard("status") >= 3)
        assert heard("axis") == 1
        assert page.said[-1]["status"]["ready"] == {"now": False, "in": None}
        bench.link.version += 1
        bench.link.ready, bench.link.ready_in = True, 0.004
        before = heard("status")
        await page.until(lambda said: heard("status") >= before + 3)
        assert heard("axis") == 2 and all(said["axis"] for said in page.said if "axis" in said)
        assert page.said[-1]["status"]["ready"] == {"now": True, "in": 0.004}

    served(check)


def test_a_stop_that_nothing_confirms_says_whether_the_axis_is_silent(monkeypatch):
    monkeypatch.setattr(server, "STOP", 0.2)

    async def check(bench):
        bench.link.stop = lambda: None
        page = await bench.page()
        said = await page.ask(do="stop")
        assert not said["ok"] and "the plant does not confirm it: switch the amplifier off" in said["text"]
        monkeypatch.setattr("hysteresis_ros.laboratory.watch.memory.SILENT", -1.0)
        said = await page.ask(do="stop")
        assert not said["ok"] and "the axis is silent: it is unknown whether it has stopped" in said["text"]
        async with bench.session.post(f"{bench.origin}/stop", headers={"Origin": bench.origin}) as response:
            assert response.status == 504 and "it is unknown whether it has stopped" in await response.text()

    served(check)


def test_a_page_that_leaves_before_its_answer_ends_nothing():
    left: Future = Future()
    assert left.cancel()
    AxisLink._do(lambda: pytest.fail("a cancelled request was executed"), left)
    stays: Future = Future()
    AxisLink._do(lambda: [] + 1, stays)  # an internal error also gives an answer
    with pytest.raises(HysteresisError, match="TypeError"):
        stays.result()


def test_garbage_is_answered_and_the_page_goes_on():
    async def check(bench):
        page = await bench.page()
        for garbage in ("{", "[]", "\x00" * 50, '{"id": 1}', "null", "9" * 5000):
            await page.socket.send_str(garbage)
            assert not (await page.until(lambda said: "answer" in said))["ok"]
        await page.socket.send_bytes(b"\xff\x00garbage")
        assert "text" in (await page.until(lambda said: "answer" in said))["text"]
        assert (await page.ask(do="start"))["ok"]
        # longer than any valid request: that page is closed, another page continues
        other = await bench.page()
        await page.socket.send_str("x" * 70_000)
        with pytest.raises(ConnectionError):
            await page.until(lambda said: False)
        assert (await other.ask(do="view", window=1.0, columns=300))["ok"]
        assert bench.link.asked == ["start"]

    served(check)


def test_a_page_that_has_asked_for_no_view_gets_five_seconds_in_at_most_600_columns():
    """5000 samples: nine in each of 556 columns."""

    async def check(bench):
        page = await bench.page()
        message = await page.socket.receive(PATIENCE)
        while message.type != aiohttp.WSMsgType.BINARY:
            message = await page.socket.receive(PATIENCE)
        (length,) = struct.unpack("<I", message.data[:4])
        header = json.loads(message.data[4 : 4 + length])
        assert (header["rate"], header["length"], header["columns"]) == (1000.0, 9, 556)

    served(check)


def test_samples_of_nodes_that_exchange_messages_are_put_together_by_their_stamps():
    nodes = ("plant_simulator", "reference_generator", "motion_controller", "hysteresis_compensator")
    collector = Collector(signals.ACTUATOR)
    # a late plant shifts its schedule: stamps come closer together, and no sample is used twice
    stamps = [0, 5_000_000, 12_000_000, 13_000_000, 18_000_000]
    for number, stamp in enumerate(stamps):
        for node in nodes:
            names = list(signals.ACTUATOR.state(node))
            message = JointState(name=names, position=[float(number)] * len(names))
            message.header.stamp.nanosec = stamp
            if (node, number) != (nodes[-1], 1):  # only the part of the silent node is missing
                collector.add(node, message)
    block = collector.take()
    assert block.stamps.tolist() == stamps and block.numbers.tolist() == [0, 1, 2, 3, 4]
    assert block.table[signals.MEASURED].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert np.isnan(block.table[signals.VOLTAGE]).tolist() == [False, True, False, False, False]
    assert collector.take().numbers.size == 0


class Asked:
    """A client of an axis whose nodes answer their services in turn; the last answer is repeated."""

    def __init__(self, **answers):
        self.answers, self.asked = answers, []

    def full_name(self, name):
        return f"/axis/{name}"

    def ask(self, kind, name):
        self.asked.append(name)
        answers = self.answers.get(name.split("/")[2], [True])
        return SimpleNamespace(success=answers.pop(0) if len(answers) > 1 else answers[0], message="not now")


def linked(nodes=NODES, **answers):
    """Return the link of a page to these nodes, without a graph."""
    link = object.__new__(AxisLink)
    link._client, link.values = Asked(**answers), {node: {"rate": 1.0} for node in nodes}
    return link


def test_an_axis_is_started_when_each_of_its_nodes_has_said_so(monkeypatch):
    monkeypatch.setattr(linking, "AGAIN", 0.0)
    link = linked(reversed(NODES))
    assert link.start() == "started"
    assert link._client.asked == [f"/axis/{node}/start" for node in NODES], "the plant first, the source last"
    # a node that notices the start of the plant with its next sample is asked again
    link = linked(motion_controller=[False, False, True])
    assert link.start() == "started" and link._client.asked.count("/axis/motion_controller/start") == 3
    monkeypatch.setattr(linking, "HEARS", 0.0)
    for place, node in enumerate(NODES):
        link = linked(**{node: [False]})
        with pytest.raises(HysteresisError, match=f"{node} refuses to start: not now"):
            link.start()
        assert len(link._client.asked) == place + 1, "those after it stay as they are"
    with pytest.raises(AbsentError, match="no node of an axis is running"):
        linked(()).start()


def test_nothing_is_recorded_of_an_axis_whose_nodes_are_missing():
    link = linked()
    link.recording = link._axis = None
    with pytest.raises(AbsentError, match="nothing to record"):
        link.record(True)
    assert link.record(False) == "no recording is running"


def test_a_change_of_a_parameter_is_known_if_it_is_of_a_node_of_this_axis():
    link = linked()
    link.namespace, link.version = "/axis", 0
    changed = [Parameter("rate", Parameter.Type.DOUBLE, 2.0).to_parameter_msg()]
    for node in ("/other/motion_controller", "/axis/recorder"):
        link._on_parameters(SimpleNamespace(node=node, changed_parameters=changed))
    assert link.version == 0 and link.values == {node: {"rate": 1.0} for node in NODES}
    link._on_parameters(SimpleNamespace(node="/axis/motion_controller", changed_parameters=changed))
    assert link.version == 1 and {node for node in NODES if link.values[node] == {"rate": 2.0}} == {"motion_controller"}


def test_only_known_parameters_of_nodes_that_are_there_are_set():
    for node, name, words in (
        ("recorder", "rate", "no node recorder"),
        ("plant_simulator", "speed", "no parameter speed"),
    ):
        with pytest.raises(HysteresisError, match=words):
            linked().change(node, {name: "1"})


@pytest.mark.parametrize("plant", [True, False])
def test_a_stop_reaches_the_plant_or_else_every_other_node(plant):
    link, published, called = linked(NODES if plant else NODES[1:]), [], []
    link._stops = SimpleNamespace(publish=lambda message: published.append(message.data))
    for name, ready in (("motion_controller", True), ("hysteresis_compensator", True), ("inchworm_sequencer", False)):
        link.__dict__.setdefault("_triggers", {})[name] = SimpleNamespace(
            service_is_ready=lambda ready=ready: ready, call_async=lambda request, name=name: called.append(name)
        )
    link.stop()
    assert published == [True] and called == ([] if plant else ["motion_controller", "hysteresis_compensator"])
