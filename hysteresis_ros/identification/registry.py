# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Identification by the name of a model, which declares its procedure, options and inverses.

Before any fit the sign is checked by the gain of slow movement, whose phase neither lag nor resonance changes. Other
causes of movement (other inputs, vibration, drift) count as noise: the gain is that of the narrowest band, from the
lowest frequency up, in which it clearly exceeds its standard deviation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hysteresis_ros.errors import IdentificationError, did_you_mean
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.dynamics import STAGES
from hysteresis_ros.identification.plant_model import Identification, Request
from hysteresis_ros.models.declaration import PARTS, HysteresisModel
from hysteresis_ros.models.hysteresis import MODELS
from hysteresis_ros.registry import resolved
from hysteresis_ros.units import readable

#: Fraction of the input's power in the first band; each further band has twice as many frequencies.
FIRST_BAND = 0.01
#: Distance of the gain from zero, in standard deviations, at which its sign is certain.
CERTAIN = 3.0


class SlowGain(NamedTuple):
    """Gain of slow movement."""

    gain: float  #: gain, deviation: In the output's unit per input's unit.
    deviation: float
    highest: float  #: Upper end of its band [Hz].

    @property
    def certain(self) -> bool:
        """Whether the sign of the gain is certain."""
        return abs(self.gain) > CERTAIN * self.deviation


def slow_gain(u, y, sample_time: float) -> SlowGain:
    """Return the gain of the slowest movement that exceeds the disturbances of the output, or of all movement.

    Units: ``sample_time`` [s].
    """
    window = np.hanning(len(u))
    U, Y = (np.fft.rfft(window * (values - values.mean()))[1:] for values in (u, y))
    power = np.abs(U) ** 2
    first = int(np.searchsorted(np.cumsum(power), FIRST_BAND * power.sum())) + 1
    ends = [*(first * 2 ** np.arange(int(np.log2(len(U) / first)) + 1)).tolist(), len(U)]
    for end in ends:
        size = float(power[:end].sum())
        gain = float(np.real(Y[:end] @ np.conj(U[:end]))) / size
        left = np.abs(Y[:end] - gain * U[:end]) ** 2
        found = SlowGain(gain, float(np.sqrt(0.5 * (power[:end] @ left))) / size, end / (len(u) * sample_time))
        if found.certain:
            break
    return found


#: Name that selects the best predicting model.
AUTO = "auto"
#: Name of the default choice; the model that determines its parts, options and inverses; and the procedure that
#: compares this model with its competitors.
USUAL, FIRST, RIVALS = "usual", "prandtl_ishlinskii", "hysteresis_ros.identification.procedures:usual"
#: Names of sets of parts.
WORDS = {"none": (), "auto": PARTS}


def find_model(name: str) -> HysteresisModel:
    """Return the model of that name."""
    name = FIRST if name == USUAL else name
    if name not in MODELS:
        near = did_you_mean(name, MODELS)
        allowed = f"must be one of {', '.join(MODELS)}, or {USUAL} or {AUTO} to identify"
        raise IdentificationError(f"model {name!r}: {allowed}{near}")
    return MODELS[name]


def linear_words(model: HysteresisModel) -> tuple[str, ...]:
    """Return the parts and stages that may follow a model."""
    return (*model.parts, *(STAGES if model.stages else ()))


def parse_linear(model: str, words: str | None) -> tuple[tuple[str, ...], str | None]:
    """Return the parts that may be fitted with the hysteresis, and the stage after it or None."""
    entry = find_model(model)
    linear = linear_words(entry)
    words = words or "auto"
    if words in WORDS:
        return tuple(part for part in WORDS[words] if part in entry.parts), None
    given = tuple(word.strip() for word in words.split(","))
    unknown = [word for word in given if word not in (*PARTS, *STAGES)]
    if unknown:
        raise IdentificationError(
            f"linear {', '.join(unknown)}: must be auto, none, a list of {', '.join(PARTS)} (separated by commas), or "
            f"one of {', '.join(STAGES)}{did_you_mean(unknown[0], ('auto', 'none', *PARTS, *STAGES))}"
        )
    refused = [word for word in given if word not in linear]
    if refused:
        allowed = ", ".join(("auto", "none", *linear))
        raise IdentificationError(f"linear {', '.join(refused)} cannot be used with {model}; allowed: {allowed}")
    stages = [word for word in given if word in STAGES]
    if stages and len(given) > 1:
        raise IdentificationError(
            f"linear {words}: {stages[0]} cannot be combined, because it already includes lag and delay"
        )
    return (() if stages else given), (stages[0] if stages else None)


def parse_options(model: str, pairs) -> dict:
    """Return the options of a model from words ``name=value``."""
    if model == AUTO:
        if given := list(pairs):
            raise IdentificationError(
                f"option {given[0]!r}: model {AUTO} has no options; name a model to set its options"
            )
        return {}
    options, entry = {}, find_model(model)
    for pair in pairs:
        name, mark, text = pair.partition("=")
        if not mark or name not in entry.options:
            there = ", ".join(entry.options) or "none"
            near = did_you_mean(name, entry.options)
            raise IdentificationError(f"option {pair!r}: write name=value; options of {entry.name}: {there}{near}")
        options[name] = entry.options[name].convert(name, text)
    return options


def identify(
    data: IdentificationData,
    model: str,
    *,
    linear: str | None = None,
    options: dict | None = None,
    inverse: str | None = None,
    skip: int | None = None,
    intersample: str = "zoh",
    initial: str | None = None,
    progress=None,
    separations: dict | None = None,
) -> Identification:
    """Identify a model by its name."""
    entry = find_model(model)
    inverse = inverse or entry.inverses[0]
    if inverse not in entry.inverses:
        near = did_you_mean(inverse, entry.inverses)
        raise IdentificationError(f"inverse {inverse!r}: {model} has {', '.join(entry.inverses)}{near}")
    parts, stage = parse_linear(model, linear)
    if entry.block.invertible:
        _refuse_falling(data)
    competitors = model == USUAL and not options
    request = Request(
        model=entry.name,
        parts=parts,
        stage=stage,
        options=dict(options or {}),
        inverse=inverse,
        skip=skip,
        intersample=intersample,
        initial=initial,
        progress=progress or (lambda *_: None),
        separations={} if separations is None else separations,
    )
    return resolved(RIVALS if competitors else entry.identify)(data, request)


def _refuse_falling(data: IdentificationData) -> None:
    """Refuse an output that falls with rising input: no model of this package describes it."""
    found = slow_gain(data.input, data.output, data.sample_time)
    if found.certain and found.gain < 0.0:
        size, deviation = (readable(value, data.output_unit) for value in (-found.gain, found.deviation))
        raise IdentificationError(
            f"the output {data.output_name} falls with rising input {data.input_name}, by {size}/{data.input_unit} "
            f"(± {deviation}) below {readable(found.highest, 'Hz')}; invert it (--negate), or check "
            "that the columns belong together"
        )
