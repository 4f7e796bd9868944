"""Reference generator: jerk-limited approach to the setpoint plus a waveform, within a range."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hysteresis_ros.block import Chain, compiled, composite, interpreted, nested
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.parameters import Parameters, group, parameter
from hysteresis_ros.references.approach import HIGH, LOW, SETPOINT, Approach, ApproachParameters, approach
from hysteresis_ros.references.waveforms import Waveform, WaveformParameters

#: Parameters and state of the range: FADE is what start() found between the held reference and the setpoint with an
#: unlimited approach; it fades over FADE_SAMPLES.
MINIMUM, MAXIMUM, FADE_SAMPLES = range(3)
RUNNING, OUTPUT, FADE, FADE_COUNT = range(4)


@dataclass(frozen=True)
class ReferenceParameters(Parameters):
    """Parameters of the reference generator."""

    minimum: float = parameter(0.0, description="lowest reference", unit="m", read_only=True)
    maximum: float = parameter(15.0e-6, description="highest reference", unit="m", read_only=True)
    initial_setpoint: float = parameter(
        0.0, description="setpoint until the first one is received", unit="m", read_only=True
    )
    waveform: WaveformParameters = group(WaveformParameters)
    approach: ApproachParameters = group(ApproachParameters)

    def check(self):
        """The range is not empty and contains the initial setpoint."""
        if not self.minimum < self.maximum:
            yield Problem("maximum", self.maximum, f"must be > minimum = {self.minimum:g} m")
        elif not self.minimum <= self.initial_setpoint <= self.maximum:
            allowed = f"out of range, allowed: {self.minimum:g} … {self.maximum:g} m"
            yield Problem("initial_setpoint", self.initial_setpoint, allowed)


class GeneratorArrays(NamedTuple):
    """Parameter arrays, or state arrays, of a reference generator."""

    approach: np.ndarray
    waveform: np.ndarray
    range: np.ndarray


@nested
def reference_step(waveform, ps, xs, setpoint):
    """Return the reference [m] of this sample: approach(setpoint) + waveform, clipped to minimum … maximum.

    ``ps``, ``xs`` are :class:`GeneratorArrays`. While stopped the reference does not change and
    nothing advances.
    """
    p, x = ps.range, xs.range
    if x[RUNNING] == 0.0:
        return x[OUTPUT]
    reference = approach(ps.approach, xs.approach, setpoint) + waveform(ps.waveform, xs.waveform, 0.0)
    if x[FADE_COUNT] < p[FADE_SAMPLES]:
        # Minimum-jerk blend 1 → 0.
        s = x[FADE_COUNT] / p[FADE_SAMPLES]
        reference += x[FADE] * (1.0 - s * s * s * (10.0 + s * (6.0 * s - 15.0)))
        x[FADE_COUNT] += 1.0
    reference = min(max(reference, p[MINIMUM]), p[MAXIMUM])
    x[OUTPUT] = reference
    return reference


@composite("void", "kernel", GeneratorArrays, GeneratorArrays, "array", "array")
def run_reference(waveform, ps, xs, setpoints, references):
    """Fill ``references[k]`` for all ``setpoints[k]``."""
    for k in range(setpoints.shape[0]):
        references[k] = reference_step(waveform, ps, xs, setpoints[k])


class ReferenceGenerator(Chain):
    """Setpoints and waveform to reference. It runs from construction on.

    Parameters
    ----------
    parameters : ReferenceParameters
        Range, waveform and approach.
    sample_time : float
        Sample time [s].

    Attributes
    ----------
    ps, xs : GeneratorArrays
        Parameters and states of approach, waveform and range, for :func:`reference_step`.
    waveform : Waveform
        The waveform, with ``crest_factor``, ``period``, ``lowest`` and ``highest``.

    Raises
    ------
    ParameterError
        A parameter is wrong, or the waveform around the initial setpoint leaves minimum … maximum.
    """

    def __init__(self, parameters: ReferenceParameters, sample_time: float):
        self.parameters = parameters.validated()
        self.sample_time = float(sample_time)
        self.waveform = self._build_waveform(parameters, parameters.initial_setpoint)
        low, high = parameters.minimum, parameters.maximum
        self.approach = Approach(parameters.approach, sample_time, low, high, parameters.initial_setpoint)
        fade = 0
        if parameters.approach.unlimited:
            fade = round(parameters.approach.start_time / self.sample_time)
        self._range = np.array([low, high, float(fade)]), np.zeros(4)
        self._adopt()
        self.reset()

    def _build_waveform(self, parameters: ReferenceParameters, setpoint: float) -> Waveform:
        waveform = Waveform(parameters.waveform, self.sample_time)
        low, high = parameters.minimum, parameters.maximum
        tolerance = 1e-12 * (high - low)
        for value in (waveform.lowest + setpoint, waveform.highest + setpoint):
            if not low - tolerance <= value <= high + tolerance:
                kind, name = parameters.waveform.type, parameters.waveform.shape.extent
                given = parameters.waveform.to_mapping()[name]
                text = (
                    f"the waveform {kind} around the setpoint {setpoint:g} m reaches {value:g} m, allowed: "
                    f"{low:g} … {high:g} m (minimum … maximum); change amplitude, offset or values, or widen the range"
                )
                raise ParameterError([Problem(f"waveform.{name}", given, text)])
        return waveform

    def _adopt(self) -> None:
        """Connect the present waveform."""
        low, high = self.parameters.minimum, self.parameters.maximum
        # With the waveform on top the sum stays inside.
        self.approach.p[LOW] = low - self.waveform.lowest
        self.approach.p[HIGH] = high - self.waveform.highest
        self.ps = GeneratorArrays(self.approach.p, self.waveform.p, self._range[0])
        self.xs = GeneratorArrays(self.approach.x, self.waveform.x, self._range[1])

    @property
    def waveform_kernel(self):
        """Kernel of the present waveform, for :func:`reference_step`."""
        return self.waveform.kernel

    @property
    def running(self) -> bool:
        """False while :meth:`stop` holds the reference."""
        return bool(self._range[1][RUNNING])

    @property
    def setpoint(self) -> float:
        """The last setpoint that was not refused [m]."""
        return float(self.approach.x[SETPOINT])

    def step(self, setpoint: float) -> float:
        """Return the reference [m] of this sample; a setpoint that is refused leaves the last good one in force."""
        return interpreted(reference_step)(self.waveform_kernel, self.ps, self.xs, float(setpoint))

    def simulate(self, setpoints) -> np.ndarray:
        """Return the references [m], shape (N,), for the setpoints [m] of each sample, shape (N,)."""
        setpoints = np.ascontiguousarray(setpoints, dtype=np.float64)
        references = np.empty_like(setpoints)
        compiled(run_reference)(self.waveform_kernel, self.ps, self.xs, setpoints, references)
        return references

    def refuse(self, setpoint: float) -> str | None:
        """Say why a setpoint [m] is refused, with value and range; None when it is not."""
        low, high = self.approach.p[LOW], self.approach.p[HIGH]
        if low <= setpoint <= high:
            return None
        waveform = self.waveform
        around = ""
        if waveform.lowest != 0.0 or waveform.highest != 0.0:
            around = f" with the waveform {waveform.lowest:g} … {waveform.highest:g} m on top"
        reason = "out of range" if math.isfinite(setpoint) else "not a finite number"
        return f"setpoint {setpoint:g} m refused: {reason}, allowed: {low:g} … {high:g} m{around}"

    def stop(self) -> None:
        """Freeze the reference at its last value; setpoints are without effect until :meth:`start`."""
        self._range[1][RUNNING] = 0.0

    def start(self) -> None:
        """Run the waveform from its beginning, from the present reference without a jump.

        The approach begins, at rest, where the waveform's first sample on top of it gives the held reference, and
        moves to the setpoint within its limits. An unlimited approach cannot do that: there the difference fades
        out over ``approach.start_time``.
        """
        output = self._range[1][OUTPUT]
        self.waveform.reset()
        difference = output - self._first_value()
        x = self._range[1]
        if self.parameters.approach.unlimited:
            self.approach.rest_at(self.setpoint)
            x[FADE], x[FADE_COUNT] = difference - self.setpoint, 0.0
        else:
            self.approach.rest_at(difference)
            x[FADE], x[FADE_COUNT] = 0.0, 0.0
        x[RUNNING] = 1.0

    def _first_value(self) -> float:
        return self.waveform.kernel(self.waveform.p, np.zeros(1), 0.0)

    def reset(self) -> None:
        """Return to the state at construction: at rest at the initial setpoint, waveform at its beginning."""
        self.approach.reset()
        self.waveform.reset()
        first = self.parameters.initial_setpoint + self._first_value()
        output = min(max(first, self.parameters.minimum), self.parameters.maximum)
        self._range[1][:] = (1.0, output, 0.0, 0.0)

    def retune(self, parameters: ReferenceParameters) -> None:
        """Take another waveform while stopped; it is played from its beginning at the next :meth:`start`.

        Raises
        ------
        ParameterError
            The generator runs, the new parameters are wrong, or anything but the waveform differs; nothing is
            changed then.
        """
        parameters.validated()
        old, new = self.parameters.to_mapping(), parameters.to_mapping()
        changed = sorted(name for name in old.keys() | new.keys() if old.get(name) != new.get(name))
        problems = []
        for name in changed:
            if not name.startswith("waveform."):
                problems.append(Problem(name, new.get(name), "fixed while configured; clean up and configure anew"))
            elif self.running:
                problems.append(Problem(name, new.get(name), "can change only while stopped; call stop"))
        if problems:
            raise ParameterError(problems)
        if changed:
            waveform = self._build_waveform(parameters, self.setpoint)
            self.parameters, self.waveform = parameters, waveform
            self._adopt()
