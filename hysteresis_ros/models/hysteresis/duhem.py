# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

r"""Duhem hysteresis with free shape functions (Wang, Alici & Tan 2014; W3), and its inverse of the same form (W4).

.. math::

   \dot w = \alpha |\dot v| \left[ f(v) - w \right] + g(v) \dot v

[1]_: rising dw/dv = α (f - w) + g, falling dw/dv = -α (f - w) + g. The functions f and g are small networks of tanh
units or cubic splines. Their input is normalised to -1 … 1, and their values are normalised, so that their weights do
not depend on units. Beyond the input range, f is linear and g is constant.

Along a monotone step the equation is linear in w. Each substep of length h is integrated as ``e^(-α h) w`` plus the
integral of the shape functions times the exponential, by a three-point Gauss rule. With the substeps that are used, the
error is below 1e-9 of the output range. The inverse of W4 is the same equation with input and output exchanged, and
with an f and a g of its own.

References
----------
.. [1] Wang, Alici & Tan, Modeling and inverse feedforward control for conducting polymer actuators with hysteresis,
   Smart Materials and Structures 23, 2014.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import kernel
from hysteresis_ros.models.declaration import (
    DISPLACEMENT,
    VOLTAGE,
    Deviation,
    HysteresisModel,
    Option,
    OwnInverse,
    RateIndependentBlock,
    plus,
    times,
)
from hysteresis_ros.models.linear_algebra import product, solve

# Layout of p, followed by the numbers of f and of g.
ALPHA = 0  # [1/input unit]
LONGEST_SUBSTEP = 1
INPUT_MIDDLE = 2
INPUT_HALF = 3
F_MIDDLE = 4  # f = middle + half · normalised value
F_HALF = 5
G_HALF = 6
F_SLOPE_LOW = 7  # slopes of the normalised f below -1 and above +1
F_SLOPE_HIGH = 8
UNITS = 9  # number of units of each network, or number of knots of each spline
NETWORK = 10  # 1: networks, 0: splines
SHAPES = 11

#: Longest substep: in units of 1/α, and as a fraction of the input range.
SUBSTEP_ALPHA = 0.25
SUBSTEP_RANGE = 1.0 / 64.0
#: Maximum number of substeps of one step; only a step far outside the input range needs more.
MOST_SUBSTEPS = 100000

# Gauss-Legendre rule of three points on 0 … 1.
_OFFSET = math.sqrt(0.15)
_OUTER, _INNER = 5.0 / 18.0, 8.0 / 18.0


@dataclass(frozen=True)
class DuhemParameters(Parameters):
    """Duhem equation with networks or splines; for the inverse (W4) the input is the displacement."""

    alpha: float = parameter(
        description="α: rate at which the output approaches the new branch", unit="1/V (1/m as inverse)", low=0.0
    )
    input_low: float = parameter(description="input that is normalised to -1", unit="V (m)")
    input_high: float = parameter(description="input that is normalised to +1", unit="V (m)")
    output_low: float = parameter(description="output that is normalised to -1", unit="m (V)")
    output_high: float = parameter(description="output that is normalised to +1", unit="m (V)")
    shape: str = parameter(
        "network", choices=("network", "spline"), description="representation of f and g", read_only=True
    )
    f_network: tuple[float, ...] = parameter(
        (), description="f(v) = Σ c tanh(a v + b) + d: m input weights a, m biases b, m output weights c, then d"
    )
    g_network: tuple[float, ...] = parameter((), description="g, like f_network")
    f_spline: tuple[float, ...] = parameter((), description="f: normalised values at equidistant inputs from -1 to +1")
    g_spline: tuple[float, ...] = parameter((), description="g, like f_spline")
    input_start: float = parameter(0.0, description="input at the start", unit="V (m)")
    output_start: float = parameter(0.0, description="output at the start", unit="m (V)")

    @property
    def shapes(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Numbers that describe f and g in the chosen representation."""
        network = self.shape == "network"
        return (self.f_network, self.g_network) if network else (self.f_spline, self.g_spline)

    @property
    def structure(self) -> dict[str, int | str]:
        """Structure that cannot change while running."""
        return {"shape": self.shape, f"f_{self.shape}": len(self.shapes[0])}

    def check(self):
        """Yield a Problem for each range or size that is wrong."""
        for side in ("input", "output"):
            low, high = getattr(self, f"{side}_low"), getattr(self, f"{side}_high")
            if not low < high:
                yield Problem(f"{side}_high", high, f"must be above {side}_low = {low:g}")
        f, g = self.shapes
        name = f"f_{self.shape}"
        if self.shape == "network" and (len(f) < 4 or len(f) % 3 != 1):
            yield Problem(name, f, "must be 3 m + 1 numbers for m units")
        if self.shape == "spline" and len(f) < 4:
            yield Problem(name, f, "must be at least 4 values")
        if len(f) != len(g):
            yield Problem(f"g_{self.shape}", g, f"must be as many numbers as {name}: {len(f)}")

    def warnings(self, prefix: str = "") -> tuple[str, ...]:
        """Return a warning if the output may move against the input after a reversal."""
        low, high = self.input_low, self.input_high
        v = np.linspace(low, high, 101)
        _, g = shape_functions(self, v)
        swing = self.alpha * (self.output_high - self.output_low)
        if np.any(g <= 0.0):
            return (
                f"{prefix}g_{self.shape}: g is not positive in a part of {low:g} … {high:g}; loops may not be monotone",
            )
        # in a loop with a width of 10 % of the range, the output is up to 5 % away from the middle
        if swing * 0.05 > g.min():
            return (
                f"{prefix}alpha = {self.alpha:.4g}: α times 5 % of the output range exceeds "
                f"{g.min():.3g}, the smallest g: after a reversal inside a wide loop the output first "
                "moves against the input",
            )
        return ()


def spline_slopes(values) -> np.ndarray:
    """Return the slopes, shape (n,), of the not-a-knot spline through equidistant values with a knot distance of 1."""
    y = np.asarray(values, dtype=float)
    n = len(y)
    matrix, right = np.zeros((n, n)), np.zeros(n)
    for i in range(1, n - 1):
        matrix[i, i - 1 : i + 2] = (1.0, 4.0, 1.0)
        right[i] = 3.0 * (y[i + 1] - y[i - 1])
    # not-a-knot: the third derivative is continuous at the second knot and at the last but one
    matrix[0, :3], right[0] = (1.0, 0.0, -1.0), 2.0 * (2.0 * y[1] - y[0] - y[2])
    matrix[-1, -3:], right[-1] = (1.0, 0.0, -1.0), 2.0 * (2.0 * y[-2] - y[-3] - y[-1])
    return solve(matrix, right)


@kernel
def _network(p, first, units, v):
    y = p[first + 3 * units]
    for i in range(units):
        y += p[first + 2 * units + i] * elementary.tanh(p[first + i] * v + p[first + units + i])
    return y


@kernel
def _spline(p, first, knots, v):
    place = 0.5 * (v + 1.0) * (knots - 1)
    i = min(int(place), knots - 2)
    t = place - i
    y0, y1 = p[first + i], p[first + i + 1]
    s0, s1 = p[first + knots + i], p[first + knots + i + 1]
    rise = y1 - y0
    return y0 + t * (s0 + t * ((3.0 * rise - 2.0 * s0 - s1) + t * (s0 + s1 - 2.0 * rise)))


@kernel
def duhem_f(p, v):
    """Return the shape function f [output unit] at the input ``v``."""
    normalised = (v - p[INPUT_MIDDLE]) / p[INPUT_HALF]
    inside = max(-1.0, min(1.0, normalised))
    units = int(p[UNITS])
    y = _network(p, SHAPES, units, inside) if p[NETWORK] != 0.0 else _spline(p, SHAPES, units, inside)
    beyond = normalised - inside
    if beyond != 0.0:
        y += beyond * (p[F_SLOPE_LOW] if beyond < 0.0 else p[F_SLOPE_HIGH])
    return p[F_MIDDLE] + p[F_HALF] * y


@kernel
def duhem_g(p, v):
    """Return the shape function g [output unit per input unit] at the input ``v``."""
    inside = max(-1.0, min(1.0, (v - p[INPUT_MIDDLE]) / p[INPUT_HALF]))
    units = int(p[UNITS])
    if p[NETWORK] != 0.0:
        return p[G_HALF] * _network(p, SHAPES + 3 * units + 1, units, inside)
    return p[G_HALF] * _spline(p, SHAPES + 2 * units, units, inside)


@kernel
def _sweep(p, w, start, end):
    """Return the output at ``end`` for a monotone input that starts at ``start``, where the output is ``w``."""
    distance = abs(end - start)
    direction = 1.0 if end > start else -1.0
    alpha = p[ALPHA]
    count = int(min(math.ceil(distance / p[LONGEST_SUBSTEP]), float(MOST_SUBSTEPS)))
    h = distance / count
    c1, c2, c3 = (0.5 - _OFFSET) * h, 0.5 * h, (0.5 + _OFFSET) * h
    decay = elementary.exp(-alpha * h)
    w1 = _OUTER * h * elementary.exp(alpha * (c1 - h))
    w2 = _INNER * h * elementary.exp(alpha * (c2 - h))
    w3 = _OUTER * h * elementary.exp(alpha * (c3 - h))
    for i in range(count):
        v1 = start + direction * (i * h + c1)
        v2 = start + direction * (i * h + c2)
        v3 = start + direction * (i * h + c3)
        integral = w1 * (alpha * duhem_f(p, v1) + direction * duhem_g(p, v1))
        integral += w2 * (alpha * duhem_f(p, v2) + direction * duhem_g(p, v2))
        integral += w3 * (alpha * duhem_f(p, v3) + direction * duhem_g(p, v3))
        w = decay * w + integral
    return w


@kernel
def duhem(p, x, u):
    """Return the output after a monotone change of the input to ``u`` (W3); NaN changes nothing."""
    start = x[VOLTAGE]
    if not abs(u - start) > 0.0:
        return x[DISPLACEMENT]
    # f and g have kinks at the ends of the input range, so no substep spans an end
    direction = 1.0 if u > start else -1.0
    w = x[DISPLACEMENT]
    for side in (-direction, direction):
        end = p[INPUT_MIDDLE] + side * p[INPUT_HALF]
        if (end - start) * (end - u) < 0.0:
            w = _sweep(p, w, start, end)
            start = end
    w = _sweep(p, w, start, u)
    x[VOLTAGE] = u
    x[DISPLACEMENT] = w
    return w


@kernel
def inverse_duhem(hysteresis, p_i, x_i, p_h, x_h, displacement):
    """Return the voltage [V] of ``dv = α |dw| [F(w) - v] + G(w) dw`` after w has moved to ``displacement`` [m] (W4).

    Unlike the other inverses, it does not use the state of a model: ``x_i`` contains its own last displacement and
    voltage. A repeated call with the same displacement gives the same voltage.

    Parameters
    ----------
    hysteresis : kernel
        Not used.
    p_i : ndarray
        Parameters of :func:`duhem` with the displacement as input.
    x_i : ndarray, shape (>= 2,)
        Last displacement [m] and last voltage [V].
    p_h, x_h : ndarray
        Not used.
    displacement : float
        Commanded displacement w [m]; NaN gives the last voltage.
    """
    return duhem(p_i, x_i, displacement)


def _sech_squared(x: float) -> float:
    fall = elementary.exp(-2.0 * abs(x))
    return 4.0 * fall / ((1.0 + fall) * (1.0 + fall))


def pack_duhem(parameters: DuhemParameters) -> np.ndarray:
    """Return p of :func:`duhem`, shape (11 + numbers of f and g,)."""
    f, g = (np.array(values) for values in parameters.shapes)
    half = 0.5 * (parameters.input_high - parameters.input_low)
    output_half = 0.5 * (parameters.output_high - parameters.output_low)
    network = parameters.shape == "network"
    if network:
        units = (len(f) - 1) // 3
        a, b, c = f[:units], f[units : 2 * units], f[2 * units : 3 * units]
        slopes = [float(product(c * a, [_sech_squared(x) for x in a * end + b])) for end in (-1.0, 1.0)]
        shapes = [f, g]
    else:
        units = len(f)
        knot_slopes = spline_slopes(f)
        slopes = list(knot_slopes[[0, -1]] * (units - 1) / 2.0)
        shapes = [f, knot_slopes, g, spline_slopes(g)]
    longest = 2.0 * half * SUBSTEP_RANGE
    if parameters.alpha * longest > SUBSTEP_ALPHA:
        longest = SUBSTEP_ALPHA / parameters.alpha
    head = [parameters.alpha, longest, 0.5 * (parameters.input_high + parameters.input_low), half]
    head += [0.5 * (parameters.output_high + parameters.output_low), output_half, output_half / half]
    return np.concatenate([[*head, *slopes, units, float(network)], *shapes])


def shape_functions(parameters: DuhemParameters, v) -> tuple[np.ndarray, np.ndarray]:
    """Return f and g at the inputs ``v``, in the units of the model; all three arrays have the shape (N,)."""
    p = pack_duhem(parameters)
    v = np.asarray(v, dtype=float).tolist()
    return np.array([duhem_f(p, value) for value in v]), np.array([duhem_g(p, value) for value in v])


class DuhemHysteresis(RateIndependentBlock):
    """Duhem hysteresis: voltage [V] to displacement [m] or, as the inverse of W4, displacement to voltage.

    Its only memory is the output, so it has no return-point memory, and needs no adjustment after a retune. It has no
    closed-form inverse; ``general`` is exact to rounding, and ``duhem`` is the inverse of the paper.

    Parameters
    ----------
    parameters : DuhemParameters
        α, ranges and shape functions.
    sample_time : float
        Sample time [s], not used.
    """

    kernel = staticmethod(duhem)

    def pack(self, parameters: DuhemParameters) -> np.ndarray:
        """Return p, see :func:`pack_duhem`."""
        return pack_duhem(parameters)

    def initial_state(self) -> np.ndarray:
        """Return x, shape (2,): the start point."""
        return np.array([self.parameters.input_start, self.parameters.output_start])

    @property
    def gain(self) -> float:
        """Nominal gain [m/V]: output range divided by input range."""
        return float(self.p[F_HALF] / self.p[INPUT_HALF])


_OUTPUTS = ("output_low", "output_high", "output_start")


def _scaled(parameters: DuhemParameters, factor: float) -> DuhemParameters:
    return times(parameters, factor, *_OUTPUTS)


def _shifted(parameters: DuhemParameters, offset: float) -> DuhemParameters:
    return plus(parameters, offset, *_OUTPUTS)


def _deviated(parameters: DuhemParameters, deviation: Deviation) -> DuhemParameters:
    return replace(_scaled(parameters, deviation.gain), alpha=parameters.alpha * deviation.opening)


MODEL = HysteresisModel(
    name="duhem",
    title="Duhem equation with networks or splines for f and g (Wang et al. 2014)",
    data="at least one whole major loop; loops of decaying amplitude determine alpha",
    parameters=DuhemParameters,
    block=DuhemHysteresis,
    example=DuhemParameters(
        alpha=0.04,
        input_low=0.0,
        input_high=100.0,
        output_low=0.0,
        output_high=10e-6,
        shape="spline",
        f_spline=(-0.98, -0.5, 0.02, 0.5, 0.96),
        g_spline=(0.95, 0.88, 0.86, 0.88, 0.95),
    ),
    scaled=_scaled,
    shifted=_shifted,
    deviated=_deviated,
    inverses=("general", "duhem", "picard_steps", "none"),
    own_inverses={
        "duhem": OwnInverse(
            inverse_duhem,
            "its own equation, without the model",
            follows_model=False,
            parameters=DuhemParameters,
            block=DuhemHysteresis,
        )
    },
    identify="hysteresis_ros.identification.procedures:duhem",
    options={
        "alpha": Option(float, "α for the normalised input (80 in the paper); default: from minor loops"),
        "shape": Option(str, "representation of f and g", ("network", "spline")),
        "size": Option(int, "units of each network or knots of each spline", low=1),
        "seed": Option(int, "seed of the random starts", low=0),
    },
)
