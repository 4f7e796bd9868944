# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Done by people and programs: floods of setpoints, storms of parameters, calls in any order, a second sender."""

from __future__ import annotations

import math
import time

from std_msgs.msg import Float64

from hysteresis_ros.nodes.campaign.machine import busy
from hysteresis_ros.nodes.campaign.rig import Rig
from hysteresis_ros.reliability.mishaps import Mishap

#: Seconds for which something is done again and again, and the distance of two turns of it.
LONG, TURN = 3.0, 1e-3
#: Setpoints that are none; one in so many is such a one.
GARBAGE, GARBAGE_EVERY = (math.nan, math.inf, -math.inf, 1e300, -1.0), 7


def flood(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Publish setpoints as fast as that, garbage among them, while all cores are busy.

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
    amount : float
        Setpoints per second.
    """
    rig.asked += [rig.bounds.low, rig.bounds.high]
    message, sent, begun = Float64(), 0, time.monotonic()
    with busy():
        while (passed := time.monotonic() - begun) < LONG:
            while sent < passed * amount:
                sent += 1
                message.data = rig.anywhere() if sent % GARBAGE_EVERY else GARBAGE[sent % len(GARBAGE)]
                rig.witness.setpoints.publish(message)
            time.sleep(TURN)
    rig.notes.append(f"{sent / LONG:.0f} a second")
