# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The stages in open loop (sensor, gain and sign, resonance, hysteresis, creep): their voltages and their checks.

Each voltage begins and ends at the safe voltage, with smooth ramps.
"""

from __future__ import annotations

import numpy as np

from hysteresis_ros.analysis.commissioning_report import Picture, line
from hysteresis_ros.cli.commissioning.situation import CommissioningError, Outcome, Plan, Situation
from hysteresis_ros.identification.frequency_response import FrequencyResponse, multisine_response
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.loops import loop_opening
from hysteresis_ros.references.recipes import EXCITED, REST, SMALL, WAY, hold, recipe, there_and_back, way
from hysteresis_ros.references.waveforms import Waveform, WaveformParameters
from hysteresis_ros.units import readable

#: Duration of the transition of a small step [s].
STEP_WAY = 0.05
#: Duration of each hold before and after a small step [s].
STEP_HOLD = 0.75
#: Duration of the transition of the creep step, and of the step back [s].
CREEP_WAY = 0.1
#: Duration of the hold after the step back, as a fraction of ``creep_duration``.
BACK_PART = 0.25
#: Number of periods of the multisine; the first one is for settling.
PERIODS = 5
#: Length of a period of the multisine [s].
PERIOD = 2.0
#: Number of cycles over the whole range.
WHOLE = 2
#: Number of cycles with decaying amplitude, after those over the whole range.
DECAYING = 14
#: Number of cycles in which the decaying amplitude falls to 1/e.
DECAY = 3.5
#: Size of the creep step, as a fraction of the distance from the safe voltage to the farther end of the range.
CREEP_PART = 0.8


def listening(plan: Plan, safe: float, rate: float) -> np.ndarray:
    """Return the voltage [V] at which the noise of the sensor is measured: the safe voltage."""
    return hold(safe, plan.noise_duration, rate)


def step_size(plan: Plan, safe: float) -> float:
    """Return the small step [V]; it goes towards the farther end of the range."""
    size = plan.step * plan.span
    return size if plan.maximum - safe >= safe - plan.minimum else -size


def small_step(plan: Plan, safe: float, rate: float) -> np.ndarray:
    """Return the voltage [V] of a small step and the step back."""
    level, wait = safe + step_size(plan, safe), hold(safe, STEP_HOLD, rate)
    up, back = way(safe, level, STEP_WAY, rate), way(level, safe, STEP_WAY, rate)
    return np.concatenate([wait, up, hold(level, STEP_HOLD, rate), back, wait])


def small_multisine(plan: Plan, safe: float, rate: float) -> np.ndarray:
    """Return a small multisine around the middle of the range, with ramps to it and back [V]."""
    part = plan.small / SMALL
    asked = recipe("multisine", plan.minimum, plan.maximum, rate, 1.0 / PERIOD, part, PERIODS * PERIOD)
    sines = Waveform(WaveformParameters.from_mapping(asked.waveform), 1.0 / rate)
    voltages = sines.simulate(np.zeros(round(asked.duration * rate)))
    return there_and_back(np.clip(voltages, plan.minimum, plan.maximum), safe, rate)


def decaying_cycles(plan: Plan, safe: float, rate: float) -> np.ndarray:
    """Return cycles over the whole range, then with decaying amplitude, with ramps to them and back [V]."""
    cycle = max(round(rate / plan.cycle_frequency), 8)
    index = np.arange((WHOLE + DECAYING) * cycle + 1)
    fall = np.exp(-np.maximum(index - WHOLE * cycle, 0) / (DECAY * cycle))
    middle = 0.5 * (plan.minimum + plan.maximum)
    return there_and_back(middle - 0.5 * plan.span * fall * np.cos(2.0 * np.pi * index / cycle), safe, rate)


def creeping_level(plan: Plan, safe: float) -> float:
    """Return the level of the creep step [V]."""
    far = plan.maximum if plan.maximum - safe >= safe - plan.minimum else plan.minimum
    return safe + CREEP_PART * (far - safe)


def creeping_step(plan: Plan, safe: float, rate: float) -> np.ndarray:
    """Return the voltage [V] of a large step, a long hold, the step back, and a hold."""
    level = creeping_level(plan, safe)
    up, back = way(safe, level, CREEP_WAY, rate), way(level, safe, CREEP_WAY, rate)
    held, rest = hold(level, plan.creep_duration, rate), hold(safe, BACK_PART * plan.creep_duration, rate)
    return np.concatenate([hold(safe, REST, rate), up, held, back, rest])


#: Largest RMS noise of the sensor at rest, as a fraction of the stroke.
NOISY = 0.02
#: Largest magnitude of the reading at rest, as a multiple of the stroke.
FAR_AWAY = 20.0
#: Smallest movement that counts as a response, as a multiple of the RMS noise; RMS motion up to this size after a step
#: is attributed to noise.
SEEN = 6.0
#: Smallest movement that counts as a response, as a fraction of the expected movement.
LEAST_MOVEMENT = 0.02
#: The measured gain or stroke must differ from the expected one by less than this factor, in either direction.
EXPECTED = 3.0
#: Largest RMS motion that may remain after a small step, as a fraction of the response to the step.
RINGING = 0.25
#: Relative uncertainty of a resonance fit below which averaging stops.
CERTAIN = 0.02
#: Smallest height of the peak of a resonance, relative to the static response.
STANDS_OUT = 2.0
#: Smallest number of the lowest frequencies of a response from which its gain and its delay are determined.
LOW_LINES = 20
#: The gain is determined from the frequencies below this fraction of the frequency of the highest peak, if they are
#: enough.
FAR_BELOW = 0.1
#: Largest fraction of the samples that lie within the noise of the extreme reading; above it, the sensor counts as
#: clipped.
CLIPPED = 0.03
MICRO = 1e6


def _name_unit(value: float, expected: float) -> str:
    """Return a remark if the ratio of a value to its expected value suggests a wrong unit."""
    factor = abs(value / expected)
    for power in (1e3, 1e6, 1e9):
        for ratio in (power, 1.0 / power):
            if 1.0 / EXPECTED < factor / ratio < EXPECTED:
                return f"; the factor is about {ratio:g}: does the driver use other units than m and V?"
    return ""


#: Ratio of a proposed ``frozen_samples`` to the longest repetition of a reading at rest, and its least value.
STUCK, LEAST_STUCK = 10, 20


def _most_equal(measured: np.ndarray) -> int:
    """Return the largest number of equal readings in a row."""
    changes = np.flatnonzero(np.diff(measured) != 0.0)
    return int(np.max(np.diff([-1, *changes, len(measured) - 1])))


def judge_noise(situation: Situation, recording: Recording) -> Outcome:
    """Check the sensor at rest: noise, drift, zero."""
    time, measured = recording.time - recording.time[0], recording["measured"]
    drift, zero = np.polyfit(time, measured, 1)
    rest = measured - (zero + drift * time)
    noise, stroke = float(np.std(rest)), situation.plan.stroke
    if abs(zero) > FAR_AWAY * stroke:
        raise CommissioningError(
            f"the sensor reads {readable(zero, 'm')} at rest, but a stroke of only {readable(stroke, 'm')} is expected"
            f"{_name_unit(zero, stroke)}; correct its scaling or zero, or the stroke in /commissioning"
        )
    if noise > NOISY * stroke:
        raise CommissioningError(
            f"the sensor's noise at rest is {readable(noise, 'm')} RMS, {100.0 * noise / stroke:.2g} % of the stroke: "
            "check cable, shield, range and units of the sensor, and whether something else moves the stage"
        )
    lines = [
        f"noise {1e9 * noise:.3g} nm RMS, drift {1e9 * drift:+.3g} nm/s, reads {readable(zero, 'm')} "
        f"at {situation.safe:g} V at the start"
    ]
    if noise == 0.0:
        lines.append("all readings are equal: noise below the resolution, or a sensor that does not measure the stage")
    elif not situation.axis.motion_controller.frozen_samples:
        equal = _most_equal(measured)
        lines.append(
            f"a sensor that sticks at a value is not detected; at most {equal} readings in a row are equal here, so "
            f"motion_controller may have frozen_samples: {max(STUCK * equal, LEAST_STUCK)}"
        )
    picture = Picture(
        "Sensor at rest", "time [s]", "measured − mean [nm]", [line("measured", time, 1e9 * (measured - zero))]
    )
    figures = {"noise_rms_m": noise, "drift_m_s": float(drift), "sensor_zero_m": float(zero)}
    return Outcome(lines, figures, [picture])


def judge_gain(situation: Situation, recording: Recording) -> Outcome:
    """Check the response to a small step: whether the axis moves, its gain with the sign, and whether it settles."""
    plan, noise = situation.plan, situation.figure("noise", "noise_rms_m")
    time, voltage, measured = recording.time - recording.time[0], recording["voltage"], recording["measured"]
    step, count = step_size(plan, situation.safe), round(STEP_HOLD * situation.rate)
    second = count + round(STEP_WAY * situation.rate)
    part = count // 2
    before, after = measured[count - part : count], measured[second + count - part : second + count]
    applied = float(np.mean(voltage[second + count - part : second + count]) - np.mean(voltage[count - part : count]))
    moved, expected = float(np.mean(after) - np.mean(before)), plan.gain * step
    if abs(applied) < 0.5 * abs(step):
        raise CommissioningError(
            f"a step of {step:g} V was commanded, but only {applied:.3g} V were applied; check limits and slew_rate"
        )
    if abs(moved) < max(SEEN * noise, LEAST_MOVEMENT * abs(expected)):
        raise CommissioningError(
            f"the sensor does not move with the actuator: {step:+.3g} V changed its reading by {readable(moved, 'm')}, "
            f"but {readable(expected, 'm')} were expected{_name_unit(moved, expected)}; check "
            "amplifier, cables, servo switch, and whether this sensor measures this actuator"
        )
    if moved * expected < 0.0:
        raise CommissioningError(
            f"the sign is reversed: {step:+.3g} V moved the sensor by {readable(moved, 'm')}; a loop would run away. "
            "Change the sign of sensor or amplifier (calibration of plant_simulator, docs/sensors.md) or swap its wires"
        )
    if not 1.0 / EXPECTED < moved / expected < EXPECTED:
        raise CommissioningError(
            f"the gain is {1e6 * moved / applied:.4g} µm/V, but {1e6 * plan.gain:.4g} µm/V were expected"
            f"{_name_unit(moved, expected)}; correct the scaling, or stroke and range in /commissioning"
        )
    left = float(np.std(after - np.polyval(np.polyfit(np.arange(part), after, 1), np.arange(part))))
    if left > max(SEEN * noise, RINGING * abs(moved)):
        raise CommissioningError(
            f"the stage does not settle after a step of {step:+.3g} V: it still moves by {readable(left, 'm')} "
            "RMS; switch off any other controller, and check the stage's mounting"
        )
    gain = moved / applied
    lines = [f"{applied:+.3g} V moved the stage by {readable(moved, 'm')}: {1e6 * gain:.4g} µm/V, the sign is right"]
    traces = [
        line("measured", time, MICRO * (measured - np.mean(before))),
        line(
            f"voltage × {1e6 * gain:.3g} µm/V",
            time,
            MICRO * gain * (voltage - voltage[0]),
        ),
    ]
    return Outcome(lines, {"gain_m_per_v": gain}, [Picture("Small step", "time [s]", "displacement [µm]", traces)])


def steady_periods(situation: Situation, recording: Recording) -> tuple[slice, int]:
    """Return the samples of the multisine without its first period, and the number of samples per period."""
    period = round(PERIOD * situation.rate)
    first = round(REST * situation.rate) + round(WAY * situation.rate) + period
    last = first + (PERIODS - 1) * period
    if last > len(recording):
        raise CommissioningError("the recording of the multisine is cut off; repeat the stage: --stage resonance")
    return slice(first, last), period


def judge_resonance(situation: Situation, recording: Recording) -> Outcome:
    """Evaluate a small multisine: resonance, damping, delay."""
    steady, period = steady_periods(situation, recording)
    return response_outcome(recording["voltage"][steady], recording["measured"][steady], situation.rate, period)


def response_outcome(voltage: np.ndarray, measured: np.ndarray, rate: float, period: int) -> Outcome:
    """Evaluate whole periods of a small multisine: resonance, damping, delay.

    Units: ``voltage`` [V], ``measured`` [m], ``rate`` [Hz], ``period`` [samples].
    """
    whole = multisine_response(voltage, measured, 1.0 / rate, period)
    # above EXCITED times the sample rate, the voltage contains only noise and distortion by limits
    found = whole.band(whole.frequency[0], EXCITED * rate)
    size, noise = np.abs(found.single), np.sqrt(np.ravel(np.asarray(found.noise_variance)))
    if np.median(noise / size) > 0.5:
        raise CommissioningError(
            "the response to the small multisine is below the noise: raise `small` in /commissioning, or check "
            "the sensor"
        )
    peak = int(np.argmax(size))
    # far below a resonance, but at least LOW_LINES lines, because drift and creep add to the lowest ones
    low = max(int(np.searchsorted(found.frequency, FAR_BELOW * found.frequency[peak])), LOW_LINES)
    gain = float(np.median(size[:low]))
    figures = {"gain_m_per_v": gain, "delay_s": _delay(found, peak)}
    lines = [
        f"gain of small movements {1e6 * gain:.4g} µm/V (median up to "
        f"{found.frequency[:low][-1]:.3g} Hz), delay {1e3 * figures['delay_s']:.3g} ms including "
        "the sample hold"
    ]
    if size[peak] > STANDS_OUT * gain:
        frequency, damping = _resonance(found)
        figures |= {"resonance_hz": frequency, "damping": damping}
        lines.insert(0, f"resonance at {frequency:.4g} Hz, damping {100.0 * damping:.2g} %")
    else:
        lines.insert(0, f"no resonance up to {found.frequency[-1]:.4g} Hz")
    traces = [line("measured", found.frequency, MICRO * size), line("noise", found.frequency, MICRO * noise)]
    phase = np.degrees(np.unwrap(np.angle(found.single)))
    pictures = [
        Picture("Response to small voltages", "frequency [Hz]", "gain [µm/V]", traces, "xy"),
        Picture("Phase", "frequency [Hz]", "phase [degrees]", [line("measured", found.frequency, phase)], "x"),
    ]
    return Outcome(lines, figures, pictures)


def _resonance(found: FrequencyResponse) -> tuple[float, float]:
    """Return frequency [Hz] and damping ratio of the highest peak.

    Hysteresis scatters the lines by far more than the noise, so a single line may exceed the peak. Averages over
    neighbouring lines locate the half-power band; the number of averaged lines doubles until the fit in this band is
    certain.
    """
    power, square, width = np.abs(found.single) ** 2, (2.0 * np.pi * found.frequency) ** 2, 1
    frequency, damping, uncertainty = float(found.frequency[np.argmax(power)]), 0.0, np.inf
    while uncertainty > CERTAIN and width < power.size // 4:
        kernel = np.ones(width)
        mean = np.convolve(power, kernel, "same") / np.convolve(np.ones(power.size), kernel, "same")
        peak = int(np.argmax(mean))
        # the fit uses the whole half-power band, because noise would dominate the curvature of a few lines at the flat
        # top
        low, high = np.flatnonzero(mean[:peak] < 0.5 * mean[peak]), np.flatnonzero(mean[peak:] < 0.5 * mean[peak])
        first, last = (low[-1] if low.size else 0), (peak + high[0] if high.size else power.size)
        near = slice(max(min(first, peak - 3), 0), max(last + 1, peak + 4))
        # |1/H|² = ((ω₀² − ω²)² + (2 ζ ω₀ ω)²) / g², a parabola in ω²; the uncertainty is proportional to the value
        curve = np.polyfit(square[near], 1.0 / power[near], 2, w=power[near])
        centre = -0.5 * curve[1] / curve[0]
        least = np.polyval(curve, centre) / curve[0]
        if centre > 0.0 and least > 0.0:
            scatter = 1.0 - np.polyval(curve, square[near]) * power[near]
            # the standard error: RMS of the scatter, divided by the square root of the number of lines
            if np.linalg.norm(scatter) / scatter.size < uncertainty:
                uncertainty = np.linalg.norm(scatter) / scatter.size
                frequency, damping = float(np.sqrt(centre) / (2.0 * np.pi)), float(0.5 * np.sqrt(least) / centre)
        width *= 2
    return frequency, damping


def _delay(found: FrequencyResponse, peak: int) -> float:
    """Return the delay [s] from the slope of the phase well below the highest peak."""
    low = found.frequency < 0.4 * found.frequency[peak]
    if np.count_nonzero(low) < LOW_LINES:
        low = found.frequency <= found.frequency[LOW_LINES]
    phase = np.unwrap(np.angle(found.single[low]))
    return float(-np.polyfit(2.0 * np.pi * found.frequency[low], phase, 1)[0])


def judge_hysteresis(situation: Situation, recording: Recording) -> Outcome:
    """Evaluate the decaying cycles: stroke, and width of the hysteresis loop."""
    voltage, measured = recording["voltage"], recording["measured"]
    plan, noise = situation.plan, situation.figure("noise", "noise_rms_m")
    stroke = float(np.ptp(measured))
    if not 1.0 / EXPECTED < stroke / plan.stroke < EXPECTED:
        raise CommissioningError(
            f"the whole range moved the stage by {readable(stroke, 'm')}, but {readable(plan.stroke, 'm')} "
            "were expected: check the limits of amplifier and sensor, or correct stroke and range in /commissioning"
        )
    for end, words in ((measured.max(), "highest"), (measured.min(), "lowest")):
        at_end = np.abs(measured - end) <= max(noise, 1e-6 * stroke)
        inside = (voltage > plan.minimum + 0.02 * plan.span) & (voltage < plan.maximum - 0.02 * plan.span)
        if np.mean(at_end & inside) > CLIPPED:
            raise CommissioningError(
                f"the sensor stays at its {words} reading of {readable(float(end), 'm')} while the voltage changes: "
                "its range ends there; move the sensor, or narrow minimum and maximum in /commissioning"
            )
    opening = loop_opening(voltage, measured) or 0.0
    lines = [
        f"stroke {readable(stroke, 'm')} over {voltage.min():.4g} … {voltage.max():.4g} V, loop width "
        f"{100.0 * opening / stroke:.2g} % of the stroke"
    ]
    loop = Picture("Loops", "voltage [V]", "displacement [µm]", [line("measured", voltage, MICRO * measured)])
    figures = {"stroke_m": stroke, "lowest_m": float(measured.min()), "highest_m": float(measured.max())}
    return Outcome(lines, figures | {"loop_opening_m": opening}, [loop])


def judge_creep(situation: Situation, recording: Recording) -> Outcome:
    """Evaluate the creep after a step."""
    rate, plan = situation.rate, situation.plan
    begin = round(REST * rate) + round(CREEP_WAY * rate)
    end = begin + round(plan.creep_duration * rate)
    measured = recording["measured"]
    time = recording.time[begin:end] - recording.time[begin] + CREEP_WAY
    held = measured[begin:end]
    late = time > 2.0 * CREEP_WAY
    slope, _ = np.polyfit(np.log10(time[late]), held[late], 1)
    step = float(np.mean(held[: max(round(CREEP_WAY * rate), 1)]) - np.mean(measured[: begin // 2]))
    share = float(slope) / step
    lines = [
        f"creep {100.0 * share:.2g} % of the step per decade of time, "
        f"{readable(float(held[-1] - held[0]), 'm')} in total"
    ]
    picture = Picture(
        f"After a step to {creeping_level(plan, situation.safe):.4g} V",
        "time since the step [s]",
        "displacement [µm]",
        [line("measured", time, MICRO * held)],
        "x",
    )
    return Outcome(lines, {"creep_per_decade": share}, [picture])
