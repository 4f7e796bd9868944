# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Texts, YAML and JSON from outside, within bounds: no file makes its reader run out of memory, time or stack.

YAML is read by safe loaders only, which make plain values and nothing else. Aliases are refused, since a file of a
kilobyte can stand for gigabytes by them, and the parser of ROS 2 reads none either.
"""

from __future__ import annotations

import json
import pathlib
from typing import Any

import yaml

from hysteresis_ros.errors import HysteresisError

#: Largest text [bytes], most values in one, and how deep they may lie in each other.
LARGEST, MOST_VALUES, DEEPEST = 16 * 2**20, 50_000, 50

#: libyaml where PyYAML was built with it: six times as fast.
FAST_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

#: What constructors of YAML raise beside its own errors: for 2001-99-99, !!int x, a whole number of 5000 digits.
_UNFIT = (yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError, OverflowError)


class BoundsError(HysteresisError):
    """A text is too large, or no YAML or JSON, or holds more than is read; the message does not name the file."""


def read_text(path) -> str:
    """Return the text of a file in UTF-8.

    Parameters
    ----------
    path : path-like
        ``~`` stands for the home folder.

    Raises
    ------
    BoundsError
        It is larger than :data:`LARGEST`.
    OSError, UnicodeDecodeError
        It cannot be read.
    """
    with pathlib.Path(path).expanduser().open("rb") as stream:
        content = stream.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise BoundsError(f"is larger than {LARGEST // 2**20} MiB: no file of this kind is")
    return content.decode()


def read_yaml(text: str, loader: Any = FAST_LOADER, most: int = MOST_VALUES):
    """Return what a YAML text holds, as plain values.

    Parameters
    ----------
    text : str
    loader : type
        A safe loader.
    most : int
        Most values, mappings, lists and keys included.

    Raises
    ------
    BoundsError
        It is no YAML, has aliases, or is too large, too deep or too much.
    """
    if len(text) > LARGEST:
        raise BoundsError(f"is larger than {LARGEST // 2**20} MiB: no file of this kind is")
    try:
        _look_through(text, most)
        return yaml.load(text, Loader=loader)  # a safe one, see above
    except _UNFIT as error:
        if isinstance(error, BoundsError):
            raise
        raise BoundsError(f"not readable as YAML: {' '.join(str(error).split())}") from None


def read_json(text: str):
    """Return what a JSON text holds, as plain values.

    Parameters
    ----------
    text : str

    Raises
    ------
    BoundsError
        It is no JSON, or too deep.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BoundsError(f"not readable as JSON: {error}") from None


def _look_through(text: str, most: int) -> None:
    """Refuse what would be more than it looks, before anything is made of it."""
    values = depth = 0
    for event in yaml.parse(text, Loader=FAST_LOADER):
        if isinstance(event, yaml.AliasEvent):
            line = event.start_mark.line + 1
            raise BoundsError(f"line {line}: ROS 2 reads no YAML aliases (*{event.anchor}); write the values out")
        values += isinstance(event, yaml.NodeEvent)
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            line = event.start_mark.line + 1
            raise BoundsError(f"line {line}: more than {DEEPEST} mappings or lists within each other")
        if values > most:
            raise BoundsError(f"holds more than {most} values: no file of this kind does")
