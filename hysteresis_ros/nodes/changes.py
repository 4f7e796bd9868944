# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The log of what a node is set to, and of what people change while it runs, on the topic ``changes``.

Entries are numbered, so that a recorder knows which it lacks, and the last one says that a run is over: a message that
was lost comes again only with the next one, or after seconds. A recorder in the process of a fused loop takes entries
where they are made, as it takes the samples: by message they would come after them, or never when the process ends.
"""

from __future__ import annotations

import json
from collections import deque

from std_msgs.msg import String

from hysteresis_ros.signals import CONFIGURED, ENDED


class ChangeLog:
    """What one node says on ``changes``; nothing before :meth:`open`.

    Parameters
    ----------
    node : str
        Its kind.
    """

    def __init__(self, node: str):
        self._node = node
        self._entries: deque[str] = deque()
        self._made = 0
        self.close()

    def open(self, publisher, parameters: dict) -> None:
        """Begin with the parameters that the node is configured with.

        Parameters
        ----------
        publisher : rclpy.publisher.Publisher
            Of String, transient-local.
        parameters : dict
            Flat dotted names.
        """
        self._publisher, self._number, self._is_over = publisher, 0, False
        self._entries = deque(maxlen=publisher.qos_profile.depth)
        self.publish({"sample": 0, "node": self._node, "action": CONFIGURED, "parameters": parameters})

    def close(self) -> None:
        """Say nothing any more."""
        self._publisher, self._number, self._is_over = None, 0, False

    def publish(self, entry: dict) -> None:
        """Publish an entry.

        Parameters
        ----------
        entry : dict
            Sample, node, action and parameters.
        """
        if self._publisher is not None:
            self._number += 1
            text = json.dumps({**entry, "number": self._number})
            self._entries.append(text)
            self._made += 1
            self._publisher.publish(String(data=text))

    def since(self, made: int) -> tuple[list[str], int]:
        """Return the entries after the first so many, as JSON, and how many there are by now.

        Parameters
        ----------
        made : int
            What was returned before; 0: all that are still published.
        """
        new = min(self._made - made, len(self._entries))
        return list(self._entries)[len(self._entries) - new :], self._made

    def end(self, sample: int, stopped: bool = False) -> None:
        """Say, once, that the run is over at a sample: no entry follows that belongs to it.

        Parameters
        ----------
        sample : int
            Number of the next sample.
        stopped : bool
            Whether somebody has ended it before its time.
        """
        if not self._is_over:
            self._is_over = True
            told = {"stopped": True} if stopped else {}
            self.publish({"sample": sample, "node": self._node, "action": ENDED, "parameters": {}, **told})
