# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The page of an inchworm motor: its data of the slider, the extender and the gait, and its allowed requests."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")
pytest.importorskip("aiohttp", reason="aiohttp is not installed: no page")

from browser_support import CHROMIUM, Browser  # noqa: E402
from pretended_axis import Pretended, served  # noqa: E402

from hysteresis_ros.configuration import load_configuration  # noqa: E402
from hysteresis_ros.laboratory.watch.access import RequestError, read_request  # noqa: E402
from hysteresis_ros.laboratory.watch.memory import motor_facts, motor_values  # noqa: E402
from hysteresis_ros.loop.parameters import AxisParameters  # noqa: E402
from hysteresis_ros.references.inchworm_layout import CARRYING, PHASE_NAMES, POSITIONING  # noqa: E402


@pytest.fixture(scope="module")
def motor() -> dict:
    """Constants of the motor of the shipped configuration, as sent to a page."""
    found = motor_facts(AxisParameters.from_configuration(load_configuration("inchworm_travel")))
    assert found is not None
    return found


def test_the_error_of_a_motor_is_that_of_what_its_controller_follows(motor):
    link = Pretended(motor)
    link.put(setpoint=5e-3, measured=1.002e-3, origin=1e-3, reference=1.9e-6, extender=3e-6, voltage=40.0, command=2e-6)
    frame = link.memory.frame(link.memory.view(1.0, 1000))
    (length,) = struct.unpack("<I", frame[:4])
    header, numbers = json.loads(frame[4 : 4 + length]), np.frombuffer(frame[4 + length :], "<f4")
    last = dict(
        zip(
            header["shown"],
            numbers[: 2 * header["bins"] * len(header["shown"])].reshape(-1, 2 * header["bins"])[:, -1],
            strict=True,
        )
    )
    assert last["error"] == pytest.approx(0.1e-6) and last["setpoint"] == pytest.approx(5e-3)
    assert last["measured"] == pytest.approx(1.002e-3) and last["extender"] == pytest.approx(3e-6)
    loop = numbers[-3 * header["points"] :].reshape(3, -1)[:, -1]
    assert loop == pytest.approx([40.0, 2e-6, 3e-6])  # of the extender; the slider is millimetres away
    assert link.memory.figures()["largest"] == pytest.approx(0.1e-6)


def test_an_actuator_has_no_figures_of_a_gait():
    assert (
        motor_values(Pretended().memory) is None
        and motor_facts(AxisParameters.from_configuration(load_configuration("kim2009"))) is None
    )


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ('"speed", "value": "5um"', "must be a speed, e.g. 50um/s"),
        ('"speed", "value": "inf"', "finite number"),
        ('"call", "service": "save"', "must be one of home, release"),
        ('"call", "service": ["home"]', "must be one of home, release"),
    ],
)
def test_what_a_motor_cannot_be_asked_for_is_named(asked, words):
    with pytest.raises(RequestError) as caught:
        read_request(f'{{"id": 1, "do": {asked}}}')
    assert words in str(caught.value)


def test_a_motor_takes_speeds_and_calls_and_an_actuator_does_not(motor):
    async def ask(bench):
        page = await bench.page()
        speed, home = await page.ask(do="speed", value="-50um/s"), await page.ask(do="call", service="home")
        return [speed["ok"], home["ok"]], [speed["text"], home["text"]]

    async def of_a_motor(bench):
        assert await ask(bench) == ([True, True], ["walks at -50 µm/s", "does home"])
        assert bench.link.asked == [-50e-6, "home"]

    async def of_an_actuator(bench):
        done, why = await ask(bench)
        assert done == [False, False] and all("not an inchworm motor" in text for text in why) and not bench.link.asked

    served(of_a_motor, about=motor)
    served(of_an_actuator)


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium is installed (Debian: apt install chromium): no pixels")
def test_a_motor_has_its_charts_and_its_card_on_the_page(motor, tmp_path):
    async def check(bench):
        async with Browser(tmp_path, f"{bench.origin}/") as browser:
            await browser.until("Boolean(window.hysteresis?.charts.phase)")
            hidden = "[...document.querySelectorAll('.of-motor')].filter((one) => !one.checkVisibility()).length"
            assert await browser.value(hidden) == 0
            card = "document.getElementById('motor').textContent"
            for number, phase in enumerate((CARRYING, POSITIONING)):
                values = {"setpoint": 5e-3, "measured": 4e-3, "front_voltage": 100.0, "phase": phase, "steps": number}
                for _ in range(50):  # a column of the screen represents several samples
                    bench.link.put(**values)
                name = PHASE_NAMES[phase]
                await browser.until(f"{card}.includes('{name}')")
                await browser.until(f"document.getElementById('legend-phase').textContent === '{name}'")
            legend = await browser.value("document.getElementById('legend-drive').textContent")
            assert "front clamp" in legend and "100.0 V" in legend and "rear clamp" in legend
            # a motor that does not learn over the phase has no buttons for learning
            buttons = "[...document.querySelectorAll('#services button')]"
            shown = f"{buttons}.filter((one) => one.checkVisibility()).map((one) => one.id)"
            assert await browser.value(shown) == ["home", "release"]
            await browser.until("hysteresis.state.mine")
            await browser.value("document.getElementById('release').click()")
            await browser.until("document.getElementById('motor-said').textContent === 'does release'")
            assert browser.errors == [] and bench.link.asked == ["release"]

    served(check, about=motor)
