# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Identification of the axis of Wang, Alici & Tan 2014 from simulated recordings of the assumed true plant; its files.

``python -m hysteresis_ros.laboratory.papers.wang2014.identification`` makes the recordings, identifies the four models
and prints what it found; with ``-o DIR`` it writes ``wang2014.yaml`` (Prandtl-Ishlinskii), ``wang2014_duhem.yaml`` (α
from minor loops), ``wang2014_duhem80.yaml`` (the paper's) and ``wang2014_linear.yaml`` there. Only two parameters of
the truth are used, because an experimenter knows them too: voltage range and sample time.
"""

from __future__ import annotations

import argparse
import pathlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hysteresis_ros.configuration import Configuration, load_configuration
from hysteresis_ros.identification.duhem import (
    PUBLISHED_ALPHA,
    DuhemHammerstein,
    DuhemIdentification,
    LoopOperator,
    MajorLoop,
    fit_networks,
    identify_duhem,
    identify_duhem_hammerstein,
    identify_inverse_duhem,
)
from hysteresis_ros.identification.prandtl_ishlinskii import fit_prandtl_ishlinskii
from hysteresis_ros.identification.transfer_function import Structure, fit_transfer_function
from hysteresis_ros.laboratory.papers.runs import SAMPLE_TIME
from hysteresis_ros.laboratory.papers.wang2014 import axis as wang
from hysteresis_ros.laboratory.papers.wang2014.model import linear_response
from hysteresis_ros.models.hysteresis.duhem import DuhemHysteresis, DuhemParameters
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis, PrandtlIshlinskiiParameters
from hysteresis_ros.models.linear import LinearParameters


def polymer_truth(plays: int = 40) -> PrandtlIshlinskiiParameters:
    """Return a modified Prandtl-Ishlinskii element for ±1 V (W7; assumption, the paper's numbers are lost)."""
    radii = np.arange(plays) / plays
    weights = np.exp(-1.5 * radii) / plays
    weights[0] = 0.6
    thresholds = np.concatenate([-np.linspace(0.05, 0.7, 12)[::-1], np.linspace(0.05, 0.7, 12)])
    zones = np.concatenate([np.full(12, 0.008), np.full(12, -0.013)])
    scale = 1e-3  # the tip of the polymer bends by about a millimetre
    return PrandtlIshlinskiiParameters(tuple(radii), tuple(scale * weights), tuple(scale * thresholds), tuple(zones))


@dataclass(frozen=True)
class PaperW:
    """Duhem model of a modified Prandtl-Ishlinskii element, and its errors as fractions of the full range."""

    #: identified, published: Models with α from a decaying loop, and with the paper's α = 80.
    identified: DuhemIdentification
    published: DuhemIdentification
    inverse: DuhemIdentification  #: Inverse model, from step W4.
    opening: float  #: Loop width.
    compensated: float  #: Largest error along the major loop of the inverse followed by the truth.
    #: decaying, decaying_published: Rms error on held-out decaying loops, with the identified and with the paper's α.
    decaying: float
    decaying_published: float


def paper_w(shape: str = "network", size: int | None = None, seed: int = 0) -> PaperW:
    """Identify the Duhem model, its inverse and α (W3, W4, W7) from sines and one decaying loop."""
    truth = polymer_truth()

    def passed(voltage):
        return PrandtlIshlinskiiHysteresis(truth, SAMPLE_TIME).simulate(voltage)

    cycle = np.sin(2.0 * np.pi * np.arange(1000) / 1000.0)
    major = np.tile(cycle, 3)
    decaying = np.concatenate([cycle, np.tile(cycle, 6) * np.linspace(1.0, 0.02, 6000)])
    unseen = np.concatenate([cycle, np.tile(cycle, 10) * np.exp(-np.arange(10000) / 4000.0)])
    arguments: dict[str, Any] = dict(minor=(decaying, passed(decaying)), shape=shape, size=size, seed=seed)
    identified = identify_duhem(major, passed(major), **arguments)
    published = identify_duhem(major, passed(major), alpha=PUBLISHED_ALPHA, **arguments)
    inverse = identify_inverse_duhem(major, passed(major), **arguments)

    y = passed(major)
    full = float(np.ptp(y))
    wanted = y[1000:]
    block = DuhemHysteresis(inverse.parameters, SAMPLE_TIME)
    drive = block.simulate(y)
    reached = passed(drive)[1000:]

    def misfit(result):
        after = slice(250, None)  # the first quarter cycle comes from rest
        error = DuhemHysteresis(result.parameters, SAMPLE_TIME).simulate(unseen) - passed(unseen)
        return float(np.sqrt(np.mean(error[after] ** 2))) / full

    return PaperW(
        identified=identified,
        published=published,
        inverse=inverse,
        opening=identified.loop.opening,
        compensated=float(np.max(np.abs(reached - wanted))) / full,
        decaying=misfit(identified),
        decaying_published=misfit(published),
    )


UNITS = 12  # hidden units of each network
PLAYS = 14
ZONES = 6
DYNAMIC_VOLTAGE = 0.7  # V, of the sweep
SWEEP = (0.3, 8.0, 15.0)  # Hz, Hz, s
DECAYING = (0.3, 8)  # Hz, cycles
#: Digits of a model's numbers in the files.
DIGITS = 10


@dataclass(frozen=True)
class Models:
    """Results of the identification."""

    published: DuhemHammerstein  #: Steps W1, W2, W3 and W5 with α = 80, from the three sines.
    inverse: DuhemParameters  #: Step W4: from the displacement of the hysteresis [m] to the voltage.
    minor: DuhemParameters  #: Duhem model with α from loops of decreasing amplitude.
    minor_alpha: float  #: α of ``minor``, for a normalised input.
    minor_dynamics: LinearParameters  #: Linear part for ``minor``, from a sweep.
    plays: PrandtlIshlinskiiParameters  #: Prandtl-Ishlinskii model from loops of decreasing amplitude.
    plays_dynamics: LinearParameters  #: Linear part for ``plays``, from a sweep.


def record_decreasing(configuration: Configuration):
    """Return voltage and displacement of triangles whose amplitude decreases: a major loop, then minor loops."""
    frequency, cycles = DECAYING
    values = dict(type="decreasing_triangle", polarity="symmetric", frequency=frequency, cycles=cycles)
    return wang.record(configuration, cycles / frequency, amplitude=wang.VOLTAGE, **values)


def record_sweep(configuration: Configuration):
    """Return voltage and displacement of a sweep that excites the linear part."""
    low, high, duration = SWEEP
    values = dict(type="chirp", frequency=low, chirp__final_frequency=high, chirp__duration=duration)
    return wang.record(configuration, duration, amplitude=DYNAMIC_VOLTAGE, **values)


def identify_published(sines, sample_time: float) -> tuple[DuhemHammerstein, DuhemParameters]:
    """Execute the paper's steps W1-W5 with α = 80.

    Units: ``sample_time`` [s].
    """
    found = identify_duhem_hammerstein(sines, sample_time, alpha=wang.PUBLISHED_ALPHA, size=UNITS, minimum_phase=True)
    prepared = found.prepared
    inverse = identify_inverse_duhem(
        prepared.voltage, prepared.displacement, alpha=wang.PUBLISHED_ALPHA, size=UNITS
    ).parameters
    gain = found.linear.model.dc_gain
    return found, replace(
        inverse,
        alpha=inverse.alpha / gain,
        input_low=gain * inverse.input_low,
        input_high=gain * inverse.input_high,
        input_start=0.0,
        output_start=0.0,
    )


def identify_minor(sines, decreasing, sweep, sample_time: float) -> tuple[DuhemParameters, float, LinearParameters]:
    """Identify α with f and g from minor loops, and the linear part from a sweep.

    Units: ``sample_time`` [s].
    """
    found = identify_duhem_hammerstein(sines, sample_time, minor=decreasing, size=UNITS)
    model = replace(found.hysteresis.parameters, input_start=0.0, output_start=0.0)
    passed = DuhemHysteresis(model, sample_time).simulate(sweep[0])
    dynamics, _ = _dynamics(passed, sweep[1], sample_time)
    # the sweep does not reach the ends of the loop, so the gain comes from the recording of the loop
    gain = 1.0 / float(abs(linear_response(dynamics, [min(wang.RECORDED_CYCLES)])[0]))
    model = replace(model, output_low=gain * model.output_low, output_high=gain * model.output_high)
    return model, found.hysteresis.alpha, dynamics


def identify_plays(decreasing, sweep, sample_time: float) -> tuple[PrandtlIshlinskiiParameters, LinearParameters]:
    """Identify plays and dead zones from loops of decreasing amplitude, and the linear part from a sweep.

    Units: ``sample_time`` [s].
    """
    u, y = decreasing
    found = fit_prandtl_ishlinskii(u, y, sample_time, play_count=PLAYS, zone_count=ZONES, linear=("lag",))
    model = found.hysteresis.prandtl_ishlinskii
    passed = PrandtlIshlinskiiHysteresis(model, sample_time).simulate(sweep[0])
    dynamics, gain = _dynamics(passed, sweep[1], sample_time)
    scaled = {name: tuple(gain * value for value in getattr(model, name)) for name in ("weights", "thresholds")}
    return replace(model, offset=gain * model.offset, **scaled), dynamics


def _dynamics(w, y, sample_time) -> tuple[LinearParameters, float]:
    """Return second-order dynamics of unit gain between ``w`` and ``y`` by output error, and their gain."""
    model = fit_transfer_function(w, y, sample_time, Structure(2, 1)).discrete()
    return replace(model.linear_parameters(), sample_time=sample_time), float(model.dc_gain)


def identify(configuration: Configuration) -> Models:
    """Make all recordings and identify all models."""
    plant = wang.real(configuration)
    sample_time = 1.0 / plant.node("plant_simulator")["sample_rate"]
    sines, decreasing, sweep = wang.record_sines(plant), record_decreasing(plant), record_sweep(plant)
    published, inverse = identify_published(sines, sample_time)
    return Models(
        published,
        inverse,
        *identify_minor(sines, decreasing, sweep, sample_time),
        *identify_plays(decreasing, sweep, sample_time),
    )


class _Watched(LoopOperator):
    """Stores the rms error on the loop of every tried network."""

    def __init__(self, loop: MajorLoop, alpha: float):
        super().__init__(loop.grid, alpha, loop.rising[0])
        self.target = np.concatenate([loop.rising, loop.falling[::-1]])
        self.history: list[float] = []

    def output(self, f, g):
        found = super().output(f, g)
        self.history.append(wang.rms(found - self.target))
        return found


def training_history(loop: MajorLoop, alpha: float) -> np.ndarray:
    """Return the smallest rms error so far (range ±1) at each evaluation of a training of f and g, shape (K,)."""
    watched = _Watched(loop, alpha)
    fit_networks(watched, watched.target, UNITS, np.random.default_rng(0), loop.noise)
    return np.minimum.accumulate(watched.history)


def _flat(values) -> str:
    numbers = [values] if np.ndim(values) == 0 else values
    texts = []
    for number in numbers:
        text = f"{number:.{DIGITS}g}"
        if "e" in text:
            digits, exponent = text.split("e")
            text = f"{digits if '.' in digits else digits + '.0'}e{exponent}"
        elif "." not in text:
            text += ".0"
        texts.append(text)
    return texts[0] if np.ndim(values) == 0 else f"[{', '.join(texts)}]"


def _lines(parameters, names, indent: int) -> str:
    rows = []
    for name in names:
        value = getattr(parameters, name)
        if np.size(value) == 0:
            continue
        rows.append(f"{' ' * indent}{name}: {value if isinstance(value, str) else _flat(value)}")
    return "\n".join(rows)


_DUHEM = tuple(DuhemParameters.__dataclass_fields__)
_PLAYS = ("radii", "weights", "thresholds", "zone_weights", "offset")
_LINEAR = ("A", "B", "C", "D", "output_scale", "input_scale", "sample_time")


def files(models: Models, text: str) -> dict[str, str]:
    """Return the texts of the four parameter files: the text of ``wang2014``, with the models of each file."""
    published = models.published
    linear_gain = published.linear_only.model.dc_gain
    duhem80, dynamics80 = published.parameters
    duhem80 = replace(duhem80, input_start=0.0, output_start=0.0)

    def hysteresis(kind, lines, inverse="exact", more=""):
        head = f"    inverse:\n      type: {inverse}\n{more}"
        return f"{head}    hysteresis:\n      type: {kind}\n      {kind}:\n{lines}\n"

    compensators = {
        wang.BETTER: hysteresis("prandtl_ishlinskii", _lines(models.plays, _PLAYS, 8)),
        wang.MINOR: hysteresis("duhem", _lines(models.minor, _DUHEM, 8), "general"),
        wang.PAPER: hysteresis(
            "duhem", _lines(duhem80, _DUHEM, 8), "duhem", f"      duhem:\n{_lines(models.inverse, _DUHEM, 8)}\n"
        ),
        wang.LINEAR: hysteresis("proportional", f"        gain: {_flat(linear_gain)}", "none"),
    }
    dynamics = {
        wang.BETTER: models.plays_dynamics,
        wang.MINOR: models.minor_dynamics,
        wang.PAPER: dynamics80,
        wang.LINEAR: published.linear_only.model.linear_parameters(),
    }
    titles = {
        wang.BETTER: "Prandtl-Ishlinskii model from loops of decreasing amplitude, linear part from a sweep",
        wang.MINOR: f"Duhem model, alpha = {models.minor_alpha:.3g} from minor loops, linear part from a sweep",
        wang.PAPER: "the paper's: Duhem model and inverse Duhem model with alpha = 80, G2 from the three sines",
        wang.LINEAR: "the paper's linear inverse: G1 from the three sines, no compensation of hysteresis",
    }
    found = {}
    for name, path in wang.CONFIGURATIONS.items():
        replaced = replace_identified(text, "title", f"# Controller: {titles[name]}\n")
        replaced = replace_identified(replaced, "compensator", compensators[name])
        replaced = replace_identified(
            replaced,
            "dynamics",
            _lines(replace(dynamics[name], sample_time=published.linear.sample_time), _LINEAR, 8) + "\n",
        )
        found[path] = replaced
    return found


def replace_identified(text: str, mark: str, lines: str) -> str:
    """Return the text of a file with new lines in one of its identified parts."""
    begin, end = f"# identified: {mark}\n", f"# end: {mark}\n"
    before, rest = text.split(begin)
    inside, after = rest.split(end)
    indent = before[before.rfind("\n") + 1 :]
    return f"{before}{begin}{lines}{indent}{end}{after}"


def main() -> None:
    """Identify, print a summary, and write the files on request."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=pathlib.Path, help="folder for the four parameter files")
    arguments = parser.parse_args()
    configuration = load_configuration("wang2014")
    models = identify(configuration)
    published = models.published
    for name, fit in (("G1", published.linear_only), ("G2", published.linear)):
        print(f"{name}: numerator {_flat(fit.numerator)}, denominator {_flat(fit.denominator)}, zeros {fit.zeros}")
    for frequency, linear, duhem in zip(wang.FREQUENCIES, published.linear_only_rms, published.rms, strict=True):
        print(f"{frequency} rad/s: RMS error of the model {1e6 * linear:.2f} µm linear, {1e6 * duhem:.2f} µm Duhem")
    print(f"alpha from minor loops: {models.minor_alpha:.4g}")
    for warning in published.warnings:
        print(f"warning: {warning}")
    if arguments.output is not None:
        for name, text in files(models, configuration.original).items():
            (arguments.output / f"{name}.yaml").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
