"""Write a designed controller into a copy of the configuration it was designed from, comments kept."""

from __future__ import annotations

import yaml

from hysteresis_ros.configuration import Configuration, dump_configuration, matches, parse_configuration
from hysteresis_ros.control.controller import ControllerParameters

NODE = "motion_controller"
#: How the comment of an earlier design begins, which does not describe the file any more.
HEADERS = ("# Controller designed by `hysteresis design", "# on the model in motion_controller:")


def designed_values(before: dict, parameters: ControllerParameters) -> dict:
    """Return the flat parameters of the controller node: those of the file, with the groups that the design decides.

    Parameters
    ----------
    before : dict
        Flat parameters of the section.
    parameters : ControllerParameters
        Of the design.
    """
    replaced = tuple(f"{name}." for name in (*parameters.law.groups, "feedforward"))
    kept = {name: value for name, value in before.items() if not name.startswith(replaced) and name != "type"}
    chosen = {"type": parameters.type}
    flat = parameters.to_mapping()
    # ROS has no type for an empty array
    chosen |= {name: value for name, value in flat.items() if name.startswith(replaced) and value != ()}
    found = {"type": chosen.pop("type")} | kept | chosen
    return {name: tuple(value) if isinstance(value, list) else value for name, value in found.items()}


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
    comment = "".join(f"# {line}\n" for line in header.splitlines())
    full = f"{namespace}/{NODE}"
    root = yaml.compose(configuration.text)
    sections = [(key, value) for key, value in root.value if _belongs(key.value, full)]
    lines = configuration.text.splitlines(keepends=True)
    kept = 0
    while lines[kept].startswith(HEADERS):
        kept += 1
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += "\n"
    if not sections:
        section = dump_configuration({f"/**{full}": designed_values(configuration.node(NODE, namespace), parameters)})
        text = comment + "".join(lines[kept:]) + "\n" + section
    else:
        key, value = sections[-1]
        before = next(flat for pattern, flat in reversed(configuration.entries) if pattern == key.value)
        section = dump_configuration({key.value: designed_values(before, parameters)})
        first, end = key.start_mark.line, min(value.end_mark.line, len(lines))
        while end > first + 1 and (not lines[end - 1].strip() or lines[end - 1].startswith("#")):
            end -= 1
        text = comment + "".join(lines[kept:first]) + section + "".join(lines[end:])
    parse_configuration(text, "the designed file")
    return text


def _belongs(pattern: str, full: str) -> bool:
    return pattern.rsplit("/", 1)[-1] == NODE and matches(pattern, full)
