# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Write a designed controller into a copy of the configuration it was designed from, comments kept."""

from __future__ import annotations

from collections.abc import Callable

import yaml

from hysteresis_ros.configuration import Configuration, dump_configuration, matches, parse_configuration
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.damping.registry import KINDS, NONE
from hysteresis_ros.control.learning.parameters import LearningParameters

NODE = "motion_controller"
#: How the comment of an earlier design of the learning, and of the controller with all that was designed over it,
#: begins, which does not describe the file any more.
LEARNING = ("# Learning designed by `hysteresis design", "# over the controller of this file:")
HEADERS = ("# Controller designed by `hysteresis design", "# on the model in motion_controller:", *LEARNING)


def designed_values(before: dict, parameters: ControllerParameters) -> dict:
    """Return the flat parameters of the controller node: those of the file, with the groups that the design decides.

    A correction that was learned over the controller before has filters that are wrong for another one: it goes.

    Parameters
    ----------
    before : dict
        Flat parameters of the section.
    parameters : ControllerParameters
        Of the design.
    """
    groups = (*parameters.law.groups, "feedforward", *_damping(before, parameters))
    replaced = tuple(f"{name}." for name in groups)
    gone = (*replaced, "learning.")
    kept = {name: value for name, value in before.items() if not name.startswith(gone) and name != "type"}
    chosen = {"type": parameters.type}
    flat = parameters.to_mapping()
    unused = tuple(f"damping.{kind}." for kind in KINDS if kind != parameters.damping.type)
    flat = {name: value for name, value in flat.items() if not name.startswith(unused)}
    # ROS has no type for an empty array
    chosen |= {name: value for name, value in flat.items() if name.startswith(replaced) and value != ()}
    found = {"type": chosen.pop("type")} | kept | chosen
    return {name: tuple(value) if isinstance(value, list) else value for name, value in found.items()}


def _damping(before: dict, parameters: ControllerParameters) -> tuple[str, ...]:
    """Return the group of the damping, where there is one or the file speaks of it."""
    named = any(name.startswith("damping.") for name in before)
    return ("damping",) if named or parameters.damping.type != NONE else ()


def design_text(configuration: Configuration, parameters: ControllerParameters, namespace: str, header: str) -> str:
    """Return the text of the file with the design: everything but the controller's section stays as it is written.

    Parameters
    ----------
    configuration : Configuration
        What was designed from.
    parameters : ControllerParameters
        Of the design.
    namespace : str
        Of the axis.
    header : str
        Comment lines for the beginning of the file, without ``#``.
    """
    return _text(configuration, lambda before: designed_values(before, parameters), namespace, header, HEADERS)


def learning_text(configuration: Configuration, parameters: LearningParameters, namespace: str, header: str) -> str:
    """Return the text of the file with a designed correction: everything else stays.

    Parameters
    ----------
    configuration : Configuration
        What was designed from.
    parameters : LearningParameters
        Of the design.
    namespace : str
        Of the axis.
    header : str
        Comment lines for the beginning of the file, without ``#``.
    """
    chosen = {f"learning.{name}": value for name, value in parameters.to_mapping().items()}

    def values(before: dict) -> dict:
        return {name: value for name, value in before.items() if not name.startswith("learning.")} | chosen

    return _text(configuration, values, namespace, header, LEARNING)


def _text(configuration: Configuration, values: Callable[[dict], dict], namespace: str, header: str, replaced) -> str:
    """Return the text of a file with other values in the controller's section, and its comment in place of others."""
    comment = "".join(f"# {line}\n" for line in header.splitlines())
    full = f"{namespace}/{NODE}"
    root = yaml.compose(configuration.text)
    sections = [(key, value) for key, value in root.value if _belongs(key.value, full)]
    lines = configuration.text.splitlines(keepends=True)
    kept = 0
    while lines[kept].startswith(replaced):
        kept += 1
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += "\n"
    if not sections:
        section = dump_configuration({f"/**{full}": values(configuration.node(NODE, namespace))})
        text = comment + "".join(lines[kept:]) + "\n" + section
    else:
        key, value = sections[-1]
        before = next(flat for pattern, flat in reversed(configuration.entries) if pattern == key.value)
        section = dump_configuration({key.value: values(before)})
        first, end = key.start_mark.line, min(value.end_mark.line, len(lines))
        while end > first + 1 and (not lines[end - 1].strip() or lines[end - 1].startswith("#")):
            end -= 1
        text = comment + "".join(lines[kept:first]) + section + "".join(lines[end:])
    parse_configuration(text, "the designed file")
    return text


def _belongs(pattern: str, full: str) -> bool:
    return pattern.rsplit("/", 1)[-1] == NODE and matches(pattern, full)
