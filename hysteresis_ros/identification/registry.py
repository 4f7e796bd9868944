"""All models that can be identified: name → how, from what data, with which options and which inverse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification import procedures
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.identified import Identification
from hysteresis_ros.identification.linear_stage import STAGES
from hysteresis_ros.models.hysteresis import HYSTERESIS_BLOCKS, HysteresisParameters

#: Parts of the linear model that are found together with the hysteresis.
PARTS = ("lag", "delay", "creep")
#: Words for sets of parts.
WORDS = {"none": (), "auto": PARTS}


@dataclass(frozen=True)
class Option:
    """One option of a model.

    Parameters
    ----------
    kind : type
        int, float or str.
    description : str
    choices : tuple of str
        Of a str.
    """

    kind: type
    description: str
    choices: tuple[str, ...] = ()

    def convert(self, name: str, text: str):
        """Return the value of ``text``.

        Raises
        ------
        IdentificationError
            It is no such value; the message says what is allowed.
        """
        try:
            value = self.kind(text)
        except ValueError:
            raise IdentificationError(f"option {name} = {text!r}: must be a {self.kind.__name__}") from None
        if self.choices and value not in self.choices:
            raise IdentificationError(f"option {name} = {text!r}: must be one of {', '.join(self.choices)}")
        if isinstance(value, float) and not np.isfinite(value):
            raise IdentificationError(f"option {name} = {text!r}: must be finite")
        return value


@dataclass(frozen=True)
class Model:
    """A model in the registry.

    Parameters
    ----------
    title : str
        What it is, in one line.
    data : str
        What data it needs.
    identify : callable
        ``identify(data, request)``.
    inverses : tuple of str
        Inverse types that fit, the default first.
    linear : tuple of str
        What may stand behind it; parts are ``lag``, ``delay``, ``creep``, stages those of :data:`STAGES`.
    options : dict of str to Option
    """

    title: str
    data: str
    identify: Callable[[IdentificationData, procedures.Request], Identification]
    inverses: tuple[str, ...]
    linear: tuple[str, ...]
    options: dict[str, Option] = field(default_factory=dict)

    def parameters(self, name: str):
        """Return the rows of the parameter table of the model called ``name``."""
        groups = HysteresisParameters.table()
        start = f"{name}."
        return [replace(row, name=row.name[len(start) :]) for row in groups if row.name.startswith(start)]


_LOOPS = "a voltage that rises and falls; loops of several amplitudes settle the model inside the largest loop"
_SEED = Option(int, "seed of the random starts")
_BOTH = (*PARTS, *STAGES)

#: The models, by name: the type of the hysteresis in the parameter files.
MODELS: dict[str, Model] = {
    "prandtl_ishlinskii": Model(
        "play operators with weights ≥ 0, dead zones where they help (modified model)",
        _LOOPS,
        procedures.prandtl_ishlinskii,
        ("exact", "general", "picard_steps", "none"),
        _BOTH,
        {
            "play_count": Option(int, "plays"),
            "zone_count": Option(int, "dead zones; 0: the classical model"),
        },
    ),
    "preisach": Model(
        "discrete Everett map with interpolation, wiping-out and return-point memory",
        _LOOPS,
        procedures.preisach,
        ("general", "picard_steps", "none"),
        _BOTH,
        {
            "widths": Option(int, "widths of elementary loops at which the density has a weight"),
            "nodes": Option(int, "nodes of the map on each side"),
        },
    ),
    "polynomial": Model(
        "branch polynomials with coefficients that are quadratics of the peak voltage (Kim et al. 2009)",
        "loops from about 0 V to positive peaks; three or more peaks that grow, e.g. triangles to 6, 12 … 120 V",
        procedures.polynomial,
        ("exact", "general", "picard_steps", "none"),
        _BOTH,
        {
            "method": Option(str, "fit to all samples, or through the coefficients of each loop", ("samples", "loops")),
            "criterion": Option(str, "what is made small", ("automatic", "rms", "maximum")),
        },
    ),
    "bouc_wen": Model(
        "static Bouc-Wen element by Nelder-Mead with several starts",
        "slow loops that start at rest at 0 V",
        procedures.bouc_wen,
        ("multiplicative", "general", "picard_steps", "none"),
        _BOTH,
        {
            "d_e": Option(float, "initial guess [m/V]"),
            "alpha": Option(float, "initial guess [m/V]"),
            "beta": Option(float, "initial guess [1/V]"),
            "gamma": Option(float, "initial guess [1/V]"),
            "exponent": Option(float, "exponent n, not fitted"),
            "starts": Option(int, "starts of the simplex"),
            "iterations": Option(int, "most iterations of a start"),
            "seed": _SEED,
        },
    ),
    "duhem": Model(
        "Duhem equation with networks or splines for f and g (Wang et al. 2014)",
        "at least one whole major loop; loops of decaying amplitude settle alpha",
        procedures.duhem,
        ("general", "duhem", "picard_steps", "none"),
        _BOTH,
        {
            "alpha": Option(float, "α of the normalised input (the paper: 80); from minor loops by default"),
            "shape": Option(str, "how f and g are given", ("network", "spline")),
            "size": Option(int, "units of each network or knots of each spline"),
            "seed": _SEED,
        },
    ),
    "bouc_wen_mechanical": Model(
        "Bouc-Wen force inside a mass-damper-spring equation (grey box, by output error)",
        "a dynamic excitation that passes the resonance, e.g. a multisine",
        procedures.bouc_wen_mechanical,
        ("none",),
        (),
        {
            "mass": Option(float, "initial value [kg]"),
            "damping": Option(float, "initial value [N·s/m]"),
            "stiffness": Option(float, "initial value [N/m]"),
            "alpha": Option(float, "initial value [N/m]"),
            "beta": Option(float, "initial value [1/m]; only its products with γ and δ are fitted"),
            "gamma": Option(float, "initial value"),
            "delta": Option(float, "initial value"),
            "exponent": Option(float, "exponent ν, not fitted"),
            "trials": Option(int, "trial points around the initial values"),
            "seed": _SEED,
        },
    ),
    "proportional": Model(
        "no hysteresis: a gain, for linear dynamics alone",
        "any excitation; for dynamics a multisine, chirp or steps",
        procedures.proportional,
        ("exact", "none"),
        ("lag", *STAGES),
    ),
}


def find_model(name: str) -> Model:
    """Return the model of that name.

    Raises
    ------
    IdentificationError
        There is none; the message lists what there is.
    """
    if name not in MODELS:
        raise IdentificationError(f"model {name!r}: must be one of {', '.join(MODELS)}")
    return MODELS[name]


def parse_linear(model: str, words: str | None) -> tuple[tuple[str, ...], str | None]:
    """Return the parts that may be found with the hysteresis and the stage behind it (None for no stage).

    Parameters
    ----------
    model : str
    words : str, optional
        ``auto``, ``none``, parts with commas between them (``lag,creep``), or one stage.

    Raises
    ------
    IdentificationError
        A word is unknown, or does not go with this model.
    """
    entry = find_model(model)
    words = words or "auto"
    if words in WORDS:
        return tuple(part for part in WORDS[words] if part in entry.linear), None
    given = tuple(word.strip() for word in words.split(","))
    unknown = [word for word in given if word not in (*PARTS, *STAGES)]
    if unknown:
        raise IdentificationError(
            f"linear {', '.join(unknown)}: must be auto, none, of {', '.join(PARTS)} (with commas), "
            f"or one of {', '.join(STAGES)}"
        )
    refused = [word for word in given if word not in entry.linear]
    if refused:
        allowed = ", ".join(("auto", "none", *entry.linear))
        raise IdentificationError(f"linear {', '.join(refused)} does not go with {model}; allowed: {allowed}")
    stages = [word for word in given if word in STAGES]
    if stages and len(given) > 1:
        raise IdentificationError(f"linear {words}: {stages[0]} stands alone, it holds lag and delay already")
    return (() if stages else given), (stages[0] if stages else None)


def parse_options(model: str, pairs) -> dict:
    """Return the options of a model from words ``name=value``.

    Raises
    ------
    IdentificationError
        An option is unknown or has a wrong value.
    """
    options, entry = {}, find_model(model)
    for pair in pairs:
        name, mark, text = pair.partition("=")
        if not mark or name not in entry.options:
            there = ", ".join(entry.options) or "none"
            raise IdentificationError(f"option {pair!r}: write name=value; options of {model}: {there}")
        options[name] = entry.options[name].convert(name, text)
    return options


def identify(
    data: IdentificationData,
    model: str,
    linear: str | None = None,
    options: dict | None = None,
    inverse: str | None = None,
    skip: int | None = None,
    intersample: str = "zoh",
    initial: str | None = None,
    progress=None,
) -> Identification:
    """Identify a model by its name.

    Parameters
    ----------
    data : IdentificationData
        Checked data (:meth:`.IdentificationData.checked`).
    model : str
        Name in :data:`MODELS`.
    linear : str, optional
        See :func:`parse_linear`; ``auto`` by default.
    options : dict, optional
        Of the model, see :func:`parse_options`.
    inverse : str, optional
        Inverse of the compensator; the first that fits by default.
    skip : int, optional
        First samples left out of the error.
    intersample, initial : str, optional
        How the input runs between samples and where the state starts.
    progress : callable, optional
        Called as ``progress(number, text)``.

    Raises
    ------
    IdentificationError, DataError, FitError
        The request or the data cannot be used.
    """
    entry = find_model(model)
    inverse = inverse or entry.inverses[0]
    if inverse not in entry.inverses:
        raise IdentificationError(f"inverse {inverse!r}: {model} has {', '.join(entry.inverses)}")
    parts, stage = parse_linear(model, linear)
    if not HYSTERESIS_BLOCKS[model].__name__.startswith("BoucWenOsc"):
        _refuse_falling(data)
    request = procedures.Request(
        model, parts, stage, dict(options or {}), inverse, skip, intersample, initial, progress or (lambda *_: None)
    )
    return entry.identify(data, request)


def _refuse_falling(data: IdentificationData) -> None:
    """Refuse an output that falls with rising input: no model of this package describes it."""
    u, y = data.input - data.input.mean(), data.output - data.output.mean()
    if float(u @ y) <= 0.0:
        raise IdentificationError(
            f"the output {data.output_name} falls with rising input {data.input_name}; count it the other way round "
            "(--negate), or check that the columns belong together"
        )
