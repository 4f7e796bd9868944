# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One axis to which things are done, one after the other, and what is seen of it."""

from __future__ import annotations

import math
import os
import pathlib
import time

import numpy as np

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.nodes.campaign.group import Group
from hysteresis_ros.nodes.campaign.relay import REMAP, Relay
from hysteresis_ros.nodes.campaign.surroundings import Clock, Device
from hysteresis_ros.nodes.campaign.witness import Witness
from hysteresis_ros.recordings.align import read_recording
from hysteresis_ros.reliability.bounds import REACHED, bounds_of
from hysteresis_ros.reliability.mishaps import FUSED, Mishap
from hysteresis_ros.reliability.trace import Samples, Trace

#: Seconds that an axis gets to start: at first it may be compiled, on a machine that is busy; and to start again, and
#: to follow a setpoint again.
FIRST_START, START, RECOVERY = 300.0, 60.0, 40.0
#: How often an axis is sent somewhere before it counts as one that does not run.
TRIES = 3
#: Seconds after which a setpoint is sent again: whoever was not there has not heard it.
AGAIN = 1.0
#: Seconds for which a place must be kept to be reached, and within which a mishap begins after a move has.
KEPT, MOVING = 0.1, 0.4
#: What nobody may print.
TRACEBACK = "Traceback (most recent call last)"


class Rig:
    """An axis that runs, and a witness.

    Parameters
    ----------
    axis : AxisParameters
        Prepared, see :func:`hysteresis_ros.reliability.bounds.prepared`.
    way : str
        Of :data:`hysteresis_ros.reliability.mishaps.WAYS`.
    folder : pathlib.Path
    random : numpy.random.Generator
    relayed : bool
        Whether a relay stands between the plant and the others.
    beside : Device or Clock, optional
        That ends with it.
    **options
        Of :class:`~hysteresis_ros.nodes.campaign.group.Group`.

    Raises
    ------
    HysteresisError
        The axis does not start.
    """

    def __init__(
        self,
        axis: AxisParameters,
        way: str,
        folder: pathlib.Path,
        random: np.random.Generator,
        relayed: bool = False,
        beside: Device | Clock | None = None,
        **options,
    ):
        self.beside = beside
        self.axis, self.way, self.random = axis, way, random
        self.bounds = bounds_of(axis)
        self.broken: list[str] = []
        self.notes: list[str] = []
        self.asked: list[float] = []
        self.starts = 0
        self.begun = math.nan
        self.group = Group(axis, way, folder, remap=REMAP if relayed else (), **options)
        self.witness = Witness(axis.namespace)
        self.relay = Relay(self.witness, self.bounds.stroke, random) if relayed else None
        self.witness.until(lambda: len(self.witness.rows) > 5 or self.group.died(), FIRST_START)
        if not self.witness.rows:
            self._give_up("does not start")
        self.rest = self.witness.displacement
        # four processes that start at once on a busy machine may be late at first
        if not any(self.follows() for _ in range(TRIES)):
            self._give_up("does not follow setpoints")

    def _give_up(self, what: str) -> None:
        """Say what is wrong with an axis to which nothing has been done yet."""
        printed = self.group.printed().strip().splitlines()[-3:]
        self.close()
        raise HysteresisError(f"the axis {what}, {self.way}, before anything was done to it: {' / '.join(printed)}")

    def _go_on(self) -> None:
        """Let an axis go on that has tripped; only somebody who has looked at it may."""
        if self.witness.tripped and self.witness.trigger("plant_simulator", "start"):
            self.starts += 1

    # -- moving ----------------------------------------------------------------------------------------------------

    def ask(self, setpoint: float) -> None:
        """Publish a setpoint, and remember that it was asked for.

        Parameters
        ----------
        setpoint : float
            [m]
        """
        self.asked.append(setpoint)
        self.witness.ask(setpoint)

    def anywhere(self) -> float:
        """Return some place of the axis [m]."""
        return float(self.random.uniform(self.bounds.low, self.bounds.high))

    def follows(self, seconds: float = RECOVERY) -> bool:
        """Send the axis to the farther end, and tell whether it gets there and stays.

        Parameters
        ----------
        seconds : float
            At most.
        """
        low, high = self.bounds.low, self.bounds.high
        target = low if self.witness.displacement > 0.5 * (low + high) else high
        since = math.inf
        asked = 0.0

        def there() -> bool:
            nonlocal since, asked
            now = time.monotonic()
            if now - asked > AGAIN:
                self._go_on()
                self.ask(target)
                asked = now
            if not abs(self.witness.displacement - target) <= REACHED * self.bounds.stroke:  # it may be NaN
                since = math.inf
            else:
                since = min(since, now)
            return now - since > KEPT

        return self.witness.until(there, seconds)

    def runs(self, nodes=None) -> bool:
        """Wait until nodes are active; tell whether they are.

        Parameters
        ----------
        nodes : iterable of str, optional
            All of the axis by default.
        """
        names = nodes or ("plant_simulator", "reference_generator", "motion_controller", "hysteresis_compensator")
        return all(self.witness.until(lambda node=node: self.witness.is_active(node), START) for node in names)

    # -- mishaps ---------------------------------------------------------------------------------------------------

    def endure(self, mishap: Mishap, amount: float, action) -> Trace:
        """Let something happen amid a move, and return what was seen.

        Parameters
        ----------
        mishap : Mishap
        amount : float
        action : callable
            ``action(rig, mishap, amount)`` does it.
        """
        self.broken, self.notes, self.asked, self.starts = [], [], [self.rest, self.witness.displacement], 0
        witness, printed = self.witness, self.group.log.stat().st_size
        witness.rows.clear()
        self.ask(self.anywhere())
        time.sleep(self.random.uniform(0.0, MOVING))
        self.begun = time.time()
        action(self, mishap, amount)
        begun, ended = self.begun, time.time()
        recovered = time.time() if self.follows() else math.nan
        if self.starts:
            self.notes.append("it trips, and goes on with ~/start")
        self.broken += self.group.died()
        if TRACEBACK in self.group.printed(printed):
            self.broken.append("a traceback is printed")
        return Trace(
            mishap.name,
            self.way,
            amount,
            os.getloadavg()[0],
            begun,
            ended,
            recovered,
            (float(np.nanmin(self.asked)), float(np.nanmax(self.asked))),
            Samples.of(witness.rows).between(begun, math.inf),
            tuple(self.broken),
            witness.gravest(begun),
            tuple(self.notes),
        )

    def close(self) -> list[str]:
        """End the axis; return in words what went wrong with that."""
        found = self.group.close()
        for other in (self.relay, self.beside):
            if other is not None:
                other.close()
        self.witness.close()
        return found

    def recorded(self) -> Samples:
        """Return all samples that the recordings of a fused axis hold, one after the other."""
        if self.way != FUSED:
            return Samples.of(())
        found = []
        for life, bag in enumerate(self.group.bags):
            run = read_recording(bag, self.axis.namespace, further=True)
            time_ = run.time + 1e-9 * run.metadata["start_time_ns"]
            columns = (time_, run.time, run["plant_voltage"], run["displacement"], np.full(len(run), life))
            found.append(np.vstack(columns).T)
        return Samples.of(np.vstack(found) if found else ())
