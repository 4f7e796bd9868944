"""Hysteresis compensator: from the wanted displacement to the voltage, and what that voltage really carries out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.block import Chain, compiled, interpreted, nested
from hysteresis_ros.compensation.creep import creep_inverse
from hysteresis_ros.compensation.duhem import inverse_duhem
from hysteresis_ros.compensation.general import general
from hysteresis_ros.compensation.multiplicative import multiplicative
from hysteresis_ros.compensation.picard import picard
from hysteresis_ros.compensation.proportional import proportional_inverse
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.creep import Creep, CreepParameters, creep
from hysteresis_ros.models.duhem import DuhemHysteresis, DuhemParameters, pack_duhem
from hysteresis_ros.models.hysteresis import HYSTERESIS_BLOCKS, HysteresisParameters, hysteresis_block
from hysteresis_ros.models.limits import FLAGS, OUTPUT, SLEWING, UNQUANTISED, Limits, LimitsParameters, limits
from hysteresis_ros.models.proportional import ProportionalHysteresis, ProportionalParameters
from hysteresis_ros.models.rate_independent import require_structure
from hysteresis_ros.parameters import Parameters, group, parameter

# Places in the tuples ps and xs.
INVERSE, HYSTERESIS, LIMITS, OUT, CREEP = 0, 1, 2, 3, 4

# Layout of xs[OUT].
APPLIED = 0  # displacement that the limited voltage carries out [m]
BIAS = 1  # voltage that keeps the output from jumping at a retune, dying out [V]
COMMAND = 2  # last command [m]

# Layout of ps[OUT].
DECAY = 0  # of the bias, a sample

#: A bias below this is nothing [V].
NEGLIGIBLE_BIAS = 1e-9

#: The inverse of each type; that of ``exact`` is the model's own.
INVERSES = {
    "none": proportional_inverse,
    "picard_steps": picard,
    "exact": None,
    "general": general,
    "multiplicative": multiplicative,
    "duhem": inverse_duhem,
}
#: Inverses that try the model's kernel; all others are closed forms, which do not use it.
TRYING = (picard, general)
#: ``general`` searches this part of the range of the limits beyond its ends, so that saturation shows.
SEARCH_MARGIN = 0.1


@dataclass(frozen=True)
class InverseParameters(Parameters):
    """Which inverse of the hysteresis model is used."""

    type: str = parameter(
        "exact",
        description="inverse: none (voltage = command / gain), picard_steps, exact (closed form of the model), general "
        "(root search on any model), multiplicative (of bouc_wen), or duhem (an equation of its own, no model)",
        choices=tuple(INVERSES),
        read_only=True,
    )
    picard_steps: int = parameter(3, description="number of Picard steps", low=1, high=1000)
    picard_rate: float = parameter(
        0.0, description="R of the Picard steps; 0: 1/gain of the model", unit="V/m", low=0.0
    )
    duhem: DuhemParameters = group(DuhemParameters, variant_of="type")

    def require_same(self, present: InverseParameters) -> None:
        """Raise ParameterError when type or sizes are not the ``present`` ones: they cannot change while running."""
        if self.type != present.type:
            raise ParameterError([Problem("inverse.type", self.type, f"is fixed while running: keep {present.type}")])
        if self.type == "duhem":
            require_structure(present.duhem, self.duhem)


@dataclass(frozen=True)
class CompensatorParameters(Parameters):
    """Parameters of the hysteresis compensator: its own model of the actuator, never the plant itself."""

    inverse: InverseParameters = group(InverseParameters)
    hysteresis: HysteresisParameters = group(HysteresisParameters)
    creep: CreepParameters = group(CreepParameters)
    limits: LimitsParameters = group(LimitsParameters)
    safe_voltage: float = parameter(0.0, description="voltage at stop, exit and after lost commands", unit="V")
    handover_time: float = parameter(
        0.1, description="time constant with which the old voltage gives way after new parameters", unit="s", low=0.0
    )

    def check(self):
        """Yield a Problem when the safe voltage is out of range or the inverse does not fit the model."""
        low, high = self.limits.minimum, self.limits.maximum
        if not low <= self.safe_voltage <= high:
            allowed = f"must lie within limits.minimum … limits.maximum ({low:g} … {high:g} V)"
            yield Problem("safe_voltage", self.safe_voltage, allowed)
        kind, model = self.inverse.type, self.hysteresis.type
        block = HYSTERESIS_BLOCKS[model]
        allowed = ""
        if kind == "exact" and block.inverse is None:
            allowed = f"{model} has no closed-form inverse; use general"
        if kind == "multiplicative" and model != "bouc_wen":
            allowed = f"is the inverse of bouc_wen only, the model is {model}; use general"
        if kind != "none" and not getattr(block, "rate_independent", True):
            allowed = f"{model} is not rate independent, no inverse fits it; use none, or a rate-independent model"
        if allowed:
            yield Problem("inverse.type", kind, allowed)


@nested
def compensator_hold(hysteresis, ps, xs, voltage):
    """Put out ``voltage`` [V] as far as the limits allow, let the model follow, and return what is put out [V]."""
    limited = limits(ps[LIMITS], xs[LIMITS], voltage)
    xs[OUT][APPLIED] = creep(ps[CREEP], xs[CREEP], hysteresis(ps[HYSTERESIS], xs[HYSTERESIS], limited))
    return limited


@nested
def compensator_step(hysteresis, inverse, ps, xs, command):
    """Voltage [V] for the displacement ``command`` [m]; the displacement really carried out is left in ``xs[3][0]``.

    ``ps`` and ``xs`` are tuples of the arrays of (inverse, hysteresis, limits, out, creep).
    """
    out = xs[OUT]
    out[COMMAND] = command
    displacement = creep_inverse(ps[CREEP], xs[CREEP], command)
    voltage = inverse(hysteresis, ps[INVERSE], xs[INVERSE], ps[HYSTERESIS], xs[HYSTERESIS], displacement)
    bias = out[BIAS]
    if bias != 0.0:
        voltage += bias
        bias *= ps[OUT][DECAY]
        out[BIAS] = bias if abs(bias) > NEGLIGIBLE_BIAS else 0.0
    limited = limits(ps[LIMITS], xs[LIMITS], voltage)
    out[APPLIED] = creep(ps[CREEP], xs[CREEP], hysteresis(ps[HYSTERESIS], xs[HYSTERESIS], limited))
    return limited


def inverse_step(inverse):
    """Return an inverse for calls from Python, once per sample, with the arguments of every inverse.

    Handed over from Python, a kernel would become part of the type of what is called: machine code would be made anew
    in every process, and Numba cannot keep it in its cache. So an inverse that tries the kernel gets it as a
    first-class function, and a closed form a number in its place.
    """
    if inverse in TRYING:
        return compiled(inverse)
    return lambda hysteresis, *arguments: inverse(0.0, *arguments)


class Compensator(Chain):
    """Inverse of a hysteresis model behind the limits of the amplifier.

    Composites use ``ps``, ``xs``, ``hysteresis_kernel`` and ``inverse_kernel`` directly. With inverse ``none`` the
    model is proportional with the nominal gain of the configured one.

    Parameters
    ----------
    parameters : CompensatorParameters
        Checked on construction.
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        Names every wrong parameter.
    """

    def __init__(self, parameters: CompensatorParameters, sample_time: float):
        self.parameters = parameters.validated()
        self.sample_time = float(sample_time)
        self.limits = Limits(parameters.limits, sample_time)
        self.hysteresis = self._model(parameters)
        self.hysteresis_kernel = self.hysteresis.kernel
        self.creep = Creep(self._creep(parameters), sample_time)
        inverse = INVERSES[parameters.inverse.type] or self.hysteresis.inverse
        self.inverse_kernel = compiled(inverse) if inverse in TRYING else inverse
        self._inverse_step = inverse_step(inverse)
        self.ps = (self._pack_inverse(), self.hysteresis.p, self.limits.p, self._pack_out(), self.creep.p)
        scratch = np.zeros(len(self.hysteresis.x) + 2)
        self.xs = (scratch, self.hysteresis.x, self.limits.x, np.zeros(3), self.creep.x)
        self._settle()

    def _model(self, parameters: CompensatorParameters):
        model = hysteresis_block(parameters.hysteresis, self.sample_time)
        if parameters.inverse.type == "none":
            return ProportionalHysteresis(ProportionalParameters(gain=model.gain), self.sample_time)
        return model

    def _creep(self, parameters: CompensatorParameters) -> CreepParameters:
        return CreepParameters() if parameters.inverse.type == "none" else parameters.creep

    def _pack_inverse(self) -> np.ndarray:
        given, gain, limits = self.parameters.inverse, self.hysteresis.gain, self.parameters.limits
        if given.type == "duhem":
            return pack_duhem(given.duhem)
        margin = SEARCH_MARGIN * (limits.maximum - limits.minimum)
        search = [limits.minimum - margin, limits.maximum + margin]
        return np.array([given.picard_steps, given.picard_rate or 1.0 / gain, gain, *search])

    def _pack_out(self) -> np.ndarray:
        time = self.parameters.handover_time
        return np.array([math.exp(-self.sample_time / time) if time > 0.0 else 0.0])

    def _settle(self) -> None:
        out = self.xs[OUT]
        out[:] = 0.0
        out[APPLIED] = out[COMMAND] = self.creep.settle(self.hysteresis.step(self.limits.x[OUTPUT]))
        inverse = self.parameters.inverse
        self.xs[INVERSE][:] = 0.0
        if inverse.type == "duhem":
            start = DuhemHysteresis(inverse.duhem, self.sample_time).x
            self.xs[INVERSE][: len(start)] = start

    def step(self, command: float) -> float:
        """Return the voltage [V] for the displacement ``command`` [m] wanted from the hysteresis element."""
        return interpreted(compensator_step)(
            self.hysteresis_kernel, self._inverse_step, self.ps, self.xs, float(command)
        )

    def hold(self, voltage: float) -> float:
        """Put out a given voltage [V] within the limits, e.g. the safe one; the model follows it."""
        return interpreted(compensator_hold)(self.hysteresis_kernel, self.ps, self.xs, float(voltage))

    @property
    def applied(self) -> float:
        """Displacement [m] that the model carries out at the voltage that was put out last."""
        return float(self.xs[OUT][APPLIED])

    @property
    def voltage(self) -> float:
        """Voltage [V] that was put out last."""
        return float(self.limits.x[OUTPUT])

    @property
    def saturated(self) -> bool:
        """Whether range or slew rate limited the last voltage."""
        return self.limits.saturated

    def reset(self) -> None:
        """Return to rest, with a model that never saw a voltage."""
        self.limits.reset()
        self.hysteresis.reset()
        self._settle()

    def retune(self, parameters: CompensatorParameters) -> None:
        """Take new parameters of the same structure while running, without a jump in the voltage.

        The model goes on from the present point (``rebase``). What the new inverse would still change in the voltage
        for the last command is kept as a bias that dies out with ``handover_time``.

        Raises
        ------
        ParameterError
            The parameters are wrong or of another structure; nothing is changed then.
        """
        parameters = parameters.validated()
        parameters.hysteresis.require_same(self.parameters.hysteresis)
        parameters.inverse.require_same(self.parameters.inverse)
        require_structure(self.parameters.creep, parameters.creep)
        model = self._model(parameters)
        self.parameters = parameters
        self.limits.retune(parameters.limits)
        self.hysteresis.retune(model.parameters)
        self.creep.retune(self._creep(parameters))
        self.ps[INVERSE][:] = self._pack_inverse()
        self.ps[OUT][:] = self._pack_out()
        self.xs[OUT][BIAS] = self._bias()

    def resume(self, command: float) -> None:
        """Let the next voltage for ``command`` [m] go on from the present one, e.g. the safe one after :meth:`hold`.

        The difference dies out with ``handover_time``.
        """
        self.xs[OUT][COMMAND] = float(command)
        self.xs[OUT][BIAS] = self._bias()

    def _bias(self) -> float:
        """Return what must be added to the voltage that the last command gives now so that it stays where it is."""
        if int(self.limits.x[FLAGS]) & SLEWING:
            return 0.0  # the slew rate keeps the voltage from jumping
        p, x = self.hysteresis.p, self.hysteresis.x
        wanted = creep_inverse(self.creep.p, self.creep.x, self.xs[OUT][COMMAND])
        now = self._inverse_step(self.hysteresis_kernel, self.ps[INVERSE], self.xs[INVERSE], p, x, wanted)
        last, given = self.limits.x[UNQUANTISED], self.parameters.limits
        if now >= given.maximum <= last or now <= given.minimum >= last:
            return 0.0  # at the same end of the range as before
        bias = last - now
        return bias if abs(bias) > NEGLIGIBLE_BIAS else 0.0
