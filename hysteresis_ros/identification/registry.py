# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Identification by the name of a model; the model declares its procedure, options and inverses."""

from __future__ import annotations

from hysteresis_ros.errors import IdentificationError, did_you_mean
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.dynamics import STAGES
from hysteresis_ros.identification.plant_model import Identification, Request
from hysteresis_ros.identification.recording_summary import refuse_falling
from hysteresis_ros.models.declaration import PARTS, HysteresisModel
from hysteresis_ros.models.hysteresis import MODELS
from hysteresis_ros.registry import resolved

#: Name that selects the model with the best prediction.
AUTO = "auto"
#: Name of the default.
USUAL = "usual"
#: Model whose parts, options and inverses apply to the default.
FIRST = "prandtl_ishlinskii"
#: Procedure that compares this model with others.
RIVALS = "hysteresis_ros.identification.procedures:usual"
#: Words that stand for sets of parts.
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
    """Return the parts and linear stages that may follow a model."""
    return (*model.parts, *(STAGES if model.stages else ()))


def parse_linear(model: str, words: str | None) -> tuple[tuple[str, ...], str | None]:
    """Return the parts that may be fitted together with the hysteresis, and the linear stage after it or None."""
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
    """Return the options of a model from texts ``name=value``."""
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
            problem = f"there is no option {name!r}" if mark else "write name=value"
            raise IdentificationError(f"option {pair!r}: {problem}; options of {entry.name}: {there}{near}")
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
        refuse_falling(data)
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
