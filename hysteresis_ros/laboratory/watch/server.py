# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The web server of the page: files, one web socket per open page, and a stop request that needs no socket.

The argument of its process is the JSON object of :mod:`hysteresis_ros.laboratory.watch.server_process`.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import math
import pathlib
import signal
import sys
import threading
import time
from collections.abc import Awaitable, Callable

import rclpy
from aiohttp import WSMsgType, web
from rclpy.signals import SignalHandlerOptions

from hysteresis_ros import signals
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.laboratory.watch.access import (
    COOKIE,
    FREE,
    Access,
    Control,
    Request,
    RequestError,
    new_token,
    read_request,
)
from hysteresis_ros.laboratory.watch.link import AxisLink
from hysteresis_ros.laboratory.watch.memory import motor_values
from hysteresis_ros.laboratory.watch.views import View
from hysteresis_ros.nodes.domain import stay_on_this_machine
from hysteresis_ros.nodes.remote.commands import stands
from hysteresis_ros.nodes.security.policy import PAGE, enclave_of
from hysteresis_ros.units import micrometres

#: Largest number of frames per second.
FRAMES = 25.0
#: Interval of the status [s].
STATUS = 0.25
#: Interval of the spectrum [s].
SPECTRUM = 0.5
#: Interval of the plane [s].
PLANE = 0.25
#: Maximum size of a request [bytes].
LONGEST = 64 * 1024
#: Maximum number of queued requests of a page.
WAITING = 32
#: Time-out of a setpoint [s].
SETPOINT = 2.0
#: Time-out of a stop [s].
STOP = 2.0
#: Interval at which a stop is repeated until it is confirmed [s].
AGAIN = 0.1
#: Time without a message after which a page counts as closed [s].
HEARTBEAT = 10.0
#: Time-out for closing the open pages at the end [s].
PATIENCE = 1.0
#: Interval at which other events than a signal are checked [s].
LOOK = 0.2
#: Maximum number of open pages.
MOST_PAGES = 16
#: Maximum number of connections.
CONNECTIONS = 128
#: Time in which a new connection must send a request [s].
FIRST_REQUEST = 10.0
#: Headers for the browser: nothing from other origins, no embedding in other pages, no caching.
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
_PAGE = pathlib.Path(__file__).with_name("page")
_ASSETS = pathlib.Path(__file__).resolve().parents[2] / "analysis" / "assets"
#: Paths of GET requests, except the socket, and their files.
FILES = {
    "/": _PAGE / "index.html",
    **{f"/{path.name}": path for path in sorted(_PAGE.iterdir()) if path.suffix in (".js", ".css", ".svg")},
    **{f"/{name}": _ASSETS / name for name in ("uPlot.iife.min.js", "uPlot.min.css")},
}


class Page:
    """One open page."""

    def __init__(self, number: int, socket: web.WebSocketResponse, place: str):
        self.number, self.socket, self.place = number, socket, place
        self.view: View | None = None
        self.window, self.columns = 5.0, 600
        self.told = -1
        self.waiting: asyncio.Queue[Request] = asyncio.Queue(WAITING)

    async def say(self, **words) -> None:
        """Send JSON, unless the page has closed."""
        with contextlib.suppress(ConnectionError):
            await self.socket.send_str(json.dumps(words, allow_nan=False))


class Server:
    """Serves the pages of one axis."""

    def __init__(self, link: AxisLink, access: Access):
        self.link, self.access = link, access
        self.control = Control()
        self.pages: dict[int, Page] = {}
        self._numbers = itertools.count(1)
        self._marks = itertools.count(1)
        self._refused = ""
        self._last_status: dict = {}
        #: Connections that have not yet sent a request.
        self._silent: set = set()

    def application(self) -> web.Application:
        """Return the application of the web server."""
        application = web.Application(middlewares=[self._guard], client_max_size=LONGEST)
        for path in FILES:
            application.router.add_get(path, self._file)
        application.router.add_get("/socket", self._socket)
        application.router.add_post("/stop", self._stop_by_post)
        application.cleanup_ctx.append(self._background)
        return application

    @web.middleware
    async def _guard(self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]):
        """Check host and token of a request; a request that changes something must come from this server's own page."""
        self._silent.discard(request.protocol)
        given = request.query.get("token") or request.cookies.get(COOKIE, "")
        refused = self.access.refuses_host(request.headers.get("Host", "")) or self.access.refuses_token(given)
        if not refused and (request.method != "GET" or request.path == "/socket"):
            refused = self.access.refuses_origin(request.headers)
        if refused:
            return web.Response(status=403, text=f"hysteresis watch: {refused}\n", headers=HEADERS)
        if request.path == "/" and request.query.get("token"):
            # redirect, so that the token does not appear in a browser history or a screenshot
            response: web.StreamResponse = web.Response(status=303, headers={"Location": "/", **HEADERS})
            response.set_cookie(COOKIE, given, httponly=True, samesite="Strict")
            return response
        try:
            return await handler(request)
        except web.HTTPException as error:
            return web.Response(status=error.status, text=f"hysteresis watch: {error.reason}\n", headers=HEADERS)

    async def _file(self, request: web.Request) -> web.StreamResponse:
        return web.FileResponse(FILES[request.path], headers=HEADERS)

    async def _stop_by_post(self, request: web.Request) -> web.Response:
        try:
            return web.Response(text=f"{await self.stop()}\n", headers=HEADERS)
        except HysteresisError as error:
            return web.Response(status=504, text=f"hysteresis watch: {error}\n", headers=HEADERS)

    @contextlib.asynccontextmanager
    async def listening(self, bind: str, port: int, patience: float):
        """Listen on an address while the context lasts, and yield the port.

        Connections without a request within :data:`FIRST_REQUEST` seconds, and those beyond :data:`CONNECTIONS`, are
        closed, because aiohttp has no time-out for the head of a request.
        """
        runner = web.AppRunner(self.application(), access_log=None, shutdown_timeout=patience)
        await runner.setup()
        loop, connections = asyncio.get_running_loop(), runner.server
        assert connections is not None  # after setup

        def close_silent(made) -> None:
            if made in self._silent:
                self._silent.discard(made)
                made.force_close()

        def connection() -> asyncio.BaseProtocol:
            made = connections()
            self._silent.add(made)
            loop.call_later(FIRST_REQUEST if len(connections.connections) < CONNECTIONS else 0.0, close_silent, made)
            return made

        try:
            listener = await loop.create_server(connection, bind, port)
            try:
                yield listener.sockets[0].getsockname()[1]
            finally:
                listener.close()
        finally:
            with contextlib.suppress(asyncio.CancelledError):
                await runner.cleanup()

    # -- pages -----------------------------------------------------------------------------------------------------

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        if len(self.pages) >= MOST_PAGES:
            text = f"hysteresis watch: {MOST_PAGES} pages are open already; close one of them\n"
            return web.Response(status=503, text=text, headers=HEADERS)
        socket = web.WebSocketResponse(heartbeat=HEARTBEAT, max_msg_size=LONGEST)
        await socket.prepare(request)
        page = Page(next(self._numbers), socket, request.remote or "?")
        self.pages[page.number] = page
        self.control.ask(page.number, page.place)
        drawing = asyncio.create_task(self._draw(page))
        working = asyncio.create_task(self._work(page))
        try:
            await self._tell_control()
            async for message in socket:
                await self._heard(page, message)
        finally:
            for task in (drawing, working):
                task.cancel()
            del self.pages[page.number]
            self.control.leave(page.number)
            await self._tell_control()
        return socket

    async def _heard(self, page: Page, message) -> None:
        """Queue a request; a stop is executed immediately."""
        try:
            if message.type != WSMsgType.TEXT:
                raise RequestError("a request must be text, in JSON")
            request = read_request(message.data)
            refused = "" if request.action in FREE else self.control.refuses(page.number)
            if refused:
                await page.say(answer=request.number, ok=False, text=refused)
            elif request.action == "stop":
                asyncio.create_task(self._answer(page, request))
            else:
                page.waiting.put_nowait(request)
        except asyncio.QueueFull:
            await page.say(answer=request.number, ok=False, text=f"{WAITING} requests are queued: wait for the answers")
        except RequestError as error:
            await page.say(answer=error.number, ok=False, text=str(error))

    async def _work(self, page: Page) -> None:
        """Process the requests of a page one after the other."""
        while True:
            await self._answer(page, await page.waiting.get())

    async def _answer(self, page: Page, request: Request) -> None:
        try:
            text = await getattr(self, f"_on_{request.action}")(page, **request.values)
            await page.say(answer=request.number, ok=True, text=text)
        except HysteresisError as error:
            await page.say(answer=request.number, ok=False, text=" ".join(str(error).split()))

    async def _draw(self, page: Page) -> None:
        """Send frames to a page; a slow page gets fewer frames, each with all samples since the previous frame."""
        memory = self.link.memory
        while True:
            begun = time.monotonic()
            view = page.view
            if view is None or view.epoch != memory.epoch:
                page.view = view = memory.view(page.window, page.columns)
            frame = memory.frame(view)
            with contextlib.suppress(ConnectionError):
                if frame is not None:
                    await page.socket.send_bytes(frame)
            await asyncio.sleep(max(1.0 / FRAMES - (time.monotonic() - begun), 0.001))

    async def _background(self, application: web.Application):
        given = (STATUS, self._tell), (SPECTRUM, self._spectrum), (PLANE, self._plane)
        tasks = [asyncio.create_task(self._every(seconds, do)) for seconds, do in given]
        yield
        for task in tasks:
            task.cancel()
        for page in list(self.pages.values()):
            await page.socket.close()

    async def _every(self, seconds: float, do: Callable[[], Awaitable[None]]) -> None:
        while True:
            await do()
            await asyncio.sleep(seconds)

    async def _everybody(self, **words) -> None:
        await asyncio.gather(*(page.say(**words) for page in list(self.pages.values())))

    async def _spectrum(self) -> None:
        if self.pages and self.link.memory.is_live:
            await self._everybody(spectrum=self.link.memory.spectrum())

    async def _plane(self) -> None:
        """Send the plane of two axes of a stage, or None if the axis is not live or not part of a stage."""
        if self.pages:
            live = self.link.memory.is_live and self.link.plane.axes
            await self._everybody(plane=self.link.plane.told() if live else None)

    async def _tell_control(self) -> None:
        for page in list(self.pages.values()):
            await page.say(control=self.control.told(page.number), pages=len(self.pages))

    async def _tell(self) -> None:
        """Send the status of the axis to all pages, and its parameters after a change."""
        if not self.pages:
            return
        link, version = self.link, self.link.version
        tables = None
        for page in list(self.pages.values()):
            if page.told != version:
                tables = tables or link.tables()
                page.told = version
                await page.say(axis=tables)
        await self._everybody(status=self.status())
        refused, self._refused = self._refused, (link.refusals[-1:] or [""])[0]
        if self._refused != refused:
            await self._everybody(refused=self._refused)

    def status(self) -> dict:
        """Return the status of the axis."""
        link, memory = self.link, self.link.memory
        recording, now = link.recording, time.monotonic()
        health = [
            {"node": node, **{key: value for key, value in said.items() if key != "at"}, "age": now - said["at"]}
            for node, said in sorted(link.health.items())
        ]
        state = link.state()
        return {
            "live": memory.is_live,
            "elsewhere": link.elsewhere,
            "rate": memory.rate_seen(),
            "lost": memory.lost,
            "skipped": memory.skipped,
            "tripped": self._tripped(),
            "ready": {"now": link.ready, "in": link.ready_in if math.isfinite(link.ready_in) else None},
            "stands": stands(link.source, state) if memory.is_live else "",
            "figures": memory.figures(),
            "motor": motor_values(memory),
            "health": health,
            "recording": None
            if recording is None
            else {"path": str(recording.path), "samples": recording.samples, "stopped": recording.stopped},
        }

    def _tripped(self) -> bool:
        value = self.link.memory.value(signals.TRIPPED)
        return bool(value) and not math.isnan(value)

    # -- requests of pages -------------------------------------------------------------------------------------------

    async def _on_view(self, page: Page, window: float, columns: int) -> str:
        page.window, page.columns, page.view = window, columns, None
        return ""

    async def _on_control(self, page: Page, by_force: bool) -> str:
        had = self.control.ask(page.number, page.place, by_force)
        if not had:
            raise HysteresisError(self.control.refuses(page.number))
        await self._tell_control()
        return "this page controls the axis"

    async def _on_setpoint(self, page: Page, metres: float) -> str:
        await self._given("setpoint", metres, micrometres(metres), self.link.move)
        return f"setpoint {micrometres(metres)} accepted"

    async def _on_speed(self, page: Page, speed: float) -> str:
        self._require_motor("has a speed")
        await self._given("speed", speed, f"{speed:g} m/s", self.link.walk)
        return f"walks at {1e6 * speed:g} µm/s" if speed else "holds its position until the next setpoint"

    async def _given(self, name: str, value: float, shown: str, give: Callable[[float], None]) -> None:
        """Send a value, written ``shown`` in refusals, to the reference source; wait for a sample that contains it."""
        link = self.link
        if not link.memory.is_live:
            raise HysteresisError(f"the axis is silent: no node would receive the {name}")
        before = len(link.refusals), link.refusals[-1:]
        give(value)
        deadline = time.monotonic() + SETPOINT
        while time.monotonic() < deadline:
            new = link.refusals if (len(link.refusals), link.refusals[-1:]) != before else []
            refused = next((text for text in reversed(new) if text.startswith(f"{name} {shown} refused")), "")
            if refused:
                raise HysteresisError(refused)
            if math.isclose(link.memory.value(signals.place(name)), value, rel_tol=1e-12, abs_tol=1e-15):
                why = stands(link.source, link.state())
                if why:
                    raise HysteresisError(f"{link.source} has the {name} but {why}")
                return
            await asyncio.sleep(0.01)
        raise HysteresisError(f"{link.source} has published no sample with the {name} within {SETPOINT:g} s")

    async def _on_call(self, page: Page, service: str) -> str:
        self._require_motor(f"has a service {service}")
        return await asyncio.wrap_future(self.link.ask(lambda: self.link.call(service)))

    def _require_motor(self, what: str) -> None:
        if not self.link.memory.motor:
            raise HysteresisError(f"this axis is not an inchworm motor: only a motor {what}")

    async def _on_set(self, page: Page, node: str, values: dict) -> str:
        return await asyncio.wrap_future(self.link.ask(lambda: self.link.change(node, values)))

    async def _on_start(self, page: Page) -> str:
        return await asyncio.wrap_future(self.link.ask(self.link.start))

    async def _on_hold(self, page: Page) -> str:
        return await asyncio.wrap_future(self.link.ask(self.link.hold))

    async def _on_record(self, page: Page, on: bool) -> str:
        return await asyncio.wrap_future(self.link.ask(lambda: self.link.record(on)))

    async def _on_marker(self, page: Page, text: str) -> str:
        await asyncio.wrap_future(self.link.ask(lambda: self.link.mark(text)))
        history = self.link.memory.history
        await self._everybody(marker={"text": text, "sample": history.end, "epoch": self.link.memory.epoch})
        return f"marked: {text}"

    async def _on_stop(self, page: Page) -> str:
        return await self.stop()

    async def stop(self) -> str:
        """Stop the axis; return the answer once the plant confirms it."""
        deadline = time.monotonic() + STOP
        while time.monotonic() < deadline:
            self.link.stop()
            await asyncio.sleep(AGAIN)
            if self._tripped():
                return "stopped: the axis goes to its safe voltage until it is started"
        if not self.link.memory.is_live:
            raise HysteresisError("stop was sent, but the axis is silent: it is unknown whether it has stopped")
        raise HysteresisError("stop was sent, but the plant does not confirm it: switch the amplifier off")


def main() -> int:
    """Serve the page that the JSON argument describes until a signal arrives; return the exit code."""
    request = json.loads(sys.argv[1])
    stay_on_this_machine()
    namespace, bind = request["namespace"], request["bind"]
    enclave = ["--ros-args", "--enclave", enclave_of(namespace, PAGE)]
    over = threading.Event()
    try:
        rclpy.init(args=enclave, signal_handler_options=SignalHandlerOptions.NO)
        link = AxisLink(namespace, pathlib.Path(request["folder"]))
    except Exception as error:  # rclpy raises a different exception for each error in a name
        words = str(error).split(", at /")[0]
        print(f"hysteresis: --namespace {namespace}: {' '.join(words.split())}", file=sys.stderr)
        return 2
    hearing = threading.Thread(target=link.run, args=(over,), daemon=True)
    hearing.start()
    server = Server(link, Access(bind, new_token(bind)))
    try:
        asyncio.run(_serve(server, bind, request["port"], hearing.is_alive))
        if not hearing.is_alive():
            return 1  # the reason was printed
    except OSError as error:
        print(f"hysteresis: {bind}:{request['port']}: cannot listen on it: {error.strerror}", file=sys.stderr)
        return 2
    finally:
        over.set()
        hearing.join()
        rclpy.shutdown()
    return 0


async def _serve(server: Server, bind: str, port: int, is_heard: Callable[[], bool]) -> None:
    """Serve until a signal arrives, or the link to the axis ends."""
    leave = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, leave.set)
    async with server.listening(bind, port, PATIENCE) as port:
        host = f"[{bind}]" if ":" in bind else bind
        token = f"?token={server.access.token}" if server.access.token else ""
        print(f"watch {server.link.namespace or '/'}: http://{host}:{port}/{token}", flush=True)
        while not leave.is_set() and is_heard():
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(leave.wait(), LOOK)


if __name__ == "__main__":
    raise SystemExit(main())
