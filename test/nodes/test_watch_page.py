# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The page of a running axis: over its socket, and in a browser."""

from __future__ import annotations

import asyncio
import json
import re
import signal
import sys

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")
aiohttp = pytest.importorskip("aiohttp", reason="aiohttp is not installed: no page")

from browser_support import CHROMIUM, Browser, found  # noqa: E402
from nodes_support import Processes, axis_parameters, write_axis  # noqa: E402
from waiting import PATIENCE, until  # noqa: E402

from hysteresis_ros.models.block import COMPILED  # noqa: E402
from hysteresis_ros.recordings.bag_reader import read_bag  # noqa: E402
from hysteresis_ros.recordings.files import load_run  # noqa: E402

pytestmark = pytest.mark.skipif(not COMPILED, reason="without Numba the fused loop is too slow for this axis")

BEGIN = {"reference_generator": {"initial_setpoint": 5.0e-6}}
GAIN = "hysteresis.polynomial.scale"
SLIDER = f"document.querySelector('[aria-label=\"hysteresis_compensator {GAIN} slider\"]')"

FIELD = f"{SLIDER}.closest('.parameter').querySelector('input').value"
PLACE = "[hysteresis.loops.command.at(-1), hysteresis.loops.measured.at(-1), hysteresis.traces.end]"


class Watched:
    """A page without an axis at first, and axes for it."""

    def __init__(self, processes: Processes):
        self.processes, self.folder = processes, processes.folder
        # late voltages of a busy machine must not stop the axis here
        axis = axis_parameters(overrides={"plant_simulator": {"late_limit": -1}, **BEGIN}, time_mode="fused")
        self._path = write_axis(self.folder / "axis.yaml", axis)
        options = ("--port", "0", "--folder", str(self.folder))
        self.server = processes.start([sys.executable, "-m", "hysteresis_ros.cli.main", "watch", *options], "watch")
        self.address = until(lambda: re.search(r"http://\S+(?=/)", self.server.output), what="a page")[0]
        self.begin()

    def begin(self) -> None:
        self.axis = self.processes.node("hysteresis_axis", self._path)


@pytest.fixture(scope="module")
def watched(folder, domain_of_module):
    processes = Processes(folder, domain_of_module)
    yield Watched(processes)
    for process in processes.started:  # printed if a test fails
        print(process.log, process.popen.poll(), process.output, sep="\n")
    processes.close()


class Page:
    """A page without pictures."""

    def __init__(self, socket):
        self._socket, self._number, self.status = socket, 0, {}
        self.values: dict = {}

    async def hear(self) -> dict:
        while True:
            message = await self._socket.receive(PATIENCE)
            if message.type == aiohttp.WSMsgType.TEXT:
                said = json.loads(message.data)
                self.status = said.get("status", self.status)
                for node, rows in said.get("axis", {}).get("nodes", {}).items():
                    self.values[node] = {row["name"]: row["value"] for row in rows}
                return said
            assert message.type == aiohttp.WSMsgType.BINARY, message

    async def until(self, condition) -> None:
        try:
            async with asyncio.timeout(PATIENCE):
                while not condition():
                    await self.hear()
        except TimeoutError:
            raise AssertionError(
                f"not within {PATIENCE:g} s; status {self.status}, values of {list(self.values)}"
            ) from None

    async def ask(self, **words) -> tuple[bool, str]:
        self._number += 1
        await self._socket.send_str(json.dumps({"id": self._number, **words}))
        while True:
            said = await self.hear()
            if said.get("answer") == self._number:
                return said["ok"], said["text"]


def test_a_page_steers_and_records_an_axis_that_may_leave_and_return(watched):
    async def look(page: Page) -> None:
        await page.until(lambda: page.status.get("live") and GAIN in page.values.get("hysteresis_compensator", {}))
        await page.until(lambda: page.status["health"])
        assert not page.status["tripped"]
        # requests to the axis, and messages of the nodes
        assert (await page.ask(do="setpoint", value="4um"))[0]
        ok, why = await page.ask(do="setpoint", value="400um")
        assert not ok and "setpoint 400 µm refused: out of range, allowed: 0 … 12 µm" in why
        assert (await page.ask(do="set", node="motion_controller", values={"sliding_mode.phi": "0.9"}))[0]
        await page.until(lambda: page.values["motion_controller"]["sliding_mode.phi"] == 0.9)
        ok, why = await page.ask(do="set", node="motion_controller", values={"sliding_mode.phi": "3"})
        assert not ok and "sliding_mode.phi = 3: out of range, allowed: double in -1 … 1" in why
        ok, why = await page.ask(do="set", node="plant_simulator", values={"sample_rate": "2000.0"})
        assert not ok and "sample_rate" in why and "read" in why
        ok, why = await page.ask(do="set", node="motion_controller", values={"sliding_mode.phy": "1"})
        assert not ok and "no parameter sliding_mode.phy" in why
        # a recording, with a mark in it
        ok, where = await page.ask(do="record", on=True)
        assert ok
        assert (await page.ask(do="marker", text="here"))[0]
        await page.until(lambda: (page.status["recording"] or {}).get("samples", 0) > 600)
        assert (await page.ask(do="record", on=False))[0]
        bag = where.removeprefix("recording into ")
        run = load_run(bag)
        assert len(run) > 600 and run["setpoint"][-1] == 4e-6 and len(set(run.time.round(6))) == len(run)
        assert read_bag(bag).of_type("/marker", "std_msgs/msg/String") is not None
        # stop and restart
        assert (await page.ask(do="stop"))[0]
        await page.until(lambda: page.status["tripped"])
        assert (await page.ask(do="start"))[0]
        await page.until(lambda: not page.status["tripped"])
        # the axis exits, and another one starts
        watched.axis.leave(signal.SIGINT)
        await page.until(lambda: not page.status["live"])
        ok, why = await page.ask(do="setpoint", value="4um")
        assert not ok and "silent" in why
        watched.begin()
        await page.until(lambda: page.status["live"] and page.values["motion_controller"]["sliding_mode.phi"] != 0.9)
        assert (await page.ask(do="setpoint", value="5um"))[0]

    async def run() -> None:
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(f"{watched.address}/socket", headers={"Origin": watched.address}) as socket,
        ):
            await look(Page(socket))

    asyncio.run(asyncio.wait_for(run(), 3 * PATIENCE))


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium is installed (Debian: apt install chromium): no pixels")
def test_a_slider_moves_and_the_parameter_the_loop_and_the_pixels_change(watched):
    picture = "document.querySelector('#after canvas').toDataURL()"

    async def moved(browser: Browser, key: str) -> list[float]:
        """Move the axis with the keys of the setpoint's slider; return command and displacement before."""
        begun = await browser.value(PLACE)
        await browser.value("document.getElementById('setpoint-slider').focus()")
        await browser.press(key, 2)
        last = begun

        async def rests() -> bool:
            nonlocal last
            now = await browser.value(PLACE)
            if now[2] < last[2] + 900:  # a third of a second of axis time
                return False
            before, last = last, now
            return abs(now[1] - begun[1]) > 1e-6 and abs(now[1] - before[1]) < 1e-8

        await found(rests, "an axis that has moved and rests")
        return begun

    async def slope(browser: Browser, begun: list[float]) -> float:
        """Return the ratio of displacement to command."""
        command, displacement, _ = await browser.value(PLACE)
        return (command - begun[0]) / (displacement - begun[1])

    async def run() -> None:
        async with Browser(watched.folder, f"{watched.address}/") as browser:
            await browser.until("Boolean(window.hysteresis)")
            await browser.until(f"hysteresis.state.live && {SLIDER} !== null")
            await browser.until("hysteresis.state.mine && document.getElementById('setpoint').value !== ''")
            # the keys of a slider: the setpoint moves, and the axis with it
            given = float(await browser.value(FIELD))
            begun = await moved(browser, "PageDown")
            before = await slope(browser, begun)
            # a paused page does not change when data arrive
            await browser.value("document.getElementById('pause').click()")
            # data on the way are still drawn
            await browser.until(f"{picture} === window.before || ((window.before = {picture}), false)")
            still, end = await browser.value(f"[{picture}, hysteresis.state.heard]")
            await browser.until(f"hysteresis.state.heard > {end} + 300")
            assert await browser.value(picture) == still
            await browser.value("document.getElementById('pause').click()")
            await browser.value("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
            await browser.value(f"{SLIDER}.focus()")
            await browser.press("ArrowLeft", 40)
            # answers to the first keys may arrive after the last one: what counts is where the field comes to rest
            await browser.until(f"Number({FIELD}) < {0.9 * given}")
            await browser.until(f"{SLIDER}.closest('.parameter').matches('.changed')")
            # the model has changed without a jump; from now on less command is needed
            begun = await moved(browser, "PageUp")
            assert await slope(browser, begun) < 0.9 * before
            assert await browser.value(picture) != still
            assert await browser.value("document.querySelectorAll('.parameter.refused').length") == 0
            got = watched.processes.command("get", "hysteresis_compensator", GAIN)
            assert got.wait() == 0
            await browser.until(f"Number({FIELD}) === {float(got.output.split(':')[1])}")
            # the key that stops everything, and the button that restarts it
            await browser.value("document.activeElement.blur()")
            await browser.press("Escape")
            await browser.until("document.getElementById('headline').textContent.startsWith('stopped')")
            await browser.value("document.getElementById('start').click()")
            await browser.until("!document.getElementById('headline').textContent.startsWith('stopped')")
            # the page has reported no errors
            assert browser.errors == []

    asyncio.run(asyncio.wait_for(run(), 3 * PATIENCE))


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium is installed (Debian: apt install chromium): no pixels")
def test_a_slider_ends_at_the_limits_and_goes_back_after_a_refusal(watched):
    slider, field = (f"document.getElementById('{name}')" for name in ("setpoint-slider", "setpoint"))
    said = "document.getElementById('setpoint-said')"

    async def run() -> None:
        async with Browser(watched.folder, f"{watched.address}/") as browser:
            await browser.until("Boolean(window.hysteresis) && hysteresis.state.live && hysteresis.state.mine")
            await browser.until(f"{field}.value !== '' && hysteresis.state.limits.slider !== undefined")
            assert await browser.value(f"[Number({slider}.min), Number({slider}.max)]") == pytest.approx([0.0, 12.0])
            # a limit with more than four digits: the end of the slider is sent exactly, not rounded beyond the limit
            await browser.value(
                f"hysteresis.state.limits.slider = [0, 11.99967e-6], {slider}.step = 'any',"
                f"{slider}.max = 11.99967, {slider}.focus(), 0"
            )
            await browser.press("End")
            await browser.until(f"{said}.textContent.includes('11.9997')")
            assert not await browser.value(f"{said}.classList.contains('bad')")
            # a refused value is replaced, even if slider or field have the focus
            for element in (slider, field):
                await browser.value(f"{element}.focus(), {field}.value = '400', 0")
                await browser.value(f"{slider}.value = 3, {field}.dispatchEvent(new Event('change')), 0")
                await browser.until(f"{said}.classList.contains('bad') && {said}.textContent.includes('0.0004')")
                await browser.until(f"Number({field}.value) === 11.9997 && Math.abs({slider}.value - 11.99967) < 1e-3")
                await browser.value(f"{said}.classList.remove('bad'), {said}.textContent = ''")
            # the same for a parameter
            field_ = FIELD.removesuffix(".value")
            given = await browser.value(FIELD)
            await browser.value(
                f"{field_}.focus(), {field_}.value = '-1', {field_}.dispatchEvent(new Event('change')), 0"
            )
            await browser.until(f"{SLIDER}.closest('.parameter').matches('.refused')")
            await browser.until(f"{FIELD} === '{given}'")
            assert browser.errors == []

    asyncio.run(asyncio.wait_for(run(), 3 * PATIENCE))
