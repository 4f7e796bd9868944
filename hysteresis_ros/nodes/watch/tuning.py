# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The parameters of an axis as a page shows them: those in use, with unit, range and meaning from the one table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields

from hysteresis_ros.control.registry import LAWS
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.loop.node_parameters import NODE_PARAMETERS, NodeParameters, RecorderNodeParameters
from hysteresis_ros.parameters import Parameters
from hysteresis_ros.references.waveforms import Waveform
from hysteresis_ros.signals import CONTROLLER, MOTOR_SOURCE


def names_in_use(cls: type[Parameters], values: Mapping, prefix: str = "") -> Iterator[str]:
    """Yield the names of the parameters that something hangs on: of several models and laws only those of the chosen.

    Parameters
    ----------
    cls : type of Parameters
    values : mapping
        Flat dotted names to values.
    prefix : str
        Before the names.
    """
    for item in fields(cls):
        nested, chooser = item.metadata.get("group"), item.metadata.get("variant_of")
        if nested is None:
            yield prefix + item.name
        elif chooser is None or values.get(prefix + chooser) == item.name:
            yield from names_in_use(nested, values, f"{prefix}{item.name}.")


def _hangs_on_nothing(node: str, name: str, values: Mapping) -> bool:
    """Tell whether a parameter belongs to another law than the chosen one, or to something that is not there."""
    group, _, own = name.partition(".")
    if own and own != "type" and values.get(f"{group}.type") == "none":
        return True
    of_laws = {group for law in LAWS.values() for group in law.groups} if node == CONTROLLER else set()
    return group in of_laws and group not in LAWS[values["type"]].groups


def table_of(node: str, values: Mapping) -> list[dict]:
    """Return what a page shows of the parameters of a node that may change while it runs.

    Parameters
    ----------
    node : str
        Its kind.
    values : mapping
        Flat dotted names to values.
    """
    shared = {row.name for row in NodeParameters.table()}
    used = {
        name
        for name in names_in_use(NODE_PARAMETERS[node], values)
        if name not in shared and not _hangs_on_nothing(node, name, values)
    }
    return [
        {
            "name": row.name,
            "value": list(values[row.name]) if isinstance(values[row.name], (list, tuple)) else values[row.name],
            "type": row.type_name,
            "unit": row.unit,
            "low": row.low,
            "high": row.high,
            "choices": row.choices,
            "allowed": row.allowed(),
            "about": row.description,
        }
        for row in NODE_PARAMETERS[node].table()
        if row.name in used and row.name in values and not row.read_only
    ]


def axis_of(namespace: str, values: Mapping[str, Mapping]) -> AxisParameters:
    """Return the parameters of an axis out of those of its nodes.

    Parameters
    ----------
    namespace : str
    values : mapping of str to mapping
        Of each node.

    Raises
    ------
    ParameterError
        They are not those of this version.
    """
    typed = {
        node: NODE_PARAMETERS[node].from_mapping({name: value for name, value in own.items() if _is_ours(node, name)})
        for node, own in values.items()
    }
    return AxisParameters.of_nodes(namespace, {**typed, "recorder": RecorderNodeParameters()})


def _is_ours(node: str, name: str) -> bool:
    return name in {row.name for row in NODE_PARAMETERS[node].table()}


def limits_of(values: Mapping[str, Mapping]) -> dict[str, list[float]]:
    """Return the ranges that a page draws, of the reference [m] and of the voltage [V], and that of setpoints [m].

    A setpoint leaves room for the waveform around it, as the source of references does.

    Parameters
    ----------
    values : mapping of str to mapping
        Of each node.
    """
    source = values.get(MOTOR_SOURCE) or values.get("reference_generator", {})
    compensator = values.get("hysteresis_compensator", {})
    found = {
        "setpoint": [source.get("minimum"), source.get("maximum")],
        "voltage": [compensator.get("limits.minimum"), compensator.get("limits.maximum")],
    }
    found["slider"] = _setpoints(values.get("reference_generator", {}), *found["setpoint"])
    return {name: pair for name, pair in found.items() if None not in pair}


def _setpoints(source: Mapping, low: float | None, high: float | None) -> list[float | None]:
    """Return the range of setpoints that are not refused; the whole one where the waveform is not known."""
    if None in (low, high) or not source.get("sample_rate"):
        return [low, high]
    own = {name: value for name, value in source.items() if _is_ours("reference_generator", name)}
    try:
        parameters = NODE_PARAMETERS["reference_generator"].from_mapping(own)
        waveform = Waveform(parameters.waveform, 1.0 / source["sample_rate"])
    except HysteresisError:
        return [low, high]
    return [low - waveform.lowest, high - waveform.highest]
