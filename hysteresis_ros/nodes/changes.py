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
was lost comes again only with the next one, or after seconds.
"""

from __future__ import annotations

import json

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
            self._publisher.publish(String(data=json.dumps({**entry, "number": self._number})))

    def end(self, sample: int) -> None:
        """Say, once, that the run is over at a sample: no entry follows that belongs to it."""
        if not self._is_over:
            self._is_over = True
            self.publish({"sample": sample, "node": self._node, "action": ENDED, "parameters": {}})
