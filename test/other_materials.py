# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Recordings of other materials than piezo stacks, each from a law that no model of the package has.

* ``shape_memory``: strain [%] over temperature [degC]. Each phase transforms at a rate that depends on the temperature
  only in its own window, so the loop is wide and saturates at both ends.
* ``brake``: torque [N] over current [A]: Coleman and Hodgdon's equation around tanh of a dead zone.
* ``butterfly``: strain [m] over a bipolar voltage [V]: the square of a polarisation.
* ``elastomer``: stress [N] over strain [%]: relaxations from 0.5 s to 300 s behind a curve that stiffens.
* ``bender``: displacement [m] over voltage [V] by Bouc and Wen's law; its sensor clips at 80 % of the stroke.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hysteresis_ros.identification.data import IdentificationData


def decaying(samples: int, low: float, high: float, cycles: int = 8, least: float = 0.2) -> np.ndarray:
    """Return a triangular input from ``low``: two full cycles, then cycles whose amplitude falls to ``least``."""
    place = np.linspace(0.0, cycles, samples)
    size = np.clip(1.0 - (1.0 - least) * (place - 2.0) / (cycles - 2.0), least, 1.0)
    wave = 1.0 - np.abs(2.0 * (place % 1.0) - 1.0) * 2.0
    return 0.5 * (low + high) + 0.5 * (high - low) * size * wave


def _data(step, u, y, units, names, noise: float, seed: int) -> IdentificationData:
    y = y + noise * np.ptp(y) * np.random.default_rng(seed).standard_normal(len(y))
    return IdentificationData(step * np.arange(len(u)), u, y, *units, *names)


def shape_memory(u=None, seed: int = 0) -> IdentificationData:
    """Return a wide loop that saturates, 10 Hz, 20 … 110 degC."""
    u = decaying(4000, 20.0, 110.0) if u is None else u
    transformed, y = 0.0, np.empty(len(u))
    for k, temperature in enumerate(u):
        change = temperature - u[k - 1] if k else 0.0
        if change > 0.0:
            rate = 0.25 * np.exp(-(((temperature - 82.0) / 9.0) ** 2))
            transformed += (1.0 - transformed) * -np.expm1(-rate * change)
        else:
            rate = 0.25 * np.exp(-(((temperature - 55.0) / 8.0) ** 2))
            transformed *= np.exp(rate * change)
        y[k] = 4.0 * transformed + 0.002 * (temperature - 20.0)
    return _data(0.1, u, y, ("degC", "%"), ("temperature", "strain"), 2e-3, seed)


def _hodgdon(u, target, turn: float, slope: float) -> np.ndarray:
    """Return y of y' = turn |u'| (target(u) - y) + slope u'."""
    y = np.empty(len(u))
    y[0] = target(u[0])
    for k in range(1, len(u)):
        change, middle = u[k] - u[k - 1], target(0.5 * (u[k] + u[k - 1]))
        y[k] = middle + (y[k - 1] - middle) * np.exp(-turn * abs(change)) + slope * change
    return y


def brake(u=None, seed: int = 0) -> IdentificationData:
    """Return a loop with a dead zone at small currents and saturation at large ones, 100 Hz, -1 … 1 A."""
    u = decaying(4000, -1.0, 1.0) if u is None else u

    def target(current):
        return 40.0 * np.tanh(3.0 * np.sign(current) * max(abs(current) - 0.2, 0.0))

    return _data(0.01, u, _hodgdon(u, target, 8.0, 2.0), ("A", "N"), ("current", "torque"), 2e-3, seed)


def butterfly(u=None, seed: int = 0) -> IdentificationData:
    """Return a butterfly over a bipolar voltage, 100 Hz, -200 … 200 V."""
    u = decaying(4000, -200.0, 200.0, least=0.8) if u is None else u
    polarisation = _hodgdon(u, lambda voltage: np.tanh(voltage / 60.0), 0.02, 0.0)
    return _data(0.01, u, 5e-6 * polarisation**2, ("V", "m"), ("voltage", "strain"), 2e-3, seed)


def elastomer(u=None, seed: int = 0) -> IdentificationData:
    """Return the slow stress of an elastomer, 5 Hz, 0 … 40 %."""
    u = decaying(4000, 0.0, 40.0) if u is None else u
    curve = u + 0.4 * (u / 40.0) ** 3 * 40.0
    y, step = 0.6 * curve, 0.2
    for time in (0.5, 5.0, 40.0, 300.0):
        decay, force = np.exp(-step / time), 0.0
        for k in range(len(u)):
            force = decay * force + (curve[k] - curve[k - 1] if k else curve[0]) * (1.0 - decay) * time / step
            y[k] += 0.15 * force
    return _data(step, u, 0.5 * y, ("%", "N"), ("strain", "stress"), 2e-3, seed)


def bender(u=None, seed: int = 0, clip: float | None = 0.8) -> IdentificationData:
    """Return the loops of a bender whose sensor clips at this fraction of the stroke, 200 Hz, 0 … 100 V."""
    u = decaying(4000, 0.0, 100.0) if u is None else u
    s, h = u / 100.0, np.zeros(len(u))
    for k in range(1, len(u)):
        change = s[k] - s[k - 1]
        h[k] = h[k - 1] + 0.5 * change - 5.0 * abs(change) * h[k - 1] - 0.7 * change * abs(h[k - 1])
    data = _data(0.005, u, 300e-6 * (1.05 * s - h), ("V", "m"), ("voltage", "tip"), 5e-4, seed)
    if clip is None:
        return data
    low, high = float(data.output.min()), float(data.output.max())
    return replace(data, output=np.minimum(data.output, low + clip * (high - low)))
