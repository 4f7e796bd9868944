# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a page may ask for, and the checks of it; knows no ROS and no web server."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from hysteresis_ros.bounded import BoundsError, read_json
from hysteresis_ros.errors import HysteresisError, did_you_mean, shortened
from hysteresis_ros.units import quantity

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
    """What a page asks for.

    Parameters
    ----------
    number : int
        Which the answer repeats.
    action : str
        A key of :data:`ACTIONS`.
    values : dict
        Checked.
    """

    number: int
    action: str
    values: dict[str, Any]


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
    """Return what a page asks for.

    Parameters
    ----------
    text : str
        JSON: ``{"id": 1, "do": "setpoint", "value": "5um"}``.

    Raises
    ------
    RequestError
        It is no request; the sentence says why. Its ``number`` is that of the request where it has one, else -1.
    """
    number = -1
    try:
        try:
            given = read_json(text)
        except (ValueError, BoundsError):
            raise RequestError(f"{shortened(text)}: is no JSON") from None
        if not isinstance(given, dict):
            raise RequestError(f"{shortened(text)}: must be an object with 'id' and 'do'")
        number = given.get("id")
        if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < 2**53:
            number = -1
            raise RequestError(f"id = {shortened(given.get('id'))}: must be a whole number")
        action = given.get("do")
        if not isinstance(action, str) or action not in ACTIONS:
            hint = did_you_mean(str(action), ACTIONS)
            raise RequestError(f"do = {shortened(action)}: must be one of {', '.join(ACTIONS)}{hint}")
        return Request(number, action, ACTIONS[action](given))
    except RequestError as error:
        error.number = number
        raise
