# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The axis of Auwal et al. 2017: published values, assumptions, and the conditions of each experiment."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.analysis.metrics import delayed
from hysteresis_ros.configuration import Configuration
from hysteresis_ros.laboratory.papers.runs import run
from hysteresis_ros.models.linear import zero_order_hold
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.provenance import configured

# Published values.
G2 = ((7.4192,), (1.0, 3.2, 64.5151))  # µm/V
TABLE_1 = {"m": 0.1348, "b": 0.4313, "K": 8.6957}  # V s²/µm, V s/µm, V/µm
IDENTIFICATION = {"fit": 98.01, "mse": 0.008147, "fpe": 0.032820}  # %, µm², µm²
SAMPLES = 400
FRAME_RATE = 25.0  # Hz
DATA_SHEET = (15.4e-6, 19.4e-6)  # m at 150 V: 17.4 ± 2.0 µm
PID_GUESS = (52.6280, 70.6480, 3.9813)
PID_GAINS = (50.1370, 84.4050, 3.9926)
TUNING_ITERATIONS = 50
IAE = {"none": 67.73e-6, "pid": 3.099e-6, "inverse": 1.478e-6}  # m s
REDUCTION = {"pid": 95.42, "inverse": 97.82}  # %

# Computed for the assumptions below.
LIMITED_IAE = {"pid": 9.65e-6, "inverse": 8.09e-6}  # m s, 0 … 150 V
#: Lowest and highest reduction of the error [%] by an inverse whose model has the given relative error in one
#: parameter.
OFF = {("d_e", 0.01): (92.0, 93.0), ("alpha", 0.05): (85.0, 87.0)}
STROKE_150 = 17.19e-6  # m
MISPRINTED = 93.9e-6  # m
NATURAL_FREQUENCY = 64.5151**0.5  # rad/s, 1.28 Hz
DAMPING = 0.20

# Assumed here.
PEAK_VOLTAGE = 125.0  # V
PERIOD = 46.3  # s
HEIGHT = PEAK_VOLTAGE / TABLE_1["K"] * 1e-6  # m
SLOW_RATE = 100.0  # Hz, rows under realistic conditions
FAST_RATE = 500.0
HONEST_FREQUENCY = 0.1  # Hz
ALLOWED = (0.0, 150.0)  # V, data sheet
NEGATIVE = (-30.0, 150.0)
NOISE = 5e-9  # m rms
CAMERA_NOISE = 50e-9  # m rms
BITS = 16
CREEP = 0.015  # per decade

#: Labels of the control schemes.
METHODS = {
    "none": "V = K ψ",
    "pid": "PID",
    "inverse": "inverse",
    "combined": "inverse with PID and feedforward",
    "dynamic": "combination with inverse dynamics",
}

TRIANGLE = "one triangle 0 → 14.375 µm (125 V/K) → 0 in 46.3 s; this period was fitted to the first IAE"
SAMPLED = "discrete controller at 500 Hz, voltage held between samples; the paper's controller is continuous"
FILTERED = "derivative filter 100 rad/s, derivative of the error"
UNLIMITED = "no limit of the voltage, no noise, compensator's model equal to the plant"
GAIN = "uncompensated drive V = K ψ"
CORRECTED = "|V̇| h where the paper prints |V̇| V"
SYNTHETIC = (
    "synthetic instead of the paper's recording, which is not available: 400 samples of G4 at 25 Hz, a triangle of 8 s "
    "and a 1 Hz square of 8 s to 125 V, white noise of the paper's mean square error"
)
LOADED = (
    "synthetic instead of the paper's recording, which is not available: one loading and unloading to 150 V of 400 "
    "samples, noise 10 nm rms"
)
RATES = (
    "rows under realistic conditions: 100 Hz for triangles up to 0.1 Hz, else 500 Hz; the held voltage adds half a "
    "sample of lag"
)
STACK_LIMITS = "limits −30 … 150 V; such stacks tolerate about −30 V"
DATA_SHEET_LIMITS = "limits 0 … 150 V"
CREEPING = "logarithmic creep of 1.5 % per decade in the plant, none in the compensator's model"
NOISY = "sensor noise 5 nm rms, 16-bit converters over the range between the limits"
CAMERA = "camera: 25 frames per second, 50 nm rms of noise, no delay; the whole axis runs at 25 Hz"


def at_rate(configuration: Configuration, rate: float) -> Configuration:
    """Return the axis sampled at ``rate`` [Hz]; the dynamics of plant and model are discretised again from G2."""
    (gain,), (_, damping, stiffness) = G2
    A, B = zero_order_hold([[0.0, 1.0], [-stiffness, -damping]], [0.0, gain], 1.0 / rate)
    changed = configuration.override("", sample_rate=rate)
    matrices = {"A": A.ravel().tolist(), "B": B.ravel().tolist()}
    dynamics = {f"dynamics__{name}": value for name, value in {**matrices, "sample_time": 1.0 / rate}.items()}
    changed = changed.override("plant_simulator", **dynamics)
    return changed.override("motion_controller", **{f"model__{name}": value for name, value in dynamics.items()})


def limited(configuration: Configuration, minimum: float, maximum: float, bits: int = 0) -> Configuration:
    """Return the axis with these limits of the voltage [V] and this resolution of the converters [bits]."""
    values = dict(limits__minimum=minimum, limits__maximum=maximum, limits__bits=bits)
    return configuration.override("plant_simulator", **values).override("hysteresis_compensator", **values)


def noisy(configuration: Configuration, noise: float) -> Configuration:
    """Return the axis with sensor noise [m rms]."""
    return configuration.override("plant_simulator", sensor__noise=noise)


def creeping(configuration: Configuration) -> Configuration:
    """Return the axis with creep in the plant but not in the compensator's model."""
    return configuration.override("plant_simulator", creep__type="logarithmic", creep__logarithmic__rate=CREEP)


def off(configuration: Configuration, name: str, part: float) -> Configuration:
    """Return the axis with a relative error ``part`` of the compensator's parameter ``name``."""
    value = configuration.node("hysteresis_compensator")[f"hysteresis.bouc_wen.{name}"]
    return configuration.override("hysteresis_compensator", **{f"hysteresis__bouc_wen__{name}": value * (1.0 + part)})


def driven(configuration: Configuration, method: str) -> Configuration:
    """Return the axis with one of the control schemes :data:`METHODS`."""
    if method in ("none", "pid"):
        proportional = dict(hysteresis__type="proportional", hysteresis__proportional__gain=1e-6 / TABLE_1["K"])
        configuration = configuration.override("hysteresis_compensator", inverse__type="none", **proportional)
    if method == "combined":
        configuration = configuration.override("motion_controller", feedforward__type="static")
    if method == "dynamic":
        preview = dict(feedforward__type="inverse_dynamics", feedforward__preview=1)
        configuration = configuration.override("motion_controller", **preview)
    controller = "open_loop" if method in ("none", "inverse") else "pid"
    return configuration.override("motion_controller", type=controller)


def run_triangle(
    configuration: Configuration, height: float = HEIGHT, period: float = PERIOD, cycles: int = 1
) -> Recording:
    """Return a run of triangles from 0 to ``height`` [m], ``period`` seconds each."""
    values = dict(waveform__amplitude=height, waveform__frequency=1.0 / period, waveform__cycles=cycles)
    return run(configuration.override("reference_generator", **values), period * cycles)


def run_sine(configuration: Configuration, offset: float, amplitude: float, frequency: float, cycles: int) -> Recording:
    """Return a run of a sine around ``offset`` [m] that begins at its lowest point."""
    values = dict(waveform__type="sine", waveform__offset=offset, waveform__amplitude=amplitude)
    values |= dict(waveform__frequency=frequency, waveform__cycles=cycles, waveform__phase=-0.5 * np.pi)
    return run(configuration.override("reference_generator", **values), cycles / frequency)


def iae(recording: Recording) -> float:
    """Return the integral of the absolute error [m s]: delayed reference minus true displacement."""
    return float(mean_error(recording) * recording.time.size * recording.sample_time)


def error(recording: Recording) -> np.ndarray:
    """Return the reference, delayed by the preview, minus the true displacement [m], shape (N,)."""
    preview = int(configured(recording.configuration, "motion_controller").get("feedforward.preview", 0))
    return delayed(recording["reference"], preview) - recording["displacement"]


def mean_error(recording: Recording) -> float:
    """Return the mean absolute error [m]."""
    return float(np.mean(np.abs(error(recording))))


def reduction(value: float, without: float) -> float:
    """Return by how much ``value`` is smaller than ``without`` [%]."""
    return 100.0 * (1.0 - value / without)
