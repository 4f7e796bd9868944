# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A page's server with an emulated axis."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
from concurrent.futures import Future
from types import SimpleNamespace

import aiohttp
import numpy as np
import pytest

from hysteresis_ros import signals
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.laboratory.watch.access import Access
from hysteresis_ros.laboratory.watch.memory import Memory
from hysteresis_ros.laboratory.watch.server import Server
from hysteresis_ros.nodes.samples import Block

TestServer = pytest.importorskip("aiohttp.test_utils").TestServer

PATIENCE = 20.0


class Pretended:
    """The interface of an axis to a server; requests are stored, and it stops only at the second request."""

    def __init__(self, about: dict | None = None):
        self.about = about
        self.memory, self.values, self.health, self.refusals = Memory(), {}, {}, []
        self.memory.restart(1000.0, motor=about is not None)
        self.version, self.recording, self.source, self.namespace = 1, None, "/reference_generator", ""
        self.ready, self.ready_in = False, math.nan
        self.asked: list = []
        self.elsewhere: list[str] = []
        self.sample = 0
        self.put()

    def put(self, **values: float) -> None:
        """Add a sample with these signals."""
        table = np.zeros((len((signals.INCHWORM if self.memory.motor else signals.ACTUATOR).row), 1))
        for name, value in values.items():
            table[signals.place(name)] = value
        numbers = np.array([self.sample])
        assert self.memory.add(Block(numbers * 1_000_000, numbers, table, None))
        self.sample += 1

    def tables(self) -> dict:
        return {"nodes": {}, "limits": {}, "namespace": "/", "mode": "fused", "rate": 1000.0, "motor": self.about}

    def state(self) -> dict:
        return {}

    def ask(self, job) -> Future:
        answer: Future = Future()
        try:
            answer.set_result(job())
        except HysteresisError as error:
            answer.set_exception(error)
        return answer

    def change(self, node: str, values: dict) -> str:
        self.asked.append((node, values))
        if "nan" in values.values():
            raise HysteresisError("/motion_controller refuses: must be finite")
        return "set"

    def start(self) -> str:
        self.asked.append("start")
        return "started"

    def move(self, metres: float) -> None:
        self.asked.append(metres)
        if metres > 1e-5:
            self.refusals = [*self.refusals, f"setpoint {1e6 * metres:g} µm refused: out of range"]
        else:
            self.put(setpoint=metres)

    def walk(self, speed: float) -> None:
        self.asked.append(speed)
        self.put(speed=speed)

    def call(self, service: str) -> str:
        self.asked.append(service)
        return f"does {service}"

    def mark(self, text: str) -> None:
        self.asked.append(text)

    def stop(self) -> None:
        self.asked.append("stop")
        if self.asked.count("stop") > 1:
            self.put(tripped=1.0)


class Socket:
    """A page without pictures."""

    def __init__(self, socket):
        self.socket, self.number, self.said = socket, 0, []

    async def until(self, wanted):
        """Receive messages until one is wanted, and return it."""
        while True:
            message = await self.socket.receive(PATIENCE)
            if message.type == aiohttp.WSMsgType.TEXT:
                self.said.append(json.loads(message.data))
                if wanted(self.said[-1]):
                    return self.said[-1]
            elif message.type != aiohttp.WSMsgType.BINARY:
                raise ConnectionError(message.type)

    async def ask(self, **words) -> dict:
        self.number += 1
        await self.socket.send_str(json.dumps({"id": self.number, **words}))
        return await self.until(lambda said: said.get("answer") == self.number)


class Bench(SimpleNamespace):
    """A server and its callers."""

    async def page(self, **headers) -> Socket:
        headers = {"Origin": self.origin, **headers}
        return Socket(
            await self.stack.enter_async_context(self.session.ws_connect(f"{self.origin}/socket", headers=headers))
        )


def served(check, token: str = "", about: dict | None = None) -> None:
    """Run a check with a server; ``about`` describes an inchworm motor."""

    async def run() -> None:
        link = Pretended(about)
        server = Server(link, Access("0.0.0.0" if token else "127.0.0.1", token))
        async with contextlib.AsyncExitStack() as stack:
            port = await stack.enter_async_context(server.listening("127.0.0.1", 0, 1.0))
            jar = aiohttp.CookieJar(unsafe=True)
            session = await stack.enter_async_context(aiohttp.ClientSession(cookie_jar=jar))
            origin = f"http://127.0.0.1:{port}"
            await check(Bench(link=link, server=server, session=session, origin=origin, stack=stack))

    asyncio.run(asyncio.wait_for(run(), 3 * PATIENCE))
