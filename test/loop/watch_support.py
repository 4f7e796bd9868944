# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Runs of the kernels that monitor inputs."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.loop import faults, plant
from hysteresis_ros.loop.watch import FOLLOWS, GUARD_STATES, accept, hold_state, hold_voltage, is_stale, receive


def guard(timeout=1000, spike=0.0, confirm=3, frozen=0) -> np.ndarray:
    """Return parameters of a guard; the time-out is in samples."""
    return np.array([timeout, spike, confirm, frozen], dtype=float)


def hold(safe=0.0, step=1.0, timeout=1000, keep=False, start=0.0) -> tuple[np.ndarray, float]:
    """Return parameters of a held voltage, and the output before the first voltage."""
    return np.array([safe, step, timeout, keep], dtype=float), start


def run_guard(p, values, stamps=None):
    """Return the accepted values, whether the input is stale after each value, and the final state."""
    x = np.zeros(GUARD_STATES)
    stamps = np.arange(len(values)) if stamps is None else stamps
    got, stale = np.empty(len(values)), np.empty(len(values), dtype=bool)
    for k, value in enumerate(values):
        got[k] = accept(p, x, float(value), float(stamps[k]))
        stale[k] = is_stale(p, x)
    return got, stale, x


def run_hold(given, voltages, stopped, least=-np.inf):
    """Return the output, and whether it follows its input after each sample."""
    p, start = given
    x = hold_state(start)
    out, follows = np.empty(len(voltages)), np.empty(len(voltages))
    for k, voltage in enumerate(voltages):
        out[k] = hold_voltage(p, x, float(voltage), float(stopped[k]), float(least))
        follows[k] = x[FOLLOWS]
    return out, follows


def trip(limit, forgiven, lowest=-np.inf, highest=np.inf):
    """Return the parameters of a trip."""
    p = np.zeros(plant.TRIP_PARAMETERS)
    p[[plant.LIMIT, plant.FORGIVEN, plant.LOWEST, plant.HIGHEST]] = limit, forgiven, lowest, highest
    return p


def run_trip(p, late, measured=None):
    """Return the reason for a stop by the plant after each sample, and the final state."""
    measured = np.zeros(len(late)) if measured is None else measured
    x = np.zeros(plant.TRIP_STATES)
    stopped = np.empty(len(late))
    for k, value in enumerate(late):
        plant.watch(p, x, float(value), float(measured[k]))
        stopped[k] = x[plant.TRIP]
    return stopped, x


#: Consecutive faults of a measurement, some of them random.
FAULTS = ("drop:0.01:0.04:0.5", "disorder:0.06:0.03", "late:0.1:0.03:2", "spike:0.14:0.03:5")


def run_receive(p, values, missing, given=FAULTS, rate=1000.0):
    """Return the measurement that a part receives, computed in one call, and the final states."""
    faults_p = faults.fault_parameters(given, (faults.MEASUREMENT,), rate)
    x, faults_x = np.zeros(GUARD_STATES), faults.fault_state(faults_p)
    got = [
        receive(p, x, faults_p, faults_x, faults.MEASUREMENT, float(value), float(lost))
        for value, lost in zip(values, missing, strict=True)
    ]
    return np.array(got), x, faults_x


def run_put_out(trip_p, hold_p, voltages, measured):
    """Return the output of a plant and its modes, computed in one call, and the final states."""
    trip_x, hold_x = np.zeros(plant.TRIP_STATES), hold_state(0.0)
    out, modes = np.empty(len(voltages)), np.empty(len(voltages))
    for k, voltage in enumerate(voltages):
        out[k] = plant.put_out(trip_p, trip_x, hold_p, hold_x, float(voltage), float(measured[k]))
        modes[k] = trip_x[plant.MODE]
    return out, modes, trip_x, hold_x


def same_in_both_forms() -> np.ndarray:
    """Return all results of guards, held voltages and trips for random inputs, in one array."""
    random = np.random.default_rng(5)
    found = []
    for _ in range(20):
        values = random.normal(size=200) + 5.0 * (random.random(200) < 0.1)
        values[random.random(200) < 0.2] = np.nan
        values[50:60] = values[49]
        stamps = np.cumsum(random.integers(0, 3, 200)).astype(float)
        p = guard(int(random.integers(1, 9)), float(random.choice([0.0, 1.0])), 3, int(random.choice([0, 4])))
        found += [*run_guard(p, values, stamps)]
        stops = (random.random(200) < 0.05).astype(float)
        found += [*run_hold(hold(0.3, 0.2, int(random.integers(1, 5)), random.random() < 0.5), values, stops)]
        late = (random.random(200) < 0.1).astype(float)
        found += [*run_trip(trip(4.0, 0.04, -3.0, 2.5), late, values)]
        found += [*run_receive(p, values, late)]
        found += [*run_put_out(trip(4.0, 0.04, -6.0, 6.0), hold(0.3, 0.2, 4)[0], values, np.roll(values, 1))]
    return np.concatenate([np.asarray(array, dtype=float) for array in found])
