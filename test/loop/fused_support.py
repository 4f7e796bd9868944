# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Common functions of the tests of the fused loop: its results, and its offline twin."""

from __future__ import annotations

import numpy as np
from loop_support import HOLD, assert_same_bits, parameters

from hysteresis_ros.loop import pacing
from hysteresis_ros.loop.axis import Axis, Change
from hysteresis_ros.loop.fused import FusedLoop

#: A rate that is easy to keep in real time, also interpreted: 150 samples per second.
SLOWLY = 0.05
#: The same for the stage of 20 kHz.
STAGE_SLOWLY = 0.0075
#: Without trips, however busy the machine is.
ANY_LATE = {"plant_simulator": {"late_limit": -1}, **HOLD}


def change(node, action, **values):
    """Return a change for :meth:`FusedLoop.apply`."""
    return Change(0, node, action, {name.replace("__", "."): value for name, value in values.items()})


def made_loop(name="kim2009", factor=np.inf, samples=0, **overrides):
    """Return a loop and the parameters of its axis."""
    given = parameters(name, **overrides)
    return FusedLoop(Axis(given), factor, samples), given


def delay(loop, samples):
    """Delay the clock of a running loop by some samples."""
    loop._state[pacing.ORIGIN] -= samples * loop._state[pacing.PERIOD] // pacing.FEMTO


def named(loop: FusedLoop, table) -> dict[str, np.ndarray]:
    """Return the signals of a table by name."""
    names = (signal.name for signal in loop.axis.kind.row)
    return {name: np.ascontiguousarray(values) for name, values in zip(names, table, strict=True)}


def whole(loop: FusedLoop, *taken) -> dict[str, np.ndarray]:
    """Return all samples of a loop, from consecutive pieces."""
    taken = [*taken, loop.take()]
    assert not loop.failure and not any(piece.lost for piece in taken)
    first = taken[0].first
    for piece in taken:
        assert piece.first == first or not len(piece.times)
        first += len(piece.times)
    assert first == loop.sample
    return named(loop, np.concatenate([piece.table for piece in taken], axis=1))


def assert_twin(loop: FusedLoop, made: dict[str, np.ndarray], parameters) -> dict[str, np.ndarray]:
    """Refuse a run that differs in any bit from that of its offline twin; return the twin's run."""
    asked = {"requests": made["request"], "speeds": made["speed"]} if loop.axis.kind.motor else {}
    asked |= {"skipped": made["skipped"], "pulses": made["trigger_in"]}
    twin = Axis(parameters).run(made["setpoint"], changes=loop.changes, **asked)
    assert_same_bits(made, twin)
    return twin
