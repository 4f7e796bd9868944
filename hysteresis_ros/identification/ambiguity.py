# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a recording cannot tell: the density of the plays against the map behind them, and what that may cost.

Let f be the reversible part with the map and W(r) the sum of the weights of plays up to radius r. A periodic loop
between 0 and V gives f'(v) + W(v/2) on its rising and f'(v) + W((V - v)/2) on its falling branch, so a W that is
symmetric about V/4 and an f' that makes up for it leave no trace, while the gain of smaller loops changes. Whether a
recording settles them is tried: densities ``exp(-κ r/h)`` of every κ are fitted behind the linear part found, each with
a map of its own. Those that fit about as well as the best may all be true, and how far apart they are on smaller loops
is the doubt left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.condensed import Condensed
from hysteresis_ros.identification.linear_part import LinearPart
from hysteresis_ros.identification.smooth_density import PRIOR_DECAY, SETTLED, SmoothDensity
from hysteresis_ros.models.hysteresis import HysteresisParameters, hysteresis_block

#: κ that are tried, and plays that stand for each density.
DECAYS = (-1.0, 0.0, 1.0, 1.5, 1.9, 2.5, 3.2, 4.2, 6.0)
PLAYS = 20
#: Half swings of the loops they are compared on, which fall to nothing, and points of each.
SWINGS, POINTS = 16, 40
#: The small loop, as a part of the range.
SMALL = 0.1
#: A doubt of this part of the stroke is warned of.
NOTABLE = 0.002
EXCITATION = "loops of decaying amplitude settle it (hysteresis excite --recipe decaying)"


@dataclass(frozen=True)
class Ambiguity:
    """What may be true besides the model that was chosen.

    Parameters
    ----------
    decays : (float, float)
        Lowest and highest κ that fit about as well as the best.
    gain : (float, float)
        Gain of loops over a tenth of the range, lowest and highest of all that may be true, by that of the model.
    error : float
        Largest RMS difference from the model on loops of decaying amplitude [m].
    stroke : float
        Of the recording [m].
    held : bool
        The model holds κ at its prior.
    """

    decays: tuple[float, float]
    gain: tuple[float, float]
    error: float
    stroke: float
    held: bool

    @property
    def numbers(self) -> dict[str, float]:
        """Figures for the parameter file, names with units."""
        low, high = (100.0 * (gain - 1.0) for gain in self.gain)
        return {
            "density_decay_low": self.decays[0],
            "density_decay_high": self.decays[1],
            "small_loop_gain_low_percent": low,
            "small_loop_gain_high_percent": high,
            "ambiguity_rms_m": self.error,
        }

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is to be doubted, and what would settle it; empty where the recording does."""
        if self.error < NOTABLE * self.stroke:
            return ()
        low, high = (100.0 * (gain - 1.0) for gain in self.gain)
        return (
            f"the recording does not settle the gain of loops smaller than its own: {low:+.2g} … {high:+.2g} % at "
            f"a tenth of the range, {1e6 * self.error:.2g} µm on decaying loops; {self._held()}{EXCITATION}",
        )

    def _held(self) -> str:
        return f"the density is held at the prior κ = {PRIOR_DECAY:g}; " if self.held else ""


def find_ambiguity(data: Condensed, part: LinearPart, chosen: HysteresisParameters, held: bool) -> Ambiguity | None:
    """Return how far densities and maps that the data does not tell apart are from the model; None if none fits.

    Parameters
    ----------
    data : Condensed
    part : LinearPart
        What was found behind the hysteresis.
    chosen : HysteresisParameters
        The model.
    held : bool
        It holds κ at its prior.
    """
    fits = [SmoothDensity(data, PLAYS).behind(part, decay) for decay in DECAYS]
    least = min(fit.rms for fit in fits)
    voltage = _decaying(float(data.voltage.min()), float(data.voltage.max()))
    own = _response(chosen, voltage, data.sample_time)
    decays, gains, errors = [], [1.0], [0.0]
    for fit in fits:
        if fit.rms > (1.0 + SETTLED) * least:
            continue
        try:
            other = _response(fit.parameters(), voltage, data.sample_time)
        except IdentificationError:
            continue
        decays.append(fit.decay)
        gains.append(_small_gain(other) / _small_gain(own))
        difference = (other - own)[2 * POINTS : -POINTS]
        errors.append(float(np.std(difference)))
    if not decays:
        return None
    return Ambiguity((min(decays), max(decays)), (min(gains), max(gains)), max(errors), data.stroke, held)


def _decaying(low: float, high: float) -> np.ndarray:
    """Return a voltage [V] that goes through the range once, then to and fro ever less, and through a small loop."""
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    sizes = [1.0, 1.0, *(1.0 - np.arange(1, SWINGS + 1) / SWINGS)]
    ends = [centre + half * size * (-1.0) ** k for k, size in enumerate(sizes)]
    ends += [centre - SMALL * half, centre + SMALL * half]
    return np.concatenate([np.linspace(a, b, POINTS + 1)[1:] for a, b in zip([0.0, *ends], ends, strict=False)])


def _response(hysteresis: HysteresisParameters, voltage, sample_time: float) -> np.ndarray:
    return hysteresis_block(hysteresis, sample_time).simulate(voltage)


def _small_gain(response) -> float:
    return float(response[-1] - response[-POINTS - 1])
