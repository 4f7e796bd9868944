# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The axis of Wang, Alici & Tan 2014: published values, assumptions, and the conditions of each experiment."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.analysis.metrics import delayed
from hysteresis_ros.configuration import Configuration, load_configuration
from hysteresis_ros.laboratory.papers.runs import run
from hysteresis_ros.recordings.dataset import Recording

# Published values.
VOLTAGE = 1.0  # V, amplitude of the sines
FREQUENCIES = {"0.5π": 0.25, "π": 0.5, "2π": 1.0}  # rad/s → Hz
PUBLISHED_ALPHA = 80.0
REDUCTION = 50.0  # %, least reduction of the tracking RMS
LARGEST_ERROR = 5.0  # % of the amplitude, "about"

# Computed for a Prandtl-Ishlinskii truth whose parameters were not recorded.
DECAYING_ERRORS = {1.0: 1.04, 3.0: 0.46, 10.0: 2.19, 80.0: 3.74}  # α → RMS, % of peak-to-peak
WRONG_SIGN = (0.06, 0.12)  # RMS, of ±1
CLOSED_FORM = 1e-5

# Assumed here.
AMPLITUDE = 0.75e-3  # m, amplitude of the references: ±1 V reaches it at all three frequencies
NOISE = 1e-6  # m rms
WIDE = 10.0  # V, limits that stand for an unlimited axis
CREEP = 0.01  # per decade
#: Reference that stands for one volt while a voltage waveform is applied [m/V].
SCALE = 0.75e-3
RECORDED_CYCLES = {0.25: 3, 0.5: 3, 1.0: 4}
#: Cycles of each run; the first cycle, from rest, is not evaluated.
CYCLES = {0.25: 2, 0.5: 2, 1.0: 4}

#: Controllers in the order of the rows: configuration and words.
LINEAR, PAPER, MINOR, BETTER = "linear", "duhem80", "duhem", "pi"
CONFIGURATIONS = {LINEAR: "wang2014_linear", PAPER: "wang2014_duhem80", MINOR: "wang2014_duhem", BETTER: "wang2014"}
WORDS = {
    LINEAR: "linear, G1",
    PAPER: "Duhem, α = 80 (paper)",
    MINOR: "Duhem, α from minor loops",
    BETTER: "Prandtl-Ishlinskii",
}

TRUTH = (
    "truth: modified Prandtl-Ishlinskii element, 0.77 mm at 1 V, loop width 11 % (the numbers of the paper's tables "
    "are missing)"
)
DYNAMICS = "linear part of the truth: poles at 10 and 30 Hz, zero at 20 Hz, 200 samples/s"
RECORDED = "identified from recordings with 1 µm rms of noise, 16-bit converter, limits ±1.2 V"
REFERENCE = (
    "reference of ±0.75 mm, which ±1 V reaches at all three frequencies; the first cycle, from rest, is not evaluated"
)
IDEAL = "no noise, no quantisation, limits never reached"
HALF = "half amplitude: ±0.375 mm, or ±0.5 V"
SAME_CLASS = "Prandtl-Ishlinskii model: same class as the truth, but radii, thresholds and weights identified from data"
REAL = "limits ±1.2 V, 16-bit converters, sensor noise 1 µm rms"
SOFTENED = "“much smaller” taken as at least 50 % lower"


def controllers(configuration: Configuration | None = None) -> dict[str, Configuration]:
    """Return the axis with each of the compared controllers, by name."""
    found = {name: load_configuration(path) for name, path in CONFIGURATIONS.items()}
    return found if configuration is None else {**found, BETTER: configuration}


def ideal(configuration: Configuration) -> Configuration:
    """Return the axis without noise, quantisation and effective limits."""
    open_wide = dict(limits__minimum=-WIDE, limits__maximum=WIDE, limits__bits=0)
    clean = configuration.override("plant_simulator", sensor__noise=0.0, **open_wide)
    return clean.override("hysteresis_compensator", **open_wide)


def real(configuration: Configuration) -> Configuration:
    """Return the axis with limits and converters of the file, and noise."""
    return configuration.override("plant_simulator", sensor__noise=NOISE)


def play(configuration: Configuration, duration: float, **waveform) -> Recording:
    """Return a run that applies a voltage waveform to the plant, without any model.

    Units: ``duration`` [s].
    """
    values = {f"waveform__{name}": value for name, value in waveform.items()}
    values["waveform__amplitude"] = SCALE * waveform["amplitude"]
    played = configuration.override("motion_controller", type="open_loop", feedforward__type="none")
    played = played.override("motion_controller", feedforward__preview=0)
    direct = dict(inverse__type="none", hysteresis__type="proportional", hysteresis__proportional__gain=SCALE)
    played = played.override("hysteresis_compensator", **direct).override("reference_generator", **values)
    return run(played, duration)


def record(configuration: Configuration, duration: float, **waveform) -> tuple[np.ndarray, np.ndarray]:
    """Return voltage [V] and measured displacement [m], shape (N,) each, of :func:`play`.

    Units: ``duration`` [s].
    """
    found = play(configuration, duration, **waveform)
    return found["voltage"], found["measured"]


def record_sines(configuration: Configuration, amplitude: float = VOLTAGE):
    """Return the paper's recordings, a pair of voltage and displacement for each of the three frequencies."""
    return [
        record(configuration, cycles / frequency, type="sine", frequency=frequency, amplitude=amplitude)
        for frequency, cycles in RECORDED_CYCLES.items()
    ]


def creeping(configuration: Configuration) -> Configuration:
    """Return the axis whose plant creeps by :data:`CREEP` a decade, unknown to its controller."""
    values = dict(creep__type="logarithmic", creep__logarithmic__rate=CREEP, creep__logarithmic__longest_time=100.0)
    return configuration.override("plant_simulator", **values)


def stronger_plant(configuration: Configuration, mismatch: float) -> Configuration:
    """Return the axis with the gain of the plant multiplied by ``1 + mismatch`` after the identification."""
    names = ("weights", "thresholds")
    values = configuration.node("plant_simulator")
    scaled = {
        f"hysteresis__prandtl_ishlinskii__{name}": [
            (1.0 + mismatch) * value for value in values[f"hysteresis.prandtl_ishlinskii.{name}"]
        ]
        for name in names
    }
    return configuration.override("plant_simulator", **scaled)


def wider_plant(configuration: Configuration, mismatch: float) -> Configuration:
    """Return the axis with the plant's loops wider by ``1 + mismatch``: larger weights of all plays after the first."""
    weights = configuration.node("plant_simulator")["hysteresis.prandtl_ishlinskii.weights"]
    wider = [weights[0], *((1.0 + mismatch) * value for value in weights[1:])]
    return configuration.override("plant_simulator", hysteresis__prandtl_ishlinskii__weights=wider)


def run_sine(configuration: Configuration, frequency: float, amplitude: float, cycles: float | None = None):
    """Return a run along a sine from rest.

    Units: ``frequency`` [Hz], ``amplitude`` [m].
    """
    cycles = CYCLES[frequency] if cycles is None else cycles
    values = dict(waveform__type="sine", waveform__frequency=frequency, waveform__amplitude=amplitude)
    moved = configuration.override("reference_generator", **values)
    return run(moved, cycles / frequency)


def delayed_reference(configuration: Configuration, recording: Recording) -> np.ndarray:
    """Return the reference for the error, shape (N,) [m]: the received reference, delayed by ``preview``.

    The preview is read from ``configuration``, because reading it from the text in every recording is slower.
    """
    preview = int(configuration.node("motion_controller").get("feedforward.preview", 0))
    return delayed(recording["reference"], preview)


def tracking_error(configuration: Configuration, recording: Recording, start: float) -> np.ndarray:
    """Return the delayed reference minus the true displacement [m], beginning at ``start`` [s]."""
    error = delayed_reference(configuration, recording) - recording["displacement"]
    return error[recording.time >= start - 1e-9]


def rms(error) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(error))))
