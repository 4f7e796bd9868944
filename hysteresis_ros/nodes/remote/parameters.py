# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis get`` and ``set``: parameters of a node that runs."""

from __future__ import annotations

import yaml
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python

from hysteresis_ros.configuration import parse_value
from hysteresis_ros.errors import HysteresisError, ParameterError, Problem, did_you_mean
from hysteresis_ros.nodes.remote.client import Client
from hysteresis_ros.parameters import ARRAY_TYPES, ParameterRow
from hysteresis_ros.units import quantity_in


def get(client: Client, node: str, names: list[str]) -> None:
    """Print parameters of a node as YAML, all of them when none is named.

    Parameters
    ----------
    client : Client
    node : str
    names : list of str
    """
    full = client.find(node)
    known = _names(client, full)
    _refuse_unknown(full, names, known)
    asked = names or known
    for name, plain in values_of(client, full, asked).items():
        text = yaml.safe_dump(plain, default_flow_style=True, allow_unicode=True, width=10**6)
        print(f"{name}: {text.removesuffix(chr(10) + '...' + chr(10)).strip()}", flush=True)


def values_of(client: Client, full: str, names: list[str] | None = None) -> dict:
    """Return parameters of a node, as plain values.

    Parameters
    ----------
    client : Client
    full : str
        Full name of a node that is there.
    names : list of str, optional
        All that have a value by default.
    """
    asked = _names(client, full) if names is None else names
    answer = client.ask(GetParameters, f"{full}/get_parameters", GetParameters.Request(names=asked))
    found = [plain_value(value) for value in answer.values]
    return dict(zip(asked, found, strict=True))


def plain_value(value):
    """Return a parameter's value as plain Python: arrays are lists.

    Parameters
    ----------
    value : rcl_interfaces.msg.ParameterValue
    """
    plain = parameter_value_to_python(value)
    return plain if plain is None or isinstance(plain, (str, bool, int, float)) else list(plain)


def set_(client: Client, node: str, values: dict[str, str]) -> None:
    """Set parameters of a node, all of them or, when one is refused, none; and say so.

    Parameters
    ----------
    client : Client
    node : str
    values : dict of str to str
        As people write them: YAML, or a number with its unit.
    """
    full = client.find(node)
    _refuse_unknown(full, list(values), _names(client, full))
    change(client, full, values)
    print(f"{full}: {', '.join(values)} set", flush=True)


def change(client: Client, full: str, values: dict[str, str]) -> None:
    """Set parameters of a node, all of them or, when one is refused, none.

    Parameters
    ----------
    client : Client
    full : str
        Full name of a node that is there.
    values : dict of str to str
        As people write them: YAML, or a number with its unit.

    Raises
    ------
    HysteresisError
        The node refuses; its reason.
    """
    from hysteresis_ros.loop.node_parameters import NODE_PARAMETERS  # half a second, which no other command needs

    table = NODE_PARAMETERS.get(full.rsplit("/", 1)[-1])
    rows = {row.name: row for row in table.table()} if table else {}
    request = SetParametersAtomically.Request()
    for name, text in values.items():
        value = _value(rows.get(name), name, text)
        request.parameters.append(Parameter(name, value=value).to_parameter_msg())
    result = client.ask(SetParametersAtomically, f"{full}/set_parameters_atomically", request).result
    if not result.successful:
        raise HysteresisError(f"{full} refuses: {result.reason}; nothing was changed")


def _names(client: Client, full: str) -> list[str]:
    request = ListParameters.Request(depth=ListParameters.Request.DEPTH_RECURSIVE)
    return sorted(client.ask(ListParameters, f"{full}/list_parameters", request).result.names)


def _refuse_unknown(full: str, names: list[str], known: list[str]) -> None:
    for name in names:
        if name not in known:
            below = [other for other in known if other.startswith(f"{name}.")]
            hint = f"; below it there are {', '.join(below)}" if below else did_you_mean(name, known)
            raise HysteresisError(f"{full} has no parameter '{name}'{hint or f'; `hysteresis get {full}` lists them'}")


def _value(row: ParameterRow | None, name: str, text: str):
    """Return the value of a parameter from its text, in the parameter's type where that is known."""
    value = parse_value(text)
    if row is None:
        return value
    if row.type is str:
        value = text
    if row.type is float and (isinstance(value, str) or row.unit == "m"):
        try:
            value = quantity_in(text, row.unit)
        except ValueError as error:
            raise ParameterError([Problem(name, text, f"{error}; allowed: {row.allowed()}")]) from None
    value = row.convert(value)
    return list(value) if row.type in ARRAY_TYPES else value
