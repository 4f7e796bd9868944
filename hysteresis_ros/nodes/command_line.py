# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What the command line gives parameters by ``-p``: rcl lets sections of parameter files win over it in silence."""

from __future__ import annotations

import sys

from hysteresis_ros.bounded import BoundsError, read_yaml

#: Where the arguments for ROS begin and end.
BEGIN, END = "--ros-args", "--"
FLAGS = ("-p", "--param")


def assigned(name: str, full_name: str, arguments: list[str] | None = None) -> dict:
    """Return the values that ``-p [NODE:]NAME:=VALUE`` gives to parameters of a node; of several the last one counts.

    Parameters
    ----------
    name, full_name : str
        Of the node; either may stand before the colon.
    arguments : list of str, optional
        Command line; ``sys.argv`` by default.
    """
    values, ours, words = {}, False, iter(sys.argv if arguments is None else arguments)
    for word in words:
        if word in (BEGIN, END):
            ours = word == BEGIN
        elif ours and word in FLAGS:
            left, is_one, value = next(words, "").partition(":=")
            node, _, parameter = left.rpartition(":")
            if is_one and node in ("", name, full_name):
                values[parameter] = _value(value)
    return {parameter: value for parameter, value in values.items() if value is not None}


def _value(text: str):
    """Return a value as a parameter file would have it; unlike in YAML 1.1, 1e-6 is a number."""
    try:
        value = read_yaml(text)
    except BoundsError:
        return text
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    if isinstance(value, list):
        return [_value(item) if isinstance(item, str) else item for item in value]
    return value
