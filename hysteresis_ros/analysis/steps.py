# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Steps in a reference: from one hold to the next, and how the displacement answered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.recordings.loops import turning_points

#: Samples a reference must stand still to count as a hold.
HOLD_SAMPLES = 10
#: Part of a hold, at its end, whose mean is the value finally reached.
FINAL_PART = 0.1
#: A reference whose movement changes by more than this part of its stroke from one sample to the next jumps.
JUMP = 0.01
#: A reversal of a scan is at least this part of its stroke.
REVERSAL = 0.1
#: Half width of the band of the settling time, as a part of the step.
SETTLING_BAND = 0.02


@dataclass(frozen=True)
class Hold:
    """Samples ``start`` to ``stop`` (exclusive) in which the reference stands still at ``level`` [m]."""

    start: int
    stop: int
    level: float

    @property
    def final(self) -> slice:
        """The last part of the hold, at least one sample."""
        length = max(1, int(round((self.stop - self.start) * FINAL_PART)))
        return slice(self.stop - length, self.stop)


@dataclass(frozen=True)
class StepResponse:
    """The answer to one step.

    Parameters
    ----------
    start : float
        Time at which the reference began to move [s].
    size : float
        Height of the step in the reference, signed [m].
    final : float
        Value finally reached: mean displacement over the last tenth of the hold [m].
    overshoot : float
        Farthest displacement beyond ``final`` in the direction of the step, as a part of ``|size|``; at least 0.
    settling_time : float or None
        Time from ``start`` until the displacement stays within 2 % of ``|size|`` around ``final``; None when it
        has not settled before the last tenth of the hold.
    steady_state_error : float
        ``reference - final`` [m].
    """

    start: float
    size: float
    final: float
    overshoot: float
    settling_time: float | None
    steady_state_error: float


def find_holds(reference) -> list[Hold]:
    """Return the holds of a reference, shape (N,) [m]."""
    reference = np.asarray(reference, dtype=np.float64)
    if reference.size < HOLD_SAMPLES:
        return []
    moving = np.diff(reference) != 0.0
    edges = np.concatenate(([0], np.flatnonzero(moving | np.isnan(np.diff(reference))) + 1, [reference.size]))
    long = np.flatnonzero(np.diff(edges) >= HOLD_SAMPLES)
    return [Hold(int(edges[i]), int(edges[i + 1]), float(reference[edges[i]])) for i in long]


def scan_start(reference, displacement) -> int:
    """Return the sample from which on a scan is judged: its first reversal where a jump leads into it, 0 elsewhere.

    A reference that goes to and fro may begin away from where the axis rests. How far that is says nothing of how well
    the scan is followed. It is a jump when the error then is larger than any after the first reversal. Steps from hold
    to hold are what is judged there: all of them count.

    Parameters
    ----------
    reference, displacement : array, shape (N,)
        [m], finite.
    """
    points = turning_points(reference, REVERSAL)
    if len(points) < 3 or len(find_holds(reference)) > 1:
        return 0
    first = int(points[1])
    begins = int(np.argmax(reference != reference[0]))
    error = np.abs(reference - displacement)
    jump = max(error[0], error[begins])
    return first if jump > JUMP * np.ptp(reference) and jump > np.max(error[first:]) else 0


def step_responses(time, reference, displacement) -> list[StepResponse]:
    """Return the answers to all steps from one hold of the reference to the next at another level.

    A step may be a jump or a limited move; its time counts from the last sample of the hold before.

    Parameters
    ----------
    time, reference, displacement : array, shape (N,)
        [s], [m], [m].
    """
    holds = [hold for hold in find_holds(reference) if np.isfinite(hold.level)]
    responses = []
    for before, after in zip(holds[:-1], holds[1:], strict=True):
        size = after.level - before.level
        if size == 0.0:
            continue
        # a jump at sample k commands from time[k] on; a limited move leaves the old level with the last held sample
        first = after.start if after.start == before.stop else before.stop - 1
        answer = displacement[first : after.stop]
        if not np.all(np.isfinite(answer)):
            continue
        final = float(np.mean(displacement[after.final]))
        overshoot = max(0.0, float(np.max((answer - final) * np.sign(size))) / abs(size))
        outside = np.flatnonzero(np.abs(answer - final) > SETTLING_BAND * abs(size))
        settled = int(outside[-1]) + 1 if outside.size else 0
        inside_before_final = first + settled <= after.final.start
        responses.append(
            StepResponse(
                start=float(time[first]),
                size=size,
                final=final,
                overshoot=overshoot,
                settling_time=float(time[first + settled] - time[first]) if inside_before_final else None,
                steady_state_error=after.level - final,
            )
        )
    return responses
