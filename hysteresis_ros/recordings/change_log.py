# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The log of changes of a recording: what each node was set to, what people changed meanwhile, and what is missing."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field

from hysteresis_ros.bounded import read_json
from hysteresis_ros.recordings import cdr
from hysteresis_ros.recordings.bag_reader import Bag
from hysteresis_ros.signals import CONFIGURED, ENDED


@dataclass
class ChangeLog:
    """What stands in the log of an axis.

    Parameters
    ----------
    changes : list of dict
        What was changed, in order: sample, node, action, parameters.
    parameters : dict of str to dict
        Flat dotted parameters that each node was configured with, by its name.
    lacking : int
        Entries that are missing between others, by their numbers.
    stopped : bool
        Whether the nodes have kept a log that does not end with the end of the run: somebody has stopped them.
    """

    changes: list[dict] = field(default_factory=list)
    parameters: dict[str, dict] = field(default_factory=dict)
    lacking: int = 0
    stopped: bool = False
    _last: dict[str, int] = field(default_factory=dict)

    def take(self, entry: dict) -> None:
        """Take an entry."""
        node, action, number = str(entry.get("node")), entry.get("action"), entry.get("number")
        if isinstance(number, int):
            # a node that is configured anew begins with 1 again
            self.lacking += max(number - self._last.get(node, number - 1) - 1, 0)
            self._last[node] = number
        self.stopped = action != ENDED or entry.get("stopped") is True
        if action == CONFIGURED:
            self._configure(node, entry.get("parameters"))
        elif action != ENDED:
            self.changes.append(entry)

    def _configure(self, node: str, parameters) -> None:
        """Take the parameters of a node, as long as it has not been at work."""
        own = [entry for entry in self.changes if entry.get("node") == node]
        if isinstance(parameters, dict) and not any(entry.get("sample") for entry in own):
            self.parameters[node] = parameters
            # what was set before is in them
            self.changes = [entry for entry in self.changes if entry.get("node") != node]


def read_log(bag: Bag, prefix: str) -> ChangeLog:
    """Return the log of an axis; what cannot be read is left out.

    Parameters
    ----------
    bag : Bag
        The bag.
    prefix : str
        Namespace of the axis.
    """
    topic = bag.of_type(f"{prefix}/changes", cdr.STRING)
    log = ChangeLog()
    for text in cdr.decode_strings(topic.data, f"{prefix}/changes") if topic else ():
        with contextlib.suppress(ValueError):
            entry = read_json(text)
            if isinstance(entry, dict):
                log.take(entry)
    return log
