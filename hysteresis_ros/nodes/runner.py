# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What all runners have in common: they decide when a node makes its part of a sample."""

from __future__ import annotations

from hysteresis_ros.nodes.timing import Pace


class Runner:
    """Base of the runners.

    Parameters
    ----------
    node : AxisNode
    """

    #: Period of a sample for the statistics of pace [s].
    period = float("inf")
    #: Whether the node makes its part of a sample when messages come.
    by_message = True
    #: Inputs of the node that came once and do not come any more, by topic.
    absent: tuple[str, ...] = ()
    #: Partner whose loss keeps this node's part of the loop safe until a person lets it go on; empty: none.
    latched = ""

    def __init__(self, node):
        self.node = node

    def require_rest(self) -> None:
        """Refuse that the node begins again now."""

    def make_pace(self) -> Pace:
        """Return what tells how regularly samples come."""
        return Pace(self.period)

    def missing_partners(self) -> str:
        """Name the nodes without which an axis cannot go on; empty: none is lost."""
        return ""

    def follow_trip(self, tripped: bool) -> None:
        """Take note whether the plant has stopped the axis."""

    def unlatch(self) -> str:
        """Let the part go on after the loss of a partner; return why it cannot, empty: it does."""
        return ""

    def timeliness(self) -> dict:
        """Return what diagnostics say about how late samples begin, where that is known."""
        return {}

    def go_safe(self) -> None:
        """Bring the outputs of the node to their safe values."""
        self.node.go_safe()
