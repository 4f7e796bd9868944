# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Plants of other classes than any model, and what a user gets to know of one: a recording, and what is fitted to it.

The way is that of a user: :func:`recorded` drives the plant and measures through its sensor; :func:`identified` is
given nothing but that recording and the data sheet of the bench, and runs the default identification.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.comparison.candidates import Known, known
from hysteresis_ros.comparison.plants import ForeignPlant
from hysteresis_ros.comparison.tasks import Conditions
from hysteresis_ros.configuration import parse_configuration
from hysteresis_ros.identification.workflow import identify
from hysteresis_ros.loop.plant_parameters import PlantNodeParameters
from hysteresis_ros.models.foreign import HYSTERESES, ForeignParameters
from hysteresis_ros.models.limits import Limits
from hysteresis_ros.models.sensor import Sensor
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.references.recipes import recipe
from hysteresis_ros.references.waveforms import Waveform, WaveformParameters
from hysteresis_ros.simulation.between_samples import INSTANTS

#: Plants that are drawn around each one, besides itself and its worst corners.
DRAWS = 3
#: Factors that a plant may deviate by, and what of :class:`ForeignParameters` each is on.
GAIN, OPENING, TIMES, CREEP = range(4)


@dataclass(frozen=True)
class Bench:
    """What the data sheets of amplifier, converters and sensor say.

    Parameters
    ----------
    sample_rate : float
        [Hz]
    voltage : float
        Highest voltage of the amplifier [V]; the lowest is 0.
    bits : int
        Of the converter; 0: unlimited.
    noise, resolution : float
        Of the sensor [m].
    """

    sample_rate: float = 2000.0
    voltage: float = 100.0
    bits: int = 16
    noise: float = 5e-9
    resolution: float = 1e-9

    def node(self, seed: int) -> PlantNodeParameters:
        """Return limits and sensor as the parameters of a plant.

        Parameters
        ----------
        seed : int
            Of the noise.
        """
        return PlantNodeParameters.from_mapping(
            {
                "sample_rate": self.sample_rate,
                "limits.minimum": 0.0,
                "limits.maximum": self.voltage,
                "limits.bits": self.bits,
                "sensor.noise": self.noise,
                "sensor.resolution": self.resolution,
                "sensor.seed": seed,
                "hysteresis.type": "proportional",
                "hysteresis.proportional.gain": 1e-7,
            }
        )


def drawn(seed: int, bench: Bench) -> ForeignPlant:
    """Return a plant of another class; the class of its hysteresis goes round with the seed.

    Parameters
    ----------
    seed : int
        Equal seeds give equal plants.
    bench : Bench
    """
    random = np.random.default_rng((seed, 1))
    sample_time = 1.0 / bench.sample_rate

    def between(low, high):
        return float(low * (high / low) ** random.uniform())

    actuator = ForeignParameters(
        hysteresis=HYSTERESES[seed % len(HYSTERESES)],
        stroke=between(15e-6, 60e-6),
        voltage=bench.voltage,
        opening=between(0.1, 0.16),
        asymmetry=between(0.1, 0.2),
        rate=between(0.2, 0.6),
        creep=between(0.02, 0.05),
        exponent=between(0.12, 0.3),
        lag=between(0.5e-3, 2e-3),
        lag_before=bool(random.integers(2)),
        delay=between(1.0, 1.8) * sample_time,
        frequencies=(between(180.0, 450.0), between(1100.0, 1900.0)),
        dampings=(between(0.02, 0.04), between(0.01, 0.03)),
        share=between(0.03, 0.12),
        steps=INSTANTS,
    )
    return ForeignPlant(bench.node(seed), actuator)


def around(plant: ForeignPlant, mismatch: float, seed: int) -> list[ForeignPlant]:
    """Return the plant, then what may have become of it since it was recorded: its worst corners, and a few draws.

    Gain, opening of the hysteresis, all times of lag, delay and modes, and the creep deviate each by up to the
    mismatch; a corner is where the first three do so fully, and the creep with the gain.

    Parameters
    ----------
    plant : ForeignPlant
    mismatch : float
    seed : int
        Of the draws.
    """
    random = np.random.default_rng((seed, 2))
    signs = [(*corner, corner[0]) for corner in itertools.product((-1.0, 1.0), repeat=3)]
    signs += list(random.uniform(-1.0, 1.0, (DRAWS, 4)))
    found = [plant]
    for number, factors in enumerate(1.0 + mismatch * np.array(signs), 1):
        sensor = replace(plant.parameters.sensor, seed=seed + 1000 * number)
        parameters = replace(plant.parameters, sensor=sensor)
        found.append(replace(plant, parameters=parameters, actuator=_deviated(plant.actuator, factors)))
    return found


def _deviated(actuator: ForeignParameters, factors) -> ForeignParameters:
    return replace(
        actuator,
        stroke=actuator.stroke * factors[GAIN],
        opening=actuator.opening * factors[OPENING],
        lag=actuator.lag * factors[TIMES],
        delay=actuator.delay * factors[TIMES],
        frequencies=tuple(frequency / factors[TIMES] for frequency in actuator.frequencies),
        creep=actuator.creep * factors[CREEP],
    )


def excitation(bench: Bench) -> np.ndarray:
    """Return the voltages [V] that a user would record with: minor loops, then many frequencies, then steps.

    Parameters
    ----------
    bench : Bench
    """
    rate = bench.sample_rate
    sample_time, parts = 1.0 / rate, []
    for name, changes in (
        ("decaying", {"frequency": 6.0}),
        ("multisine", {"frequency": 1.0, "duration": 2.0}),
        ("steps", {"duration": 1.5}),
    ):
        made = recipe(name, 0.0, bench.voltage, rate, **changes)
        if made.samples is None:
            waveform = Waveform(WaveformParameters.from_mapping(made.waveform), sample_time)
            parts.append(waveform.simulate(np.zeros(round(made.duration * rate))))
        else:
            parts.append(made.samples)
    return np.concatenate(parts)


def recorded(plant: ForeignPlant, bench: Bench, seed: int) -> Recording:
    """Return what converter and sensor see of a plant under the excitation.

    Parameters
    ----------
    plant : ForeignPlant
    bench : Bench
    seed : int
        Of the noise.
    """
    sample_time, node = 1.0 / bench.sample_rate, bench.node(seed)
    voltage = Limits(node.limits, sample_time).simulate(excitation(bench))
    # what is measured at a sample follows from the voltages before it
    displacement = np.concatenate([[0.0], plant.between(voltage)[:-1, -1]])
    measured = Sensor(node.sensor, sample_time).simulate(displacement)
    units = {"voltage": "V", "measured": "m"}
    return Recording(np.arange(len(voltage)) * sample_time, {"voltage": voltage, "measured": measured}, units, {})


def identified(recording: Recording, bench: Bench) -> Known:
    """Return what is known of a plant from a recording of it, by the default identification.

    Parameters
    ----------
    recording : Recording
    bench : Bench

    Raises
    ------
    IdentificationError
        The recording cannot be used.
    """
    found = identify(recording)
    configuration = parse_configuration(found.text, "the identified model")
    limits = {"limits__minimum": 0.0, "limits__maximum": bench.voltage}
    return known(configuration.override("hysteresis_compensator", **limits), bench.bits)


def conditions_bench(conditions: Conditions) -> Bench:
    """Return the usual bench under these conditions.

    Parameters
    ----------
    conditions : Conditions
    """
    return Bench(bits=conditions.bits, noise=conditions.noise)
