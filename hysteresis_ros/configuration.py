# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parameters and parameter files: one dataclass per block, which maps 1:1 to a ROS 2 parameter file.

A block's parameters are a frozen dataclass derived from :class:`Parameters`; every field is declared by
:func:`parameter` (a value) or :func:`group` (a nested dataclass). The table of these fields serves the offline
simulation, the declaration of ROS parameters and the generated documentation.
"""

from __future__ import annotations

import difflib
import itertools
import math
import os
import pathlib
import re
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from functools import lru_cache
from typing import Any, ClassVar, get_type_hints

import yaml

from hysteresis_ros.errors import (
    ConfigurationError,
    HysteresisError,
    ParameterError,
    Problem,
    did_you_mean,
    shortened,
)
from hysteresis_ros.files import FAST_DUMPER, FAST_LOADER, BoundsError, read_text, read_yaml, write_text

#: Types of a ROS 2 parameter and their names for users.
TYPE_NAMES = {
    float: "double",
    int: "integer",
    bool: "bool",
    str: "string",
    tuple[float, ...]: "double array",
    tuple[str, ...]: "string array",
}


#: Maximum length of an array [elements].
MOST_ITEMS = 100_000
#: Maximum length of a text [characters].
LONGEST_TEXT = 4096

#: Parameter types with tuples as values.
ARRAY_TYPES = (tuple[float, ...], tuple[str, ...])


@dataclass(frozen=True)
class ParameterRow:
    """One line of the parameter table (name, type, default, unit, range, description, read_only)."""

    name: str
    type: Any
    default: Any
    unit: str
    low: float | None
    high: float | None
    choices: tuple[str, ...] | None
    description: str
    read_only: bool
    required: bool
    paths: bool = False
    place: str = ""

    @property
    def type_name(self) -> str:
        """Name of the type in ROS 2."""
        return TYPE_NAMES[self.type]

    def allowed(self) -> str:
        """Return the allowed values as a text, for error messages and documentation."""
        unit = f" {self.unit}" if self.unit else ""
        text = self.type_name
        if self.choices:
            text += ", one of " + ", ".join(choice or "''" for choice in self.choices)
            text += ", or a path with a /" if self.paths else ""
        elif self.low is not None and self.high is not None:
            text += f" in {self.low:g} … {self.high:g}{unit}"
        elif self.low is not None:
            text += f" ≥ {self.low:g}{unit}"
        elif self.high is not None:
            text += f" ≤ {self.high:g}{unit}"
        elif unit:
            text += f" in{unit}"
        return text

    def convert(self, value):
        """Return ``value`` in this row's type, or raise ParameterError naming the parameter and what is allowed.

        Integers are accepted where a double is required (``0`` for ``0.0``); nothing else is converted.
        """
        try:
            converted = _convert(self.type, value)
        except (TypeError, OverflowError):  # an integer may be too large for a double
            raise ParameterError([Problem(self.name, value, f"wrong type, allowed: {self.allowed()}")]) from None
        items = converted if isinstance(converted, tuple) else (converted,)
        longest = max((len(item) for item in items if isinstance(item, str)), default=0)
        if len(items) > MOST_ITEMS or longest > LONGEST_TEXT:
            remedy = f"too long, allowed: {MOST_ITEMS} elements, of {LONGEST_TEXT} characters each"
            raise ParameterError([Problem(self.name, value, remedy)])
        for item in items:
            if isinstance(item, float) and not math.isfinite(item):
                raise ParameterError([Problem(self.name, value, f"must be finite, allowed: {self.allowed()}")])
            if isinstance(item, (int, float)) and not isinstance(item, bool):
                below = self.low is not None and item < self.low
                above = self.high is not None and item > self.high
                if below or above:
                    raise ParameterError([Problem(self.name, value, f"out of range, allowed: {self.allowed()}")])
            if self.choices and item not in self.choices and not (self.paths and "/" in item):
                near = did_you_mean(item, self.choices)
                raise ParameterError([Problem(self.name, value, f"unknown choice, allowed: {self.allowed()}{near}")])
        return converted


def _convert(kind, value):
    if kind is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value)
    if kind is int and isinstance(value, int) and not isinstance(value, bool):
        return value
    if kind is bool and isinstance(value, bool):
        return value
    if kind is str and isinstance(value, str):
        return value
    if kind in ARRAY_TYPES and not isinstance(value, (str, bytes)):
        try:
            items = list(value)
        except TypeError:
            raise TypeError from None
        item_kind = float if kind == tuple[float, ...] else str
        return tuple(_convert(item_kind, item) for item in items)
    raise TypeError


def parameter(
    default=MISSING,
    *,
    description: str,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] | None = None,
    read_only: bool = False,
    paths: bool = False,
    place: str = "",
) -> Any:
    """Declare one parameter of a block as a dataclass field."""
    required = default is MISSING
    metadata = dict(description=description, unit=unit, low=low, high=high, choices=choices, paths=paths)
    metadata |= dict(read_only=read_only, required=required, place=place)
    return field(default=None if required else default, metadata=metadata)


def group(cls, *, variant_of: str | None = None) -> Any:
    """Nest another parameter dataclass; its YAML names get this field's name as prefix.

    With ``variant_of="type"`` the group is checked only when the field ``type`` of the same dataclass equals this
    field's name: a file may keep the parameters of several models and choose one of them.
    """
    return field(default_factory=cls, metadata=dict(group=cls, variant_of=variant_of))


def variants(chooser: str, choices: dict[str, type]):
    """Return a class decorator that nests one group for each allowed value of the parameter ``chooser``.

    Write it under ``@dataclass(frozen=True)``. It allows a registry to supply the groups of a class.
    """

    def add(cls):
        for name, variant in choices.items():
            cls.__annotations__[name] = variant
            setattr(cls, name, group(variant, variant_of=chooser))
        return cls

    return add


#: Cache of evaluated annotations, because annotations are strings and evaluating them at every look-up is slow.
_type_hints: Callable[[type], dict[str, Any]] = lru_cache(maxsize=None)(get_type_hints)


def _rows(cls: type[Parameters], prefix: str) -> tuple[ParameterRow, ...]:
    """Return the rows of a dataclass and its groups."""
    hints = _type_hints(cls)
    rows: list[ParameterRow] = []
    for item in fields(cls):
        nested = item.metadata.get("group")
        if nested is not None:
            rows += nested.table(f"{prefix}{item.name}.")
        else:
            row = ParameterRow(name=prefix + item.name, type=hints[item.name], default=item.default, **item.metadata)
            rows.append(row)
    return tuple(rows)


_table: Callable[[type, str], tuple[ParameterRow, ...]] = lru_cache(maxsize=None)(_rows)


class Parameters:
    """Base of all parameter dataclasses. Subclasses are ``@dataclass(frozen=True)``."""

    __dataclass_fields__: ClassVar[dict[str, Field]]

    @classmethod
    def table(cls, prefix: str = "") -> list[ParameterRow]:
        """Return all rows of this dataclass and its groups, with dotted names."""
        return list(_table(cls, prefix))

    @classmethod
    def from_mapping(cls, mapping, prefix: str = ""):
        """Build and check the parameters from a flat mapping of dotted names to values."""
        rows = {row.name: row for row in cls.table()}
        problems, values = [], {}
        for name, value in mapping.items():
            row = rows.get(name)
            if row is None:
                close = difflib.get_close_matches(name, rows, n=1)
                hint = f"did you mean {prefix}{close[0]}?" if close else "remove it or see the parameter table"
                problems.append(Problem(prefix + name, value, f"unknown parameter; {hint}"))
                continue
            try:
                values[name] = replace(row, name=prefix + name).convert(value)
            except ParameterError as error:
                problems += error.problems
        result = cls._assemble(values)
        if not problems:
            problems += result.problems(prefix)
        if problems:
            raise ParameterError(problems)
        return result._valid()

    @classmethod
    def _assemble(cls, values: dict):
        arguments = {}
        for item in fields(cls):
            nested = item.metadata.get("group")
            if nested is not None:
                start = item.name + "."
                part = {name[len(start) :]: value for name, value in values.items() if name.startswith(start)}
                arguments[item.name] = nested._assemble(part)
            elif item.name in values:
                arguments[item.name] = values[item.name]
        return cls(**arguments)

    def with_values(self, values, prefix: str = ""):
        """Return the parameters with some values changed, built and checked as by :meth:`from_mapping`.

        Unchanged values are not converted again, so this is ten times as fast as :meth:`from_mapping`.
        """
        result = self._changed(values)
        problems = result.problems(prefix)
        if problems:
            raise ParameterError(problems)
        return result._valid()

    def _changed(self, values):
        groups: dict[str, dict] = {}
        for name, value in values.items():
            first, _, rest = name.partition(".")
            groups.setdefault(first, {})[rest] = value
        given = {
            first: part[""] if "" in part else getattr(self, first)._changed(part) for first, part in groups.items()
        }
        return replace(self, **given)

    def problems(self, prefix: str = "") -> list[Problem]:
        """Return everything that is missing or inconsistent, with full names; empty when there is no problem."""
        if self.__dict__.get("_is_valid"):
            return []
        found = []
        for item in fields(self):
            nested = item.metadata.get("group")
            value = getattr(self, item.name)
            if nested is not None:
                chooser = item.metadata.get("variant_of")
                if chooser is None or getattr(self, chooser) == item.name:
                    found += value.problems(f"{prefix}{item.name}.")
            elif value is None:
                row = next(row for row in self.table() if row.name == item.name)
                found.append(Problem(prefix + item.name, None, f"missing; give a {row.allowed()}"))
        if not found:
            found += [replace(problem, name=prefix + problem.name) for problem in self.check()]
        return found

    def check(self):
        """Yield a Problem for every inconsistency between parameters; overridden by classes that have such rules."""
        return ()

    def warnings(self, prefix: str = "") -> tuple[str, ...]:
        """Return the warnings about allowed values, one sentence each, including those of the groups in use."""
        found = []
        for item in fields(self):
            chooser = item.metadata.get("variant_of")
            if item.metadata.get("group") is not None and (chooser is None or getattr(self, chooser) == item.name):
                found += getattr(self, item.name).warnings(f"{prefix}{item.name}.")
        return tuple(found)

    def validated(self, prefix: str = ""):
        """Return self, or raise ParameterError with all problems. For parameters that a user builds in Python."""
        if self.__dict__.get("_is_valid"):
            return self
        problems = self._unfit(prefix) or self.problems(prefix)
        if problems:
            raise ParameterError(problems)
        return self._valid()

    def _valid(self):
        """Return self, marked as free of problems.

        The object is immutable, so the mark remains valid. It makes parameter changes at run time fast. Groups
        that are not in use have not been checked.
        """
        for item in fields(self):
            chooser = item.metadata.get("variant_of")
            if item.metadata.get("group") is not None and (chooser is None or getattr(self, chooser) == item.name):
                group_ = getattr(self, item.name)
                if not group_.__dict__.get("_is_valid"):
                    group_._valid()
        self.__dict__["_is_valid"] = True
        return self

    def _unfit(self, prefix: str) -> list[Problem]:
        """Return a Problem for each value that its row does not allow."""
        found: list[Problem] = []
        rows = {row.name: row for row in _table(type(self), "") if "." not in row.name}
        for item in fields(self):
            value = getattr(self, item.name)
            if item.metadata.get("group") is not None:
                found += [] if value.__dict__.get("_is_valid") else value._unfit(f"{prefix}{item.name}.")
            elif value is not None:
                try:
                    rows[item.name].convert(value)
                except ParameterError as error:
                    found += [replace(problem, name=prefix + item.name) for problem in error.problems]
        return found

    def to_mapping(self) -> dict:
        """Return the flat mapping of dotted names to values; parameters without a value are left out."""
        flat = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if item.metadata.get("group") is not None:
                flat.update({f"{item.name}.{name}": inner for name, inner in value.to_mapping().items()})
            elif value is not None:
                flat[item.name] = value
        return flat


#: Nodes of every axis.
NODE_NAMES = ("plant_simulator", "reference_generator", "motion_controller", "hysteresis_compensator")
#: Optional nodes of an axis.
OPTIONAL_NODE_NAMES = ("recorder", "inchworm_sequencer", "displacement_camera")
#: Section of a stage of coupled axes.
STAGE = "stage"
#: Names that a section of a file may have.
KNOWN_NAMES = (*NODE_NAMES, *OPTIONAL_NODE_NAMES, STAGE)
#: Suffixes of parameter files.
SUFFIXES = (".yaml", ".yml")
#: Suffixes of recordings, which are not text files.
RECORDED = (".npz", ".mcap", ".db3")


class _Loader(FAST_LOADER):
    """YAML as the ROS parameter parser reads it: ``5e-6`` is a number (YAML 1.1 requires ``5.0e-6``).

    A duplicate key in a mapping is refused, because one of its two values would be lost silently.
    """

    def construct_mapping(self, node, deep: bool = False) -> dict:
        """Return the dictionary of a mapping with unique keys."""
        lines: dict[str, int] = {}
        for key, _ in node.value:
            line = key.start_mark.line + 1
            if isinstance(key, yaml.ScalarNode) and lines.setdefault(key.value, line) != line:
                raise _RepeatedKeyError(key.value, lines[key.value], line)
        return super().construct_mapping(node, deep)


class _RepeatedKeyError(Exception):
    """A mapping has a duplicate key; the arguments are its name and both lines."""


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
    original : str
        The file as it was read, without changes by :meth:`override`.
    source : str
        Origin of the text, for messages.
    """

    entries: tuple[tuple[str, dict], ...]
    original: str
    source: str

    @property
    def text(self) -> str:
        """Text of a parameter file with the present content: the file as it was read, unless values were changed."""
        if self.original and parse_configuration(self.original, self.source).entries == self.entries:
            return self.original
        plain = [
            (pattern, {name: value.tolist() if hasattr(value, "tolist") else value for name, value in values.items()})
            for pattern, values in self.entries
        ]
        merged: dict[str, dict] = {}
        for pattern, values in plain:
            for other in [other for other in merged if _covers(pattern, other)]:
                merged[other] = {name: value for name, value in merged[other].items() if name not in values}
            merged.setdefault(pattern, {}).update(values)
        meant, written = (replace(self, entries=tuple(entries)) for entries in (plain, merged.items()))
        for name, namespace in itertools.product(KNOWN_NAMES, ("", *self.namespaces())):
            if written.node(name, namespace) != meant.node(name, namespace):
                raise ConfigurationError(
                    f"{self.source}: changed values of {name} cannot be written, because a section after it sets them "
                    "too; write the section '/**' before the sections of the nodes"
                )
        return dump_configuration(merged)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the present content, including changed values, as a parameter file; the write is atomic.

        Parameters
        ----------
        path : path-like
            A ``.yaml`` or ``.yml`` file; an existing file is replaced.

        Raises
        ------
        ConfigurationError
            The file has another suffix, or cannot be written.

        Examples
        --------
        >>> import hysteresis_ros as hr
        >>> hr.load("kim2009").override("motion_controller", type="open_loop").save("open.yaml")  # doctest: +SKIP
        """
        save_parameter_file(path, self.text, ConfigurationError)

    def node(self, name: str, namespace: str = "") -> dict:
        """Return the flat parameters of one node; the last matching entry wins, as in ROS."""
        full = f"{normalised_namespace(namespace)}/{name}"
        merged: dict = {}
        for pattern, values in self.entries:
            if matches(pattern, full):
                merged.update(values)
        return merged

    def describes(self, name: str, namespace: str = "") -> bool:
        """Return whether the file has a section for the node ``name`` itself, not only a section for all nodes."""
        full = f"{normalised_namespace(namespace)}/{name}"
        return any(pattern.rsplit("/", 1)[-1] == name and matches(pattern, full) for pattern, _ in self.entries)

    def override(self, node: str, **values) -> Configuration:
        """Return a configuration in which ``node`` (in every namespace; ``""``: every node) has these values.

        With a slash at the beginning, ``node`` is a complete name or a pattern, as in the sections of a file. Dots in
        parameter names are written as double underscores: ``waveform__type="hold"``. A node that is neither a node of
        an axis nor a section of this file is refused.
        """
        name, sections = node.rsplit("/", 1)[-1], {pattern.rsplit("/", 1)[-1] for pattern, _ in self.entries}
        if name and "*" not in name and name not in sections.union(KNOWN_NAMES):
            near = did_you_mean(name, KNOWN_NAMES) or f"; there are {', '.join(KNOWN_NAMES)}"
            raise ConfigurationError(f"{self.source}: there is no node '{name}'{near}")
        pattern = node if node.startswith("/") else f"/**/{node}" if node else "/**"
        named = [f"{space}/{name}" for space in self.namespaces()]
        if node.startswith("/") and "*" not in node and node not in (*named, *(entry for entry, _ in self.entries)):
            raise ConfigurationError(f"{self.source}: there is no node '{node}'; there are {', '.join(named)}")
        flat = {name.replace("__", "."): value for name, value in values.items()}
        return replace(self, entries=(*self.entries, (pattern, flat)))

    def under(self, *others: Configuration) -> Configuration:
        """Return this configuration overlaid with others; values of later configurations win."""
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

    @property
    def stage(self) -> str | None:
        """Namespace of the stage of coupled axes that the file describes; None: its axes are independent."""
        found = []
        for pattern, _ in self.entries:
            *space, name = [part for part in pattern.split("/") if part] or [""]
            if name == STAGE:
                found.append(normalised_namespace("" if "*" in pattern else "/".join(space)))
        others = [space for space in found if space != found[0]]
        if others:
            raise ConfigurationError(
                f"{self.source}: two stages, {found[0]}/{STAGE} and {others[0]}/{STAGE}: a file may describe only one"
            )
        return found[0] if found else None

    def require_independent(self) -> None:
        """Refuse a file with coupled axes, or with their structure alone; for callers that need a single axis."""
        if self.stage is not None:
            raise ConfigurationError(
                f"{self.source}: describes a stage of coupled axes, but a single axis is needed here: the axes of a "
                "stage run together, in `hysteresis simulate`, `up`, `design`, `excite`, `identify` and `commission` "
                "only (docs/coupled_axes.md)"
            )
        plants = [values for pattern, values in self.entries if pattern.rsplit("/", 1)[-1] == "plant_simulator"]
        if any(name.startswith("structure.") for values in plants for name in values):
            raise ConfigurationError(
                f"{self.source}: is the structure of coupled axes alone, as hr.identify_structure saves it, without "
                "axes and controllers; hr.identify with columns=hr.StageColumns(…), or `hysteresis identify`, writes a "
                "complete stage (docs/coupled_identification.md)"
            )


def normalised_namespace(namespace: str) -> str:
    """Return the namespace with one leading and no trailing slash; the root is the empty string."""
    stripped = namespace.strip("/")
    return f"/{stripped}" if stripped else ""


def matches(pattern: str, full_name: str) -> bool:
    """Return whether a node's full name matches a pattern: ``**`` matches any number of tokens, ``*`` one."""
    if not pattern.startswith("/"):
        pattern = "/" + pattern
    expression = ""
    for token in pattern.split("/")[1:]:
        if token == "**":
            expression += "(?:/[^/]+)*"
        else:
            expression += "/" + "[^/]+".join(re.escape(part) for part in token.split("*"))
    return re.fullmatch(expression, full_name) is not None


def _covers(pattern: str, other: str) -> bool:
    """Return whether a pattern of :meth:`Configuration.override` matches all nodes that another pattern matches."""
    return pattern.startswith("/**") and f"/{other.lstrip('/')}".endswith(pattern.removeprefix("/**"))


def save_parameter_file(path: str | os.PathLike[str], text: str, error: type[HysteresisError]) -> None:
    """Write a parameter file atomically; refuse a suffix with which it would not be read again."""
    if pathlib.Path(path).suffix.lower() not in SUFFIXES:
        raise error(f"{path}: a parameter file is YAML: its name must end in {' or '.join(SUFFIXES)}")
    write_text(path, text, error)


def parse_value(text: str):
    """Return a parameter value from its text, read as in a file; a text that is not YAML is returned unchanged."""
    try:
        return read_yaml(text, _Loader)
    except (BoundsError, _RepeatedKeyError):
        return text


def parse_configuration(text: str, source: str) -> Configuration:
    """Read a ROS 2 parameter file from its text."""
    try:
        document = read_yaml(text, _Loader)
    except BoundsError as error:
        raise ConfigurationError(f"{source}: {error}") from None
    except _RepeatedKeyError as error:
        key, first, second = error.args
        raise ConfigurationError(
            f"{source}: line {second}: '{key}' is already in line {first}; keep one of them"
        ) from None
    if not isinstance(document, dict):
        raise ConfigurationError(
            f"{source}: empty, or not a ROS 2 parameter file (node names at the top level are missing)"
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
    """Ignore the section of an unknown node, as ROS does, but refuse a name that is almost the name of a node."""
    close = difflib.get_close_matches(name, KNOWN_NAMES, n=1, cutoff=0.8)
    if close and name not in KNOWN_NAMES:
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
                f"{source}: '{twice[0]}' occurs twice in one section, nested and with dots; keep one of them"
            )
        flat.update(found)
    return flat


def shipped_configurations() -> dict[str, pathlib.Path]:
    """Return the parameter files of the package by name, such as ``kim2009``."""
    package = pathlib.Path(__file__).resolve().parent
    folders = [package.parent / "config"]
    prefixes = [*package.parents, *map(pathlib.Path, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))]
    folders += [prefix / "share" / package.name / "config" for prefix in prefixes]
    return {
        path.stem: path for folder in reversed(folders) if folder.is_dir() for path in sorted(folder.glob("*.yaml"))
    }


def config_path(name: str) -> pathlib.Path:
    """Return the parameter file of the package with this name, such as ``kim2009``."""
    found = shipped_configurations()
    if name not in found:
        near = did_you_mean(name, found)
        raise ConfigurationError(
            f"no configuration '{name}' comes with the package; there are: {', '.join(found) or 'none'}{near}"
        )
    return found[name]


def load_configuration(path) -> Configuration:
    """Read a ROS 2 parameter file: a path, or the bare name of a file that comes with the package (``kim2009``).

    A ``driver`` may be a path relative to the folder of the file; nodes get the absolute path.
    """
    if path == "":
        raise ConfigurationError("the path is empty: give a ROS 2 parameter file (.yaml), or the name of a shipped one")
    path = pathlib.Path(path)
    if not path.exists() and path.name == path.stem == str(path):
        path = config_path(path.name)
    try:
        text = read_text(path)
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: no such file; give the path of a ROS 2 parameter file") from None
    except (OSError, UnicodeDecodeError, BoundsError) as error:
        reason = f"cannot be read: {error}"
        if path.suffix.lower() in RECORDED or (path / "metadata.yaml").is_file():
            reason = "is a recording, not a parameter file; give the parameter file of its axis (.yaml)"
        elif isinstance(error, UnicodeDecodeError):
            reason = "is not a text in UTF-8; give the path of a ROS 2 parameter file (.yaml)"
        raise ConfigurationError(f"{path}: {reason}") from None
    configuration = parse_configuration(text, str(path))
    return replace(configuration, entries=tuple(_with_driver_beside(path, *entry) for entry in configuration.entries))


def _with_driver_beside(path: pathlib.Path, pattern: str, values: dict) -> tuple[str, dict]:
    """Return an entry of the file with the absolute path of its driver, if the path is relative."""
    name = values.get("driver")
    if not (isinstance(name, str) and "/" in name):
        return pattern, values
    return pattern, {**values, "driver": str(path.absolute().parent / name)}


class _Dumper(FAST_DUMPER):
    """YAML that PyYAML and ROS read as the same numbers: every double has a decimal point, and there are no aliases."""

    def ignore_aliases(self, data) -> bool:
        """Write every value out, because ROS does not read aliases."""
        return True


def _represent_float(dumper, value):
    text = repr(float(value))
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


_Dumper.add_representer(float, _represent_float)
# texts such as y and N are quoted, because the parser of ROS reads them as true and false (YAML 1.1)
_Dumper.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile("[yYnN]"), list("yYnN"))
_Dumper.add_representer(
    tuple, lambda dumper, value: dumper.represent_sequence("tag:yaml.org,2002:seq", list(value), flow_style=True)
)


def dump_configuration(nodes: dict[str, dict]) -> str:
    """Return the text of a parameter file."""
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
