# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Done to the measurement: by a relay where there are messages, by the loop's own faults where there are none."""

from __future__ import annotations

import time

from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.nodes.campaign.rig import Rig
from hysteresis_ros.reliability.bounds import Bounds
from hysteresis_ros.reliability.mishaps import Mishap

#: Seconds of the axis after which the faults of a fused loop begin: it has started and moved by then.
SCHEDULE = 12.0
#: Seconds for which something is done to the measurement, and after its time-out.
LASTING, FURTHER = 3.0, 0.5


def _lasts(mishap: Mishap, bounds: Bounds) -> float:
    """Return for how long it is done [s]: until the voltage has had the time to become safe, where it must."""
    return bounds.timeouts[mishap.safe] + FURTHER if mishap.safe else LASTING


def scheduled(axis: AxisParameters, mishap: Mishap, amount: float, bounds: Bounds) -> AxisParameters:
    """Return a fused axis to whose measurement it is done by itself.

    Parameters
    ----------
    axis : AxisParameters
    mishap : Mishap
    amount : float
    bounds : Bounds
    """
    rate = axis.plant_simulator.sample_rate
    value = {"late": max(round(amount * rate), 1), "spike": amount * bounds.stroke, "drop": amount}.get(mishap.fault)
    end = "" if value is None else f":{value:.9g}"
    return axis.with_faults((f"{mishap.fault}:{SCHEDULE:g}:{_lasts(mishap, bounds):g}{end}",))


def measure(rig: Rig, mishap: Mishap, amount: float) -> None:
    """Let the measurement go wrong for some time.

    Parameters
    ----------
    rig : Rig
    mishap : Mishap
        Its victim is what a relay does, its fault what the loop does.
    amount : float
    """
    lasts = _lasts(mishap, rig.bounds)
    if rig.relay is not None:
        rig.relay.set(mishap.victim, amount)
        _move(rig, mishap, lasts)
        rig.relay.set("")
        return
    rate = rig.axis.plant_simulator.sample_rate
    if not rig.witness.until(lambda: rig.witness.sample(rate) >= SCHEDULE * rate, SCHEDULE + LASTING):
        rig.broken.append("the time of the axis stands still")
    rig.begun = time.time()
    _move(rig, mishap, lasts)


def _move(rig: Rig, mishap: Mishap, lasts: float) -> None:
    """Let the axis move while it lasts, unless the voltage has to become safe."""
    until = time.monotonic() + lasts
    while (left := until - time.monotonic()) > 0.0:
        if not mishap.safe:
            rig.ask(rig.anywhere())
        time.sleep(min(left, 0.5))
