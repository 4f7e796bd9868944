# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The rows of the comparison for each control law, including laws of other packages.

Each row has a design: a function that takes :class:`hysteresis_ros.laboratory.comparison.candidates.Given` and returns
the parameters of the motion controller that differ from the configuration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from hysteresis_ros.control.law import UNFED, DesignTask
from hysteresis_ros.control.laws.pid import design_integral
from hysteresis_ros.control.linearisation import linear_loop
from hysteresis_ros.control.margins import FASTEST, REQUIRED
from hysteresis_ros.control.sliding_gains import SLOWEST_FILTER, GainSearch, lq_surface, reaching_law, sliding_pole
from hysteresis_ros.control.uncertainty import PossiblePlant, Uncertainty, drawn_plants
from hysteresis_ros.registry import added

#: Group of entry points by which a package adds rows: ``leaky_pi = my_package.leaky_pi:COMPARED``.
GROUP = "hysteresis_ros.compared"


@dataclass(frozen=True, eq=False)
class ComparedLaw:
    """The rows of a controller in the table of ``hysteresis compare``."""

    name: str  #: ``type`` of the motion controller.
    #: Name in the table → ``design(given)``, which returns the parameters of the motion controller that differ from
    #: the configuration, including ``type``; ``given`` is a
    #: :class:`hysteresis_ros.laboratory.comparison.candidates.Given`.
    rows: Mapping[str, Callable[[Any], dict]]


def _gains(given, changes: dict, place: Callable[[Any, float], Any] | None = None) -> dict:
    """Return a hyperplane, law and filter that keep the margins; ``place`` has the meaning it has in ``sliding_gains``.

    The filter is never faster than noise and mismatch require. In a robust comparison the margins hold at the corners
    of the mismatch, with and without one more sample of delay.
    """
    node = given.axis.motion_controller
    surface = replace(lq_surface(node.sliding_mode, node.model.dynamics), eta=0.0, beta=0.0, delta=1.0)
    law = replace(node, sliding_mode=surface).to_mapping()
    parameters = type(node).from_mapping({**law, **UNFED, **changes})
    size = given.conditions.mismatch
    around = Uncertainty(size, size, size, draws=0) if given.conditions.robust else None
    found = _searched(parameters, 1.0 / node.sample_rate, place, around)
    groups = ("sliding_mode.", "kalman.")
    return {**changes, **{name: value for name, value in found.to_mapping().items() if name.startswith(groups)}}


@lru_cache(maxsize=64)
def _searched(parameters, sample_time: float, place, around: Uncertainty | None):
    """Search for the parameters, once for all compensators that share them; ``around``: on plants around the model."""
    aimed = FASTEST
    plants: tuple[PossiblePlant, ...] = ()
    if around is not None:
        aimed, plants = REQUIRED, drawn_plants(parameters.model.dynamics, sample_time, around)
    task = DesignTask(parameters, sample_time, None, None, lambda one: linear_loop(one, sample_time), aimed, plants)
    search = GainSearch(parameters, sample_time, task.judge, place, task.aimed)
    return search.at(*search.best((SLOWEST_FILTER, 0.0)))


def _integral_sliding_mode(given) -> dict:
    changes = {"type": "integral_sliding_mode", **given.kalman("constant")}
    return {**_gains(given, changes, reaching_law), **given.preview()}


def _integral(given) -> dict:
    """Return the simplest controller that works: static feedforward and integral action."""
    node = given.axis.motion_controller
    gains = design_integral(node.pid, given.dynamics, 1.0 / node.sample_rate).to_mapping()
    named = {f"pid.{name}": value for name, value in gains.items()}
    return {"type": "pid", "feedforward.type": "static", "feedforward.preview": 0, **named}


def _sliding_mode(given, disturbance: str, **more) -> dict:
    """Return a sliding mode controller with this disturbance model; ``more`` are parameters of ``sliding_mode``."""
    changes = {"type": "sliding_mode", **given.kalman(disturbance)}
    changes |= {f"sliding_mode.{name}": value for name, value in more.items()}
    return _gains(given, changes, reaching_law)


def _super_twisting(given) -> dict:
    changes = {"type": "super_twisting", "super_twisting.gains": "from_bound", **given.kalman("constant")}
    changes["super_twisting.bound"] = given.change() * given.axis.plant_simulator.sample_rate
    place = sliding_pole if given.dynamics.order > 1 else None
    return {**_gains(given, changes, place), **given.preview()}


#: Feedforward of the reference plus its velocity times the mean delay of the model; needs no preview.
BY_VELOCITY = {"feedforward.type": "velocity", "feedforward.preview": 0}

_OWN = (
    ComparedLaw("integral_sliding_mode", {"integral sliding mode + feedforward": _integral_sliding_mode}),
    ComparedLaw(
        "open_loop",
        {
            "open loop": lambda given: {"type": "open_loop", **UNFED},
            "feedforward": lambda given: {"type": "open_loop", **given.preview()},
        },
    ),
    # tuned on the fastest, most difficult reference, with this compensator in the loop
    ComparedLaw(
        "pid",
        {
            "integral + static feedforward": _integral,
            "PID": lambda given: {"type": "pid", **UNFED, **given.tuned("pid")},
            "PID + feedforward": lambda given: {"type": "pid", **given.preview(), **given.tuned("pid")},
            "PID + velocity feedforward": lambda given: {"type": "pid", **BY_VELOCITY, **given.tuned("pid")},
        },
    ),
    ComparedLaw(
        "sliding_mode",
        {
            "sliding mode": lambda given: {**_sliding_mode(given, "none"), **UNFED},
            "sliding mode, integral": lambda given: {**_sliding_mode(given, "none", tracking="integral"), **UNFED},
            "offset-free": lambda given: {**_sliding_mode(given, "constant"), **UNFED},
            "offset-free + feedforward": lambda given: {**_sliding_mode(given, "constant"), **given.preview()},
            "offset-free + velocity feedforward": lambda given: {**_sliding_mode(given, "constant"), **BY_VELOCITY},
            "drift-free + feedforward": lambda given: {**_sliding_mode(given, "ramp"), **given.preview()},
        },
    ),
    ComparedLaw("super_twisting", {"super-twisting + feedforward": _super_twisting}),
)

#: The rows of each controller, by its type.
COMPARED: dict[str, ComparedLaw] = added({law.name: law for law in _OWN}, ComparedLaw, GROUP)


def _rows() -> dict[str, tuple[ComparedLaw, Callable[[Any], dict]]]:
    """Return law and design of each row; raise TypeError if two laws have a row with the same name."""
    found: dict[str, tuple[ComparedLaw, Callable[[Any], dict]]] = {}
    for law in COMPARED.values():
        for name, design in law.rows.items():
            if name in found:
                raise TypeError(f"{GROUP}: {found[name][0].name} and {law.name} both have a row {name!r}; rename one")
            found[name] = law, design
    return found


#: Law and design of each row.
ROWS = _rows()
