# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Who may see the page of an axis, and who of those may change something; knows no ROS and no web server.

A page of anybody's, open in the browser of somebody in the laboratory, can send requests to this machine. What it
cannot do is name this server's origin (``Origin``), or be called by this server's name (``Host``; a name that is
pointed elsewhere afterwards, "DNS rebinding", stays the name), or know the token.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
import time
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import urlsplit

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
    """What a request must bring.

    Parameters
    ----------
    address : str
        On which the server listens.
    token : str
        Empty: none is asked for.
    """

    address: str
    token: str

    def refuses_host(self, host: str) -> str:
        """Return why a request's ``Host`` is refused, empty when it is not.

        Parameters
        ----------
        host : str
            With or without a port.
        """
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
        """Return why a token is refused, empty when it is not.

        Parameters
        ----------
        given : str
            Out of the address or the cookie.
        """
        if hmac.compare_digest(given.encode("utf-8", "replace"), self.token.encode()):
            return ""
        return "this page needs the token of the address that `hysteresis watch` has printed"

    def refuses_origin(self, headers: Mapping[str, str]) -> str:
        """Return why what would change something is refused, empty when it is not: only this server's page may ask.

        Parameters
        ----------
        headers : mapping of str to str
            Of the request. Programs that are no browsers give no origin; they are let in with the word that no
            page can put into a header, ``X-Hysteresis``.
        """
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
        """Give the control to a page when nobody has it, or by force; tell whether the page has it now.

        Parameters
        ----------
        page : int
            Number of the page.
        place : str
            Where it is, for the others.
        by_force : bool
            Take it away from another page.
        """
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
