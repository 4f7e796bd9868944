# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A headless Chromium of Debian's package, controlled over its DevTools socket."""

from __future__ import annotations

import asyncio
import contextlib
import pathlib
import shutil
import subprocess
import tempfile
import time

import aiohttp
from waiting import PATIENCE

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
OPTIONS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0", "--window-size=900,700")


class Browser:
    """A page in a browser, in an ``async with`` statement; errors of the page are in :attr:`errors`.

    Parameters
    ----------
    folder : pathlib.Path
        Folder in which the browser's profile is made.
    address : str
        Address of the page.
    """

    def __init__(self, folder: pathlib.Path, address: str):
        # a profile of its own: an earlier browser's file with its port would send this one to a closed port
        self._folder, self._address = pathlib.Path(tempfile.mkdtemp(prefix="chromium-", dir=folder)), address
        self._number = 0
        self.errors: list[str] = []

    async def __aenter__(self) -> Browser:
        command = [CHROMIUM, *OPTIONS, f"--user-data-dir={self._folder}", "about:blank"]
        quiet = subprocess.DEVNULL
        self._process = subprocess.Popen(command, stdout=quiet, stderr=quiet, start_new_session=True)
        self._stack = contextlib.AsyncExitStack()
        port = await found(self._port, "a browser")
        session = await self._stack.enter_async_context(aiohttp.ClientSession())
        async with session.get(f"http://127.0.0.1:{port}/json") as response:
            page = next(one for one in await response.json() if one["type"] == "page")
        connection = session.ws_connect(page["webSocketDebuggerUrl"], max_msg_size=0)
        self._socket = await self._stack.enter_async_context(connection)
        for domain in ("Runtime", "Log", "Page"):
            await self.call(f"{domain}.enable")
        await self.call("Page.navigate", url=self._address)
        return self

    async def __aexit__(self, *exception) -> None:
        await self._stack.aclose()
        self._process.terminate()
        self._process.wait(PATIENCE)

    async def _port(self) -> str:
        path = self._folder / "DevToolsActivePort"
        return path.read_text().split("\n")[0] if path.is_file() and "\n" in path.read_text() else ""

    async def call(self, method: str, **parameters) -> dict:
        """Call a method of the protocol and return its result."""
        self._number += 1
        number = self._number
        await self._socket.send_json({"id": number, "method": method, "params": parameters})
        while True:
            said = await self._socket.receive_json(timeout=PATIENCE)
            if said.get("id") == number:
                return said["result"]
            if said.get("method") == "Runtime.exceptionThrown":
                self.errors.append(str(said["params"]["exceptionDetails"]))
            elif said.get("method") == "Log.entryAdded" and said["params"]["entry"]["level"] == "error":
                self.errors.append(said["params"]["entry"]["text"])

    async def value(self, expression: str):
        """Return the value of an expression in the page."""
        answer = await self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        if "exceptionDetails" in answer:
            raise AssertionError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    async def until(self, expression: str):
        """Wait until an expression in the page is true, and return its value."""
        return await found(lambda: self.value(expression), expression)

    async def press(self, key: str, times: int = 1) -> None:
        """Press a key as a person does."""
        for _ in range(times):
            for kind in ("keyDown", "keyUp"):
                await self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=KEYS[key])


KEYS = {"End": 35, "ArrowLeft": 37, "PageUp": 33, "PageDown": 34, "Escape": 27}


async def found(condition, what: str, every: float = 0.1):
    """Wait until a condition returns something true, and return its value."""
    deadline = time.monotonic() + PATIENCE
    while True:
        value = await condition()
        if value:
            return value
        assert time.monotonic() < deadline, f"not within {PATIENCE:g} s: {what}"
        await asyncio.sleep(every)
