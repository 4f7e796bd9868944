# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The candidate with damping: a PID in front of a damping of the model's resonance."""

from __future__ import annotations

from dataclasses import replace

from hysteresis_ros.control.damping.design import DAMPED
from hysteresis_ros.control.damping.plant import modes
from hysteresis_ros.control.feedforward import FeedforwardParameters
from hysteresis_ros.control.law import UNFED
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.simulation.design import DesignRequest, design_axis

#: Kinds of damping that are tried, the simplest first, and the one where a force is measured.
KINDS = ("irc", "ppf")
BY_FORCE = ("iff",)


def has_resonance(axis: AxisParameters) -> bool:
    """Tell whether the controller's model has a resonance to damp.

    Parameters
    ----------
    axis : AxisParameters
    """
    node = axis.motion_controller
    poles = node.model.dynamics.matrices.poles.astype(complex)
    return any(damping < DAMPED for _, damping in modes(poles, 1.0 / node.sample_rate))


def has_force(axis: AxisParameters) -> bool:
    """Tell whether the controller of an axis knows of a force in the stack.

    Parameters
    ----------
    axis : AxisParameters
    """
    return axis.motion_controller.model.force.there


def damped_pid(given) -> dict:
    """Return a PID in front of the first kind of damping whose loops are what every design is held to.

    Parameters
    ----------
    given : comparison.candidates.Given

    Raises
    ------
    ConfigurationError
        No kind is.
    """
    return _kept(given, KINDS)


def forced_pid(given) -> dict:
    """Return a PID in front of a damping by the measured force.

    Parameters
    ----------
    given : comparison.candidates.Given

    Raises
    ------
    ConfigurationError
        Its loops are not what every design is held to.
    """
    return _kept(given, BY_FORCE)


def _kept(given, kinds: tuple[str, ...]) -> dict:
    key = ("pid", *kinds)
    if key not in given.gains:
        given.gains[key] = _designed(given.axis, kinds)
    return given.gains[key]


def _designed(axis: AxisParameters, kinds: tuple[str, ...]) -> dict:
    plain = replace(axis, motion_controller=replace(axis.motion_controller, feedforward=FeedforwardParameters()))
    reasons = []
    for kind in kinds:
        try:
            found = design_axis(plain, DesignRequest("pid", damping=kind))
        except ParameterError as error:
            reasons.append(f"{kind}: {error}")
            continue
        if not found.misses():
            gains, damping = found.parameters.pid.to_mapping(), found.parameters.damping.to_mapping()
            named = {f"pid.{name}": value for name, value in gains.items()}
            named |= {f"damping.{name}": value for name, value in damping.items() if _is_of(name, kind)}
            return {"type": "pid", **UNFED, **named}
        reasons.append(f"{kind}: {found.misses()[0]}")
    raise ConfigurationError("; ".join(reasons))


def _is_of(name: str, kind: str) -> bool:
    return name == "type" or name.startswith(f"{kind}.")
