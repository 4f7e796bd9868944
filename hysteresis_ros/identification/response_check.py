# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Uncertainty of a model's frequency response, from a recording or from a measured response.

With a recording, the response is estimated from the modelled input of the dynamics (the output of hysteresis and creep)
to the measurement, and averaged over parts of an octave. It includes the errors of the hysteresis model, because these
also act in a closed loop. A measured response gives the uncertainty directly, and linear dynamics are fitted to its
lines.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from hysteresis_ros.control.margins import plant_state_space
from hysteresis_ros.control.uncertainty import (
    DAMPING,
    UNKNOWN,
    ResponseUncertainty,
    fastest_integral,
    integral_controller,
)
from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.data import IdentificationData, clipped_samples
from hysteresis_ros.identification.dynamics import DAMPING_RANGE, SegmentSpectra, segment_spectra
from hysteresis_ros.identification.frequency_response import PROBABILITY, Analysis
from hysteresis_ros.identification.matrix_fraction import MatrixFractionFit, identify_matrix_fraction
from hysteresis_ros.identification.plant_model import PlantModel, group_delay
from hysteresis_ros.identification.prediction import before_dynamics
from hysteresis_ros.identification.preprocessing import notable_outliers
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.units import shown_unit

#: Number of bands per octave.
BANDS = 6
#: Number of narrow bands per octave, for resonances.
NARROW_BANDS = 24
#: The response counts as known in bands where two standard deviations are below this fraction of the response.
KNOWN = 0.5
#: A significant error above KNOWN is treated as a resonance that the model lacks or has at another frequency. PEAK is
#: the ratio of the peak of this resonance to its mean over a narrow band, for the assumed damping of an unknown
#: resonance.
PEAK = np.log(2.0) / NARROW_BANDS / (np.pi * DAMPING)
#: The same ratio for bands in which the residual rings: for the lightest damping that an identification can find.
RINGING_PEAK = np.log(2.0) / NARROW_BANDS / (np.pi * DAMPING_RANGE[0])
#: A band also counts as known if its deviation exceeds this multiple of two standard deviations.
CLEARLY = 2.0
#: Factor by which the overlap of the windows increases the variance of sums.
OVERLAP = 2.0
#: Bands without content between two bands with content are interpolated, up to this distance in octaves.
GAP = 1.5
#: If the content reaches this fraction of the sample rate, the whole response counts as known, because a control loop
#: acts only up to this frequency.
WHOLE = 0.5
#: The residual rings at a frequency where its mean power in a narrow band exceeds its mean power in the surrounding two
#: octaves by this factor.
STANDS_OUT = 8.0
#: Half of the width of the narrow band around a frequency [octaves].
NARROW = 1.0 / 20.0
#: Half of the width of the surrounding band [octaves].
WIDE = 1.0
#: A peak is ignored if the residual there is below this fraction of the movement that the model explains.
RINGS = 0.3
#: Ringing within the half-power bandwidth of a mode of the model with at most this damping ratio is motion of this
#: mode, excited for example by converter steps or late samples. Errors of its frequency and damping appear in the
#: response.
LIGHT = 0.05
#: Other sources of movement are reported if more than this fraction of the output's power is not a linear response to
#: the input.
FOREIGN = 0.25
NO_CONTENT = "the {} contains hardly any power there"
#: Largest accepted ratio of the crossover that the model alone would allow to the crossover with the visible errors.
FASTER = 2.0


@dataclass(frozen=True, eq=False)
class ResponseCheck:
    """The frequency response of a model compared with a recording."""

    uncertainty: ResponseUncertainty
    #: believed, seen, certain: Highest crossover [Hz] of integral control with M_s ≤ 2: for an exact model, for the
    #: errors visible in the recording, and for all responses that the recording does not exclude.
    believed: float
    seen: float
    certain: float
    unfit_at: float  #: Frequency [Hz] of the error that limits the loop.
    ringing: tuple[float, ...] = ()  #: Frequencies [Hz] of peaks in the residual.
    #: Fraction of the power of the measured movement that is not a linear response to the modelled movement; 0 if most
    #: of the movement is slower than the segments of the spectra.
    foreign: float = 0.0

    @property
    def fit_for_feedback(self) -> bool:
        """Whether the residual does not ring, and visible errors do not require a much lower crossover.

        Any ringing counts, because the mean over a band says little about the peak of a lightly damped mode.
        """
        return not self.ringing and self.seen * FASTER >= self.believed

    @property
    def reason(self) -> str:
        """Reason why the model is not fit for feedback, in one line; empty if it is fit."""
        if self.fit_for_feedback:
            return ""
        there = self.unfit_at
        percent = 100.0 * float(self.uncertainty.at([there])[0])
        why = f"the response at {there:.4g} Hz is known only to within {percent:.0f} %"
        if self.ringing and (there > self.uncertainty.known_to or self.seen * FASTER >= self.believed):
            why = f"the residual rings at {self.ringing[0]:.4g} Hz, where the model has no resonance"
        slower = f"it is fit up to {self.certain:.3g} Hz" if self.certain else "a slower loop may be unsafe too"
        crossover = f"with a crossover of {self.believed:.3g} Hz, which the model would allow"
        return f"not fit for feedback {crossover}: {why}; {slower}"

    @property
    def figures(self) -> dict:
        """The finite figures, by names with units."""
        found = {"fit_for_feedback": self.fit_for_feedback, "certain_crossover_hz": self.certain}
        known = self.uncertainty.known_to
        return found | ({"response_known_to_hz": known} if np.isfinite(known) else {})

    @property
    def entries(self) -> dict:
        """Return the values that a design reads from the parameter file."""
        found = self.uncertainty
        known = {"response.known_to": found.known_to} if np.isfinite(found.known_to) else {}
        rings = {"response.ringing": tuple(float(f"{f:.4g}") for f in self.ringing)} if self.ringing else {}
        return {
            "response.frequencies": tuple(float(f"{value:.4g}") for value in found.frequencies),
            "response.uncertainty": tuple(float(f"{value:.3g}") for value in found.relative),
            **known,
            **rings,
            **{f"response.{name}": value for name, value in self.figures.items() if "known_to" not in name},
        }

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about the residual, and about the frequency up to which the dynamics are known."""
        found = [f"the residual rings at {frequency:.4g} Hz" for frequency in self.ringing]
        driver = "voltage" if shown_unit("V") == "V" else "input"
        if self.foreign > FOREIGN:
            found.append(
                f"{100.0 * self.foreign:.0f} % of the movement (mean square) is not a linear response to the {driver}: "
                "other sources (inputs, vibration, noise) also move the output; keep other axes still and record again"
            )
        known = self.uncertainty.known_to
        if not np.isinf(known) and self.certain < self.seen:
            why = "other movement of the output masks them" if self.foreign > FOREIGN else NO_CONTENT.format(driver)
            found.append(
                f"dynamics above {known:.3g} Hz are unknown ({why}): without a roll-off a design is limited to a "
                f"crossover of about {self.certain:.2g} Hz"
            )
        return (*found, *([self.reason] if self.reason else []))


def sound_data(data: IdentificationData, predicted: np.ndarray, skip: int) -> IdentificationData:
    """Return the data with clipped samples of the output and outliers replaced by the prediction."""
    wrong = clipped_samples(data.output, data.input)
    good = notable_outliers(data.output - predicted, skip)
    if good is not None:
        wrong = wrong | ~good
    return replace(data, output=np.where(wrong, predicted, data.output)) if wrong.any() else data


def check_response(chain: PlantModel, data: IdentificationData, skip: int = 0) -> ResponseCheck | None:
    """Return the comparison of a chain's response with a recording; None for dynamics inside the hysteresis."""
    if not chain.invertible:
        return None
    moved = before_dynamics(chain, data.input, data.sample_time, data.output)
    late = max(round(group_delay(chain.dynamics)) + 1 - chain.synchronous, 0)
    spectra = segment_spectra(moved, data.output, data.sample_time, skip, late)
    z = np.exp(2j * np.pi * spectra.frequencies * data.sample_time)
    plant = plant_state_space(replace(chain.dynamics, input_scale=0.0))
    response = plant.response(z)[:, 0, 0] * z ** int(chain.synchronous)
    ringing = _ringing(spectra, plant, response, data.sample_time)
    uncertainty, shown = _uncertainty(spectra, response, ringing)
    # bands without excitation cannot test a model, but ringing in such a band is an error of the model
    rings_there = any(frequency > uncertainty.known_to for frequency in ringing)
    shown = replace(shown, known_to=uncertainty.known_to if rings_there else np.inf)
    exact = ResponseUncertainty(np.ones(1), np.zeros(1), np.inf)
    believed, seen, certain = (
        fastest_integral(plant, data.sample_time, errors) for errors in (exact, shown, uncertainty)
    )
    worst = shown.borne_by(integral_controller(believed, data.sample_time), plant, data.sample_time)
    foreign = _foreign(spectra, data.output[skip:])
    return ResponseCheck(uncertainty, believed, seen, certain, worst.frequency, ringing, foreign)


def _uncertainty(spectra: SegmentSpectra, response, ringing) -> tuple[ResponseUncertainty, ResponseUncertainty]:
    """Return, in bands, the largest possible and the smallest certain deviation of the response from the model."""
    centres, deviation, spread = _in_bands(spectra, response, BANDS)
    clear = deviation > CLEARLY * 2.0 * spread
    rings = np.any([np.abs(np.log2(centres / frequency)) < 1.0 / BANDS for frequency in ringing], axis=0)
    known = (2.0 * spread < KNOWN) | clear
    none = np.array([0.0])
    if not np.any(known):
        return ResponseUncertainty(centres[:1], np.array([UNKNOWN]), 0.0), ResponseUncertainty(
            centres[:1], none, np.inf
        )
    last = np.flatnonzero(known)[0]
    for place in np.flatnonzero(known):
        if centres[place] > 2.0**GAP * centres[last]:
            break
        last = place
    # the mean over a wide band hides a resonance narrower than the band
    places, narrow, wide = _in_bands(spectra, response, NARROW_BANDS)
    band = np.searchsorted(0.5 * (centres[1:] + centres[:-1]), places)
    seen = (2.0 * wide < KNOWN) | clear[band]
    most, least = deviation + 2.0 * spread, np.maximum(deviation - 2.0 * spread, 0.0)
    np.maximum.at(most, band[seen], (narrow + 2.0 * wide)[seen])
    np.maximum.at(least, band[clear[band]], narrow[clear[band]])
    most *= np.where(rings, RINGING_PEAK, np.where(clear & (most > KNOWN), PEAK, 1.0))
    kept = (known | rings) & (np.arange(len(centres)) <= last)
    known_to = float(centres[last]) * 2.0 ** (0.5 / BANDS)
    known_to = np.inf if known_to * spectra.sample_time >= WHOLE else known_to
    most, least = (np.minimum(size, UNKNOWN)[kept] for size in (most, least))
    return ResponseUncertainty(centres[kept], most, known_to), ResponseUncertainty(centres[kept], least, np.inf)


def _in_bands(spectra: SegmentSpectra, response, bands: int):
    """Return centres of bands [Hz], deviation of the measured response from the model, and its standard deviation."""
    f = spectra.frequencies
    count = int(bands * np.log2(f[-1] / f[0])) + 1
    edges = np.searchsorted(f, f[0] * 2.0 ** (np.arange(count + 1) / bands))
    edges = np.unique(np.append(edges[:-1], len(f)))[:-1]
    expected = np.abs(response) ** 2 * spectra.input.sum(axis=0)
    # errors that repeat with the movement, such as those of a hysteresis, do not average out over repetitions
    repeated = np.abs(spectra.cross.sum(axis=0) - response * spectra.input.sum(axis=0)) ** 2
    repeated = spectra.smooth(repeated / np.maximum(spectra.input.sum(axis=0), np.finfo(float).tiny))
    noise = spectra.incoherent() + repeated
    size = np.maximum(np.add.reduceat(expected, edges), np.finfo(float).tiny)
    ratio = np.add.reduceat(np.conj(response) * spectra.cross.sum(axis=0), edges) / size
    spread = np.sqrt(OVERLAP * np.add.reduceat(expected * noise, edges)) / size
    centres = np.add.reduceat(f, edges) / np.diff(np.append(edges, len(f)))
    return centres, np.abs(ratio - 1.0), spread


def _foreign(spectra: SegmentSpectra, output) -> float:
    """Return the fraction of the output's power that is no linear response; 0 if the spectra miss most of it."""
    # the spectra are those of the differences between samples
    undone = 1.0 / (2.0 - 2.0 * np.cos(2.0 * np.pi * spectra.frequencies * spectra.sample_time))
    power = np.abs(np.fft.rfft(output - output.mean())) ** 2
    held = np.fft.rfftfreq(len(output), spectra.sample_time) >= spectra.frequencies[0]
    if power[held].sum() < 0.5 * power.sum():
        return 0.0
    whole = spectra.output.sum(axis=0) / spectra.segments
    return float(undone @ spectra.incoherent() / (undone @ whole))


def _ringing(spectra: SegmentSpectra, plant, response, sample_time: float) -> tuple[float, ...]:
    """Return the frequencies of peaks that only the residual has: neither the spectrum of the input nor the model."""
    left, given = spectra.errors(response).sum(axis=0), spectra.input.sum(axis=0)
    tiny = np.finfo(float).tiny
    outstanding = [spectra.smooth(power, NARROW) / (spectra.smooth(power, WIDE) + tiny) for power in (left, given)]
    ratio = outstanding[0] / np.maximum(outstanding[1], 1.0)
    ratio[spectra.frequencies < 20.0 * spectra.resolution] = 0.0
    explained = spectra.smooth(np.abs(response) ** 2 * given, NARROW)
    ratio[spectra.smooth(left, NARROW) < RINGS**2 * explained] = 0.0
    poles = np.log(plant.poles[plant.poles.imag > 0.0]) / sample_time / (2.0 * np.pi)
    light = poles[-poles.real <= LIGHT * np.abs(poles)]
    regions, count = ndimage.label(ratio > STANDS_OUT)
    peaks = [place for (place,) in ndimage.maximum_position(ratio, regions, np.arange(1, count + 1))]
    for place in sorted(peaks, key=lambda place: -ratio[place]):
        peak = float(spectra.frequencies[place])
        if not np.any(np.abs(peak - np.abs(light)) <= spectra.resolution - light.real):
            return (peak,)
    return ()


#: Number of lines, the lowest ones, at which the gain is compared with the model.
LOWEST = 10
#: Number of repetitions of the fit with weights divided by the denominator of the fit before.
ITERATIONS = 10


@dataclass(frozen=True, eq=False)
class MeasuredPlant:
    """A response from command to displacement."""

    frequency: np.ndarray  #: shape (F,) [Hz]
    response: np.ndarray  #: shape (F,) [m/m]
    radius: np.ndarray  #: shape (F,); Radius of the circles that contain the true response with 95 % probability.

    def uncertainty(self, model, sample_time: float) -> ResponseUncertainty:
        """Return the uncertainty of a model: its deviation from the measurement plus the radius of the circles.

        Units: ``sample_time`` [s].
        """
        relative = (np.abs(self.response - model) + self.radius) / np.maximum(np.abs(model), 1e-12)
        last = float(self.frequency[-1])
        # the line after the last one would be at or beyond half the sample rate; frequencies are rounded
        spacing = float(self.frequency[-1] - self.frequency[-2]) if self.frequency.size > 1 else 0.0
        known_to = np.inf if (last + 1.001 * spacing) * sample_time >= WHOLE else last
        return ResponseUncertainty(self.frequency, np.minimum(relative, UNKNOWN), known_to)


def measured_plant(found: Analysis, model) -> MeasuredPlant:
    """Return the response from the command; a response from a voltage is scaled to the model's gain.

    The scale makes both gains equal at the lowest lines: the gain of the model is that of the whole stroke, but a
    hysteresis has another gain for small movements.
    """
    response = found.response
    radius = response.radius(PROBABILITY)[:, 0, 0]
    scale = 1.0
    if response.input_unit == "V":
        scale = float(np.median(np.abs(model[:LOWEST])) / np.median(np.abs(response.single[:LOWEST])))
    return MeasuredPlant(response.frequency, scale * response.single, scale * radius)


def dynamics_of(found: Analysis, order: int | None = None) -> tuple[LinearParameters, MatrixFractionFit]:
    """Return linear dynamics of unit DC gain that fit a response, and details of the fit."""
    if order is not None and not 1 <= order <= found.response.frequency.size // 4:
        raise IdentificationError(
            f"order {order}: must be within 1 … {found.response.frequency.size // 4}, a quarter of the lines"
        )
    fit = identify_matrix_fraction(found.response, order, iterations=ITERATIONS)
    return fit.model.linear_parameters(), fit
