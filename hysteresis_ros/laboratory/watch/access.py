# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Access control and request format of the page of an axis; no ROS, no web server.

A foreign page that is open in a browser of the laboratory can send requests to this machine. But such a request cannot
have this server's origin (``Origin``) or name (``Host``; even with "DNS rebinding", this is the foreign page's name),
and it lacks the token. Every request is checked before it reaches the axis.
"""

from __future__ import annotations

import hmac
import ipaddress
import math
import secrets
import socket
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from hysteresis_ros.errors import HysteresisError, did_you_mean, shortened
from hysteresis_ros.files import BoundsError, read_json
from hysteresis_ros.units import quantity

#: Cookie that stores the token after a page was opened with the token in its address.
COOKIE = "hysteresis_watch"
#: Random bytes in a token.
TOKEN_BYTES = 24


def is_loopback(address: str) -> bool:
    """Return whether an address can be reached from this machine only."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address == "localhost"


def new_token(address: str) -> str:
    """Return a random token for a server that listens on an address; empty for a loopback address."""
    return "" if is_loopback(address) else secrets.token_urlsafe(TOKEN_BYTES)


def _host_name(host: str) -> str:
    """Return a ``Host`` without its port, in lower case; empty when it is invalid."""
    try:
        return (urlsplit(f"//{host}").hostname or "").lower()
    except ValueError:
        return ""


@dataclass(frozen=True)
class Access:
    """Conditions that a request must meet."""

    address: str  #: Address on which the server listens.
    token: str  #: Required token; empty if requests need no token.

    def refuses_host(self, host: str) -> str:
        """Return why a request's ``Host`` is refused; empty when it is accepted."""
        name = _host_name(host)
        if is_loopback(self.address):
            return "" if name and is_loopback(name) else f"Host {host!r}: open this page as localhost or 127.0.0.1"
        own = socket.gethostname().lower()
        try:
            ipaddress.ip_address(name)
        except ValueError:
            known = ("localhost", own, f"{own}.local", socket.getfqdn().lower())
            return "" if name in known else f"Host {host!r}: open this page by its address, or as {own}"
        return ""

    def refuses_token(self, given: str) -> str:
        """Return why a token is refused; empty when it is accepted."""
        if hmac.compare_digest(given.encode("utf-8", "replace"), self.token.encode()):
            return ""
        return "this page needs the token: open the address that `hysteresis watch` printed"

    def refuses_origin(self, headers: Mapping[str, str]) -> str:
        """Return why a request that changes something is refused; empty if this server's page or a program sent it."""
        origin = headers.get("Origin", "")
        if origin:
            own = f"http://{headers.get('Host', '')}"
            return (
                ""
                if origin.lower() == own.lower()
                else f"Origin {origin!r}: only the page of {own} may change anything"
            )
        return "" if headers.get("X-Hysteresis") else "no Origin: a program must send the header 'X-Hysteresis: 1'"


class Control:
    """Control of the axis: the first page that asks has it, until it closes or another page takes over."""

    def __init__(self) -> None:
        self._holder: int | None = None
        self._place = ""
        self._since = 0.0

    def ask(self, page: int, place: str, by_force: bool = False) -> bool:
        """Give the control to a page if it is free, or by force; return whether this page now has the control."""
        if self._holder is None or (by_force and self._holder != page):
            self._holder, self._place, self._since = page, place, time.time()
        return self._holder == page

    def leave(self, page: int) -> None:
        """Release the control of a page that closes."""
        if self._holder == page:
            self._holder = None

    def refuses(self, page: int) -> str:
        """Return why a page may not change anything; empty if it has the control."""
        if self._holder == page:
            return ""
        if self._holder is None:
            return "no page controls the axis: take control first"
        since = time.strftime("%H:%M:%S", time.localtime(self._since))
        return f"another page controls the axis ({self._place}, since {since}): take it over first"

    def told(self, page: int) -> dict:
        """Return the state of the control for a page."""
        return {
            "mine": self._holder == page,
            "holder": self._place if self._holder is not None else "",
            "since": self._since,
        }


#: Services of an inchworm motor that a page may call.
SERVICES = ("home", "release", "learn", "freeze", "forget")

#: Longest text of a marker [characters].
MARKER = 200
#: Largest number of parameters in one request.
PARAMETERS = 50
#: Longest value of a parameter [characters].
VALUE = 4096
#: Allowed range of the time window [s].
WINDOW = (0.02, 60.0)
#: Allowed range of the number of screen columns.
COLUMNS = (50, 2000)


class RequestError(HysteresisError):
    """A request is malformed, or names something that does not exist."""

    #: Number of the request; -1: unknown.
    number = -1


class Request(NamedTuple):
    """A request of a page."""

    number: int  #: Number that the answer repeats.
    action: str  #: A key of :data:`ACTIONS`.
    values: dict[str, Any]  #: Checked values of the action.


def _number(name: str, given: Any, low: float, high: float, unit: str = "") -> float:
    if isinstance(given, bool) or not isinstance(given, (int, float)) or not math.isfinite(given):
        raise RequestError(f"{name} = {shortened(given)}: must be a finite number")
    if not low <= given <= high:
        raise RequestError(f"{name} = {given:g}: must be {low:g} … {high:g}{unit}")
    return float(given)


def _text(name: str, given: Any, longest: int) -> str:
    if not isinstance(given, str) or not given.strip() or len(given) > longest:
        raise RequestError(f"{name} = {shortened(given)}: must be a text of 1 … {longest} characters")
    return given.strip()


def _flag(name: str, given: Any) -> bool:
    if not isinstance(given, bool):
        raise RequestError(f"{name} = {shortened(given)}: must be true or false")
    return given


def _view(given: dict) -> dict:
    columns = _number("columns", given.get("columns"), *COLUMNS)
    return {"window": _number("window", given.get("window"), *WINDOW, " s"), "columns": int(columns)}


def _quantity(name: str, given: Any, wanted: str, meaning: str) -> float:
    text = _text(name, given, 40)
    try:
        value, unit = quantity(text)
    except ValueError as error:
        raise RequestError(f"{name} {text}: {error}") from None
    if unit not in ("", wanted):
        raise RequestError(f"{name} {text}: is in {unit}, must be {meaning}")
    return value


def _setpoint(given: dict) -> dict:
    return {"metres": _quantity("setpoint", given.get("value"), "m", "a length, e.g. 5um")}


def _speed(given: dict) -> dict:
    return {"speed": _quantity("speed", given.get("value"), "m/s", "a speed, e.g. 50um/s")}


def _call(given: dict) -> dict:
    service = given.get("service")
    if service not in SERVICES:
        raise RequestError(f"service = {shortened(service)}: must be one of {', '.join(SERVICES)}")
    return {"service": service}


def _set(given: dict) -> dict:
    values = given.get("values")
    if not isinstance(values, dict) or not 0 < len(values) <= PARAMETERS:
        raise RequestError(f"values: must be 1 … {PARAMETERS} parameters with their values")
    return {
        "node": _text("node", given.get("node"), 100),
        "values": {_text("parameter", name, 200): _text(name, value, VALUE) for name, value in values.items()},
    }


#: Allowed actions, each with the function that reads its values.
ACTIONS = {
    "view": _view,
    "control": lambda given: {"by_force": _flag("by_force", given.get("by_force", False))},
    "setpoint": _setpoint,
    "speed": _speed,
    "call": _call,
    "set": _set,
    "start": lambda given: {},
    "hold": lambda given: {},
    "stop": lambda given: {},
    "record": lambda given: {"on": _flag("on", given.get("on"))},
    "marker": lambda given: {"text": _text("marker", given.get("text"), MARKER)},
}
#: Actions that a page may request without having the control.
FREE = ("view", "control", "stop")


def read_request(text: str) -> Request:
    """Return the request in a message of a page."""
    number = -1
    try:
        try:
            given = read_json(text)
        except (ValueError, BoundsError):
            raise RequestError(f"{shortened(text)}: is not JSON") from None
        if not isinstance(given, dict):
            raise RequestError(f"{shortened(text)}: must be an object with 'id' and 'do'")
        asked = given.get("id")
        if isinstance(asked, bool) or not isinstance(asked, int) or not 0 <= asked < 2**53:
            raise RequestError(f"id = {shortened(asked)}: must be a whole number")
        number = asked
        action = given.get("do")
        if not isinstance(action, str) or action not in ACTIONS:
            hint = did_you_mean(str(action), ACTIONS)
            raise RequestError(f"do = {shortened(action)}: must be one of {', '.join(ACTIONS)}{hint}")
        return Request(number, action, ACTIONS[action](given))
    except RequestError as error:
        error.number = number
        raise
