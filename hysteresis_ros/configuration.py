# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Configuration files: ROS 2 parameter files, read here by the same rules as the nodes read them."""

from __future__ import annotations

import difflib
import os
import pathlib
import re
from dataclasses import dataclass, replace

import yaml

from hysteresis_ros.bounded import BoundsError, read_text, read_yaml
from hysteresis_ros.errors import ConfigurationError, did_you_mean, shortened

#: The nodes every axis has.
NODE_NAMES = ("plant_simulator", "reference_generator", "motion_controller", "hysteresis_compensator")
#: Nodes an axis may have besides.
OPTIONAL_NODE_NAMES = ("recorder", "inchworm_sequencer", "displacement_camera")


def node_names(inchworm: bool) -> tuple[str, ...]:
    """Return the names of the nodes every axis has; an inchworm's sequencer stands for the reference generator."""
    return tuple("inchworm_sequencer" if inchworm and name == "reference_generator" else name for name in NODE_NAMES)


class _Loader(yaml.SafeLoader):
    """YAML as the ROS parameter parser reads it: ``5e-6`` is a number (YAML 1.1 wants ``5.0e-6``).

    A key that stands twice in a mapping is refused: of two values one would be lost without a word.
    """

    def construct_mapping(self, node, deep: bool = False) -> dict:
        """Return the dictionary of a mapping whose keys are all different."""
        lines: dict[str, int] = {}
        for key, _ in node.value:
            line = key.start_mark.line + 1
            if isinstance(key, yaml.ScalarNode) and lines.setdefault(key.value, line) != line:
                raise _RepeatedKeyError(key.value, lines[key.value], line)
        return super().construct_mapping(node, deep)


class _RepeatedKeyError(Exception):
    """A mapping has a key twice: its name and the lines."""


_Loader.yaml_implicit_resolvers = {
    first: [(tag, expression) for tag, expression in resolvers if tag != "tag:yaml.org,2002:float"]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"^[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))(?:[eE][-+]?[0-9]+)?$"
        r"|^[-+]?\.(?:inf|Inf|INF)$|^\.(?:nan|NaN|NAN)$"
    ),
    list("-+0123456789."),
)


@dataclass(frozen=True)
class Configuration:
    """A parameter file: patterns of node names with the parameters they set, in the order of the file.

    Parameters
    ----------
    entries : tuple of (str, dict)
        Pattern (``/**``, ``/**/plant_simulator``, ``/left/plant_simulator``) and flat dotted parameters.
    text : str
        The file as it was read.
    source : str
        Where it came from, for messages.
    """

    entries: tuple[tuple[str, dict], ...]
    text: str
    source: str

    def node(self, name: str, namespace: str = "") -> dict:
        """Return the flat parameters of one node; of several matching entries the later one wins, as in ROS."""
        full = f"{normalised_namespace(namespace)}/{name}"
        merged: dict = {}
        for pattern, values in self.entries:
            if matches(pattern, full):
                merged.update(values)
        return merged

    def describes(self, name: str, namespace: str = "") -> bool:
        """Tell whether the file has a section of the node called ``name`` itself, not only one for every node."""
        full = f"{normalised_namespace(namespace)}/{name}"
        return any(pattern.rsplit("/", 1)[-1] == name and matches(pattern, full) for pattern, _ in self.entries)

    def override(self, node: str, **values) -> Configuration:
        """Return a configuration in which ``node`` (in every namespace; ``""``: every node) has these values.

        Dots in parameter names are written as double underscores: ``waveform__type="hold"``.
        """
        pattern = f"/**/{node}" if node else "/**"
        flat = {name.replace("__", "."): value for name, value in values.items()}
        return replace(self, entries=(*self.entries, (pattern, flat)))

    def under(self, *others: Configuration) -> Configuration:
        """Return this configuration with others laid over it: what stands in a later one wins."""
        return replace(self, entries=(*self.entries, *(entry for other in others for entry in other.entries)))

    def namespaces(self) -> tuple[str, ...]:
        """Return the namespaces that the file names explicitly, in order; ``("",)`` when it names none."""
        found = []
        for pattern, _ in self.entries:
            parts = [part for part in pattern.split("/") if part]
            if "*" in pattern or not parts or parts[-1] not in NODE_NAMES + OPTIONAL_NODE_NAMES:
                continue
            namespace = normalised_namespace("/".join(parts[:-1]))
            if namespace not in found:
                found.append(namespace)
        return tuple(found) or ("",)


def normalised_namespace(namespace: str) -> str:
    """Return the namespace with one leading and no trailing slash; the root is the empty string."""
    stripped = namespace.strip("/")
    return f"/{stripped}" if stripped else ""


def matches(pattern: str, full_name: str) -> bool:
    """Tell whether a node's full name fits a pattern: ``**`` stands for any tokens, ``*`` for one."""
    if not pattern.startswith("/"):
        pattern = "/" + pattern
    expression = ""
    for token in pattern.split("/")[1:]:
        if token == "**":
            expression += "(?:/[^/]+)*"
        else:
            expression += "/" + "[^/]+".join(re.escape(part) for part in token.split("*"))
    return re.fullmatch(expression, full_name) is not None


def parse_value(text: str):
    """Return a value of a parameter from its text, read as in a file; what is no YAML stays a text.

    Parameters
    ----------
    text : str
    """
    try:
        return read_yaml(text, _Loader)
    except (BoundsError, _RepeatedKeyError):
        return text


def parse_configuration(text: str, source: str) -> Configuration:
    """Read a ROS 2 parameter file from its text.

    Raises
    ------
    ConfigurationError
        It is not YAML or not a ROS 2 parameter file; the message names the line or the entry.
    """
    try:
        document = read_yaml(text, _Loader)
    except BoundsError as error:
        raise ConfigurationError(f"{source}: {error}") from None
    except _RepeatedKeyError as error:
        key, first, second = error.args
        raise ConfigurationError(
            f"{source}: line {second}: '{key}' stands in line {first} already; keep one of them"
        ) from None
    if not isinstance(document, dict):
        raise ConfigurationError(
            f"{source}: empty, or no ROS 2 parameter file (node names at the top level are missing)"
        )
    entries: list[tuple[str, dict]] = []
    for name, content in document.items():
        _collect(str(name), content, source, entries)
    if not entries:
        raise ConfigurationError(
            f"{source}: no 'ros__parameters' anywhere; write '/**/plant_simulator: ros__parameters: …'"
        )
    for pattern, _ in entries:
        _refuse_misspelled(pattern.rsplit("/", 1)[-1], source)
    return Configuration(tuple(entries), text, source)


def _refuse_misspelled(name: str, source: str) -> None:
    """A section of a node that nobody has is passed over, as in ROS; one that is nearly a node's name is a mistake."""
    known = NODE_NAMES + OPTIONAL_NODE_NAMES
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.8)
    if close and name not in known:
        raise ConfigurationError(f"{source}: there is no node '{name}'; did you mean {close[0]}?")


def _collect(name: str, content, source: str, entries: list) -> None:
    if not isinstance(content, dict):
        raise ConfigurationError(f"{source}: '{name}' must hold 'ros__parameters', found {shortened(content)}")
    for key, value in content.items():
        if key == "ros__parameters":
            if not isinstance(value, dict):
                found = shortened(value)
                raise ConfigurationError(f"{source}: 'ros__parameters' of '{name}' must be a mapping, found {found}")
            entries.append((name, _flatten(value, source)))
        else:
            _collect(f"{name}/{key}", value, source, entries)


def _flatten(mapping: dict, source: str, prefix: str = "") -> dict:
    flat: dict = {}
    for key, value in mapping.items():
        name = f"{prefix}{key}"
        found = _flatten(value, source, f"{name}.") if isinstance(value, dict) else {name: value}
        twice = sorted(flat.keys() & found.keys())
        if twice:
            raise ConfigurationError(
                f"{source}: '{twice[0]}' stands twice in one section, nested and with dots; keep one of them"
            )
        flat.update(found)
    return flat


def shipped_configurations() -> dict[str, pathlib.Path]:
    """Return the parameter files that come with the package by their names, such as ``kim2009``."""
    package = pathlib.Path(__file__).resolve().parent
    folders = [package.parent / "config"]
    prefixes = [*package.parents, *map(pathlib.Path, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))]
    folders += [prefix / "share" / package.name / "config" for prefix in prefixes]
    return {
        path.stem: path for folder in reversed(folders) if folder.is_dir() for path in sorted(folder.glob("*.yaml"))
    }


def config_path(name: str) -> pathlib.Path:
    """Return the parameter file of that name, such as ``kim2009``, which comes with the package.

    Raises
    ------
    ConfigurationError
        There is none of that name; the message lists what there is.
    """
    found = shipped_configurations()
    if name not in found:
        near = did_you_mean(name, found)
        raise ConfigurationError(
            f"no configuration '{name}' comes with the package; there are: {', '.join(found) or 'none'}{near}"
        )
    return found[name]


def load_configuration(path) -> Configuration:
    """Read a ROS 2 parameter file: a path, or the bare name of a file that comes with the package (``kim2009``).

    A ``driver`` that is a relative path may lead from the folder of the file; nodes get it as a whole path.

    Raises
    ------
    ConfigurationError
        The file is missing or unreadable, or see :func:`parse_configuration`.
    """
    path = pathlib.Path(path)
    if not path.exists() and path.name == path.stem == str(path):
        path = config_path(path.name)
    try:
        text = read_text(path)
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: no such file; give the path of a ROS 2 parameter file") from None
    except (OSError, UnicodeDecodeError, BoundsError) as error:
        raise ConfigurationError(f"{path}: cannot be read: {error}") from None
    configuration = parse_configuration(text, str(path))
    return replace(configuration, entries=tuple(_with_driver_beside(path, *entry) for entry in configuration.entries))


def _with_driver_beside(path: pathlib.Path, pattern: str, values: dict) -> tuple[str, dict]:
    """Return an entry whose driver, where it is a relative path that leads from the file to one, has a whole path."""
    name = values.get("driver")
    beside = path.absolute().parent / name if isinstance(name, str) and "/" in name else None
    return pattern, {**values, "driver": str(beside)} if beside is not None and beside.is_file() else values


class _Dumper(yaml.SafeDumper):
    """YAML that both parsers read as the same numbers: every double keeps its point, and nothing is aliased."""

    def ignore_aliases(self, data) -> bool:
        """Write every value out, also one that stands in several places: ROS reads no aliases."""
        return True


def _represent_float(dumper, value):
    text = repr(float(value))
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


_Dumper.add_representer(float, _represent_float)
_Dumper.add_representer(
    tuple, lambda dumper, value: dumper.represent_sequence("tag:yaml.org,2002:seq", list(value), flow_style=True)
)


def dump_configuration(nodes: dict[str, dict]) -> str:
    """Return the text of a parameter file.

    Parameters
    ----------
    nodes : dict of str to dict
        Full node name or pattern → flat dotted parameters (values exactly representable: floats are written by
        ``repr`` and come back bit for bit).
    """
    document = {}
    for name, flat in nodes.items():
        tree: dict = {}
        for dotted, value in flat.items():
            *groups, last = dotted.split(".")
            branch = tree
            for part in groups:
                branch = branch.setdefault(part, {})
            branch[last] = value
        document[name] = {"ros__parameters": tree}
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=118, default_flow_style=False)
