# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

r"""Prandtl-Ishlinskii hysteresis, classical and modified, with its analytic inverse [1]_.

A sum of play (backlash) operators has symmetric loops. Dead zones after the sum (the *modified* model) bend both
branches in the same way:

.. math::

   z_i \leftarrow \max(V - r_i, \min(V + r_i, z_i)), \qquad u = \sum_i w_i z_i

.. math::

   x = x_0 + u + \sum_j s_j \, d(u, t_j), \qquad d(u, t) = \max(u - t, 0) \; (t \geq 0), \quad \min(u - t, 0) \; (t < 0)

The inverse needs no operators of its own. The dead zones are inverted piece by piece. Along a monotone step, the sum of
plays is a piecewise linear function of V, with corners ``z_i ± r_i`` in the order of the radii.

References
----------
.. [1] Kuhnen, Modeling, identification and compensation of complex hysteretic nonlinearities, European Journal of
   Control 9(4), 2003.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models.block import kernel
from hysteresis_ros.models.declaration import (
    DISPLACEMENT,
    MOST_PLAYS,
    VOLTAGE,
    Deviation,
    HysteresisModel,
    LinearTerms,
    Option,
    RateIndependentBlock,
    plus,
    times,
)
from hysteresis_ros.models.linear_algebra import product

# Layout of p; radii and weights of the plays follow, then thresholds and weights of the dead zones: first the zones
# above zero in increasing order, then the zones below zero in decreasing order.
PLAYS = 0
ABOVE = 1
BELOW = 2
OFFSET = 3
RADII = 4

# Layout of x, after VOLTAGE and DISPLACEMENT; the plays follow.
RESIDUE = 2  # remaining offset after a retune [m]
PLAY = 3


@dataclass(frozen=True)
class PrandtlIshlinskiiParameters(Parameters):
    """Radii and weights of the plays, thresholds and weights of the dead zones, SI units."""

    radii: tuple[float, ...] = parameter(
        description="radii r (half widths) of the plays, increasing from 0", unit="V", low=0.0
    )
    weights: tuple[float, ...] = parameter(description="weights w of the plays", unit="m/V", low=0.0)
    thresholds: tuple[float, ...] = parameter(
        (), description="thresholds t of the dead zones; a zone with t < 0 acts below t, any other above t", unit="m"
    )
    zone_weights: tuple[float, ...] = parameter((), description="slopes s added by the dead zones; may be negative")
    offset: float = parameter(0.0, description="constant part of the displacement", unit="m")

    @property
    def structure(self) -> dict[str, int]:
        """Structure that cannot change while running."""
        below = sum(threshold < 0.0 for threshold in self.thresholds)
        return {"radii": len(self.radii), "thresholds": len(self.thresholds), "thresholds below 0": below}

    def check(self):
        """Yield a Problem for wrong sizes, radii that do not increase, or branches that are not monotone."""
        if len(self.radii) != len(self.weights) or not self.radii:
            yield Problem(
                "weights", self.weights, f"must be as many numbers as radii ({len(self.radii)}), at least one"
            )
            return
        if any(after <= before for before, after in zip(self.radii, self.radii[1:], strict=False)):
            yield Problem("radii", self.radii, "must rise strictly")
        elif self.radii[0] != 0.0 or self.weights[0] <= 0.0:
            remedy = "must start with a play of radius 0 and weight above 0; otherwise no inverse exists"
            name = "radii" if self.radii[0] != 0.0 else "weights"
            yield Problem(name, getattr(self, name)[0], remedy)
        if len(self.thresholds) != len(self.zone_weights):
            yield Problem(
                "zone_weights", self.zone_weights, f"must be as many numbers as thresholds ({len(self.thresholds)})"
            )
            return
        for side, zones in zip(("above", "below"), _zones(self), strict=True):
            slopes = 1.0 + np.cumsum([weight for _, weight in zones])
            if np.any(slopes <= 0.0):
                lowest = np.min(slopes)
                remedy = f"{side} zero the slope 1 + Σ s falls to {lowest:.3g}; it must stay above 0 (monotone)"
                yield Problem("zone_weights", self.zone_weights, remedy)


def _zones(parameters):
    """Return (threshold, weight) of the dead zones in two lists, above and below zero, each outwards from zero."""
    zones = sorted(zip(parameters.thresholds, parameters.zone_weights, strict=True))
    return [zone for zone in zones if zone[0] >= 0.0], [zone for zone in zones if zone[0] < 0.0][::-1]


@kernel
def dead_zones(p, x):
    """Return the superposition S(x) of the dead zones [m]."""
    first = RADII + 2 * int(p[PLAYS])
    above, below = int(p[ABOVE]), int(p[BELOW])
    y = x
    if x > 0.0:
        for i in range(above):
            y += p[first + above + i] * max(x - p[first + i], 0.0)
    else:
        first += 2 * above
        for i in range(below):
            y += p[first + below + i] * min(x - p[first + i], 0.0)
    return y


@kernel
def dead_zones_inverse(p, y):
    """Return the x at which :func:`dead_zones` is ``y``; the pieces are inverted from zero outwards."""
    first = RADII + 2 * int(p[PLAYS])
    count = int(p[ABOVE])
    sign = 1.0
    if y < 0.0:
        first += 2 * count
        count = int(p[BELOW])
        sign = -1.0
    x, value, slope = 0.0, 0.0, 1.0
    for i in range(count):
        corner = p[first + i]
        at_corner = value + slope * (corner - x)
        if sign * (y - at_corner) <= 0.0:
            break
        x, value = corner, at_corner
        slope += p[first + count + i]
    return x + (y - value) / slope


@kernel
def prandtl_ishlinskii(p, x, u):
    """Return the displacement [m] after a monotone change of the voltage to ``u`` [V]; NaN changes nothing."""
    if not abs(u - x[VOLTAGE]) > 0.0:
        return x[DISPLACEMENT]
    plays = int(p[PLAYS])
    total = 0.0
    for i in range(plays):
        radius = p[RADII + i]
        z = max(u - radius, min(u + radius, x[PLAY + i]))
        x[PLAY + i] = z
        total += p[RADII + plays + i] * z
    x[VOLTAGE] = u
    x[DISPLACEMENT] = dead_zones(p, total) + (p[OFFSET] + x[RESIDUE])
    return x[DISPLACEMENT]


@kernel
def prandtl_ishlinskii_inverse(hysteresis, p_i, x_i, p_h, x_h, displacement):
    """Return the voltage [V] for the next output ``displacement`` [m], in closed form; for NaN, the last voltage.

    ``p_h`` and ``x_h`` are the arrays of :func:`prandtl_ishlinskii`; ``x_h`` is not changed. The other arguments are
    not used.
    """
    voltage = x_h[VOLTAGE]
    if not abs(displacement - x_h[DISPLACEMENT]) > 0.0:
        return voltage
    plays = int(p_h[PLAYS])
    wanted = dead_zones_inverse(p_h, displacement - (p_h[OFFSET] + x_h[RESIDUE]))
    direction = 1.0 if displacement > x_h[DISPLACEMENT] else -1.0
    # while the first plays move and the others do not, the output at V is constant + slope V
    constant = 0.0
    for i in range(plays):
        constant += p_h[RADII + plays + i] * x_h[PLAY + i]
    slope = 0.0
    found = voltage
    for i in range(plays):
        weight, radius, z = p_h[RADII + plays + i], p_h[RADII + i], x_h[PLAY + i]
        corner = z + direction * radius
        if slope > 0.0:
            found = (wanted - constant) / slope
            if direction * (found - corner) <= 0.0:
                break
        constant -= weight * (z + direction * radius)
        slope += weight
        found = (wanted - constant) / slope
    return max(found, voltage) if direction > 0.0 else min(found, voltage)


class PrandtlIshlinskiiHysteresis(RateIndependentBlock):
    """Classical or modified Prandtl-Ishlinskii hysteresis: voltage [V] to displacement [m].

    Parameters
    ----------
    parameters : PrandtlIshlinskiiParameters
        Plays, dead zones and offset.
    sample_time : float
        Sample time [s], not used.
    """

    kernel = staticmethod(prandtl_ishlinskii)
    inverse = staticmethod(prandtl_ishlinskii_inverse)

    def pack(self, parameters: PrandtlIshlinskiiParameters) -> np.ndarray:
        """Return p, shape (4 + 2 plays + 2 dead zones,)."""
        above, below = _zones(parameters)
        head = [len(parameters.radii), len(above), len(below), parameters.offset]
        zones = [np.array(part).T.ravel() for part in (above, below) if part]
        return np.concatenate([head, parameters.radii, parameters.weights, *zones])

    def initial_state(self) -> np.ndarray:
        """Return x, shape (3 + plays,): 0 V, with every play in the middle of its range."""
        x = np.zeros(PLAY + len(self.parameters.radii))
        x[DISPLACEMENT] = self.parameters.offset
        return x

    @property
    def terms(self) -> LinearTerms:
        """The weights of the plays; the dead zones follow the sum."""
        plays, above, below = (int(self.p[place]) for place in (PLAYS, ABOVE, BELOW))
        first = RADII + 2 * plays
        second = first + 2 * above
        zones = [(first + i, first + above + i) for i in range(above)]
        zones += [(second + i, second + below + i) for i in range(below)]
        return LinearTerms(
            weights=tuple(range(RADII + plays, first)),
            signals=tuple(range(PLAY, PLAY + plays)),
            opening=tuple(bool(radius > 0.0) for radius in self.p[RADII : RADII + plays]),
            zones=tuple(zones),
            offset=OFFSET,
        )

    @property
    def gain(self) -> float:
        """Nominal gain [m/V]: slope while every play moves, without dead zones."""
        plays = int(self.p[PLAYS])
        return float(product(self.p[RADII + plays : RADII + 2 * plays], np.ones(plays)))

    def rebase(self) -> None:
        """Move each play by the same fraction of its free range, in order to compensate a change of the output.

        This keeps the order of the plays. What the plays cannot compensate remains as a constant until :meth:`reset`.
        """
        x, p, plays = self.x, self.p, int(self.p[PLAYS])
        voltage, z = x[VOLTAGE], x[PLAY:]
        radii, weights = p[RADII : RADII + plays], p[RADII + plays : RADII + 2 * plays]
        z[:] = np.clip(z, voltage - radii, voltage + radii)
        x[RESIDUE] = 0.0
        missing = dead_zones_inverse(p, x[DISPLACEMENT] - p[OFFSET]) - product(weights, z)
        target = voltage + np.sign(missing) * radii
        room = product(weights, target - z)
        if missing != 0.0 and room != 0.0:
            z += min(missing / room, 1.0) * (target - z)
        x[RESIDUE] = x[DISPLACEMENT] - dead_zones(p, float(product(weights, z))) - p[OFFSET]


def _scaled(parameters: PrandtlIshlinskiiParameters, factor: float) -> PrandtlIshlinskiiParameters:
    return times(parameters, factor, "weights", "thresholds", "offset")


def _shifted(parameters: PrandtlIshlinskiiParameters, offset: float) -> PrandtlIshlinskiiParameters:
    return plus(parameters, offset, "offset")


def _weighted(parameters: PrandtlIshlinskiiParameters, factors) -> PrandtlIshlinskiiParameters:
    """Multiply the weights by the factors; the thresholds of the dead zones scale with the sum of the weights."""
    before, ones = np.array(parameters.weights), np.ones(len(parameters.weights))
    after = before * np.asarray(factors)
    gain = float(product(after, ones)) / float(product(before, ones))
    return replace(times(parameters, gain, "thresholds"), weights=tuple(after.tolist()))


def _deviated(parameters: PrandtlIshlinskiiParameters, deviation: Deviation) -> PrandtlIshlinskiiParameters:
    """Apply a random factor to each play with a radius above 0, in addition to the factor on the loop width."""
    weights = np.array(parameters.weights) * deviation.gain
    plays = np.array(parameters.radii) > 0.0
    weights[plays] *= deviation.opening * deviation.factor(int(np.sum(plays)))
    thresholds = np.array(parameters.thresholds) * deviation.gain
    return replace(parameters, weights=tuple(weights.tolist()), thresholds=tuple(thresholds.tolist()))


MODEL = HysteresisModel(
    name="prandtl_ishlinskii",
    title="play operators with weights ≥ 0, with a map or dead zones after them if they improve the fit (modified)",
    data="a voltage that rises and falls; loops of several amplitudes determine the model inside the largest loop",
    parameters=PrandtlIshlinskiiParameters,
    block=PrandtlIshlinskiiHysteresis,
    example=PrandtlIshlinskiiParameters(
        radii=(0.0, 5.0, 10.0, 20.0, 35.0),
        weights=(70e-9, 9e-9, 7e-9, 6e-9, 5e-9),
        thresholds=(3e-6, 7e-6),
        zone_weights=(0.1, -0.2),
    ),
    scaled=_scaled,
    shifted=_shifted,
    deviated=_deviated,
    weighted=_weighted,
    inverses=("exact", "general", "picard_steps", "none"),
    identify="hysteresis_ros.identification.procedures:prandtl_ishlinskii",
    options={
        "play_count": Option(int, "plays", low=1, high=MOST_PLAYS),
        "zone_count": Option(
            int,
            "number of dead zones; a given number selects density=free; 0: the classical model",
            low=0,
            high=MOST_PLAYS,
        ),
        "density": Option(
            str,
            "law of the weights over the radius; exponential: with a cubic characteristic after the plays; free: one "
            "weight for each play, with dead zones if they predict better; auto: the structure with the smallest error "
            "on held-out blocks",
            choices=("auto", "exponential", "free"),
        ),
    },
)
