# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Who may see the page of an axis, who may change something, and what may be asked for; no ROS, no web server.

A foreign page, open in a browser in the laboratory, can send requests to this machine. It cannot name this server's
origin (``Origin``), be called by this server's name (``Host``; under "DNS rebinding" the name stays the foreign one),
or know the token. Every request is checked before it reaches the axis.
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

#: Cookie that holds the token once it was in the address.
COOKIE = "hysteresis_watch"
#: Bytes of chance in a token.
TOKEN_BYTES = 24


def is_loopback(address: str) -> bool:
    """Tell whether an address is heard on this machine only."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address == "localhost"


def new_token(address: str) -> str:
    """Return the token of a server that listens on an address: by chance, or none on this machine's own address."""
    return "" if is_loopback(address) else secrets.token_urlsafe(TOKEN_BYTES)


def _host_name(host: str) -> str:
    """Return a ``Host`` without its port, in small letters; empty where it is none."""
    try:
        return (urlsplit(f"//{host}").hostname or "").lower()
    except ValueError:
        return ""


@dataclass(frozen=True)
class Access:
    """What a request must bring."""

    address: str  #: On which the server listens.
    token: str  #: Empty: none is asked for.

    def refuses_host(self, host: str) -> str:
        """Return why a request's ``Host`` is refused, empty when it is not."""
        name = _host_name(host)
        if is_loopback(self.address):
            return "" if name and is_loopback(name) else f"Host {host!r}: this page is called by localhost or 127.0.0.1"
        own = socket.gethostname().lower()
        try:
            ipaddress.ip_address(name)
        except ValueError:
            known = ("localhost", own, f"{own}.local", socket.getfqdn().lower())
            return "" if name in known else f"Host {host!r}: this page is called by its address, or by {own}"
        return ""

    def refuses_token(self, given: str) -> str:
        """Return why a token is refused, empty when it is not."""
        if hmac.compare_digest(given.encode("utf-8", "replace"), self.token.encode()):
            return ""
        return "this page needs the token of the address that `hysteresis watch` has printed"

    def refuses_origin(self, headers: Mapping[str, str]) -> str:
        """Return why what would change something is refused, empty when it is not: only this server's page may ask."""
        origin = headers.get("Origin", "")
        if origin:
            own = f"http://{headers.get('Host', '')}"
            return (
                ""
                if origin.lower() == own.lower()
                else f"Origin {origin!r}: only the page of {own} may change anything"
            )
        return "" if headers.get("X-Hysteresis") else "no Origin: programs give a header 'X-Hysteresis: 1'"


class Control:
    """Which one of several pages may change something: the first, until it leaves or another one takes over."""

    def __init__(self) -> None:
        self._holder: int | None = None
        self._place = ""
        self._since = 0.0

    def ask(self, page: int, place: str, by_force: bool = False) -> bool:
        """Give the control to a page when nobody has it, or by force; tell whether the page has it now."""
        if self._holder is None or (by_force and self._holder != page):
            self._holder, self._place, self._since = page, place, time.time()
        return self._holder == page

    def leave(self, page: int) -> None:
        """Take the control back from a page that goes."""
        if self._holder == page:
            self._holder = None

    def refuses(self, page: int) -> str:
        """Return why a page may change nothing, empty when it may."""
        if self._holder == page:
            return ""
        if self._holder is None:
            return "nobody has the control: take it first"
        since = time.strftime("%H:%M:%S", time.localtime(self._since))
        return f"another page has the control ({self._place}, since {since}): take it over first"

    def told(self, page: int) -> dict:
        """Return what a page is told of it."""
        return {
            "mine": self._holder == page,
            "holder": self._place if self._holder is not None else "",
            "since": self._since,
        }


#: What an inchworm motor may be asked for by its services.
SERVICES = ("home", "release", "learn", "freeze", "forget")

#: Longest text of a marker, most parameters at once, longest value.
MARKER, PARAMETERS, VALUE = 200, 50, 4096
#: Windows of time [s] and columns of the screen that may be asked for.
WINDOW, COLUMNS = (0.02, 60.0), (50, 2000)


class RequestError(HysteresisError):
    """A page asks for what there is not, or in words that are none."""

    #: Of the request; -1 where it has none.
    number = -1


class Request(NamedTuple):
    """What a page asks for."""

    number: int  #: Which the answer repeats.
    action: str  #: A key of :data:`ACTIONS`.
    values: dict[str, Any]  #: Checked.


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
    return {"metres": _quantity("setpoint", given.get("value"), "m", "a length, as 5um")}


def _speed(given: dict) -> dict:
    return {"speed": _quantity("speed", given.get("value"), "m/s", "a speed, as 50um/s")}


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


#: What may be asked for, and what reads its values.
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
#: What also pages may do that have not the control.
FREE = ("view", "control", "stop")


def read_request(text: str) -> Request:
    """Return what a page asks for."""
    number = -1
    try:
        try:
            given = read_json(text)
        except (ValueError, BoundsError):
            raise RequestError(f"{shortened(text)}: is no JSON") from None
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
