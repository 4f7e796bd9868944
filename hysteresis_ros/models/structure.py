# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.


"""Structure of several actuators: linear dynamics from all inputs to all outputs, with hysteresis inside them.

With m inputs u [V], q outputs y [m] and n states x:

    z_i = g_i u_i + C_z,i x,   w_i = Σ_j a_ij play_rj(z_i),   x⁺ = A x + B u + B_w w,   y = C x + D u.

Each actuator has its own hysteresis. The input z_i of a hysteresis contains the voltage of its actuator and, through
C_z, the motion of the structure at this actuator. An actuator may have several hystereses, for example one of its
ceramic and one of its joints. The number h of all hystereses is a multiple of m, and hysteresis i is driven by input i
mod m. The play operators are those of Prandtl and Ishlinskii [1]_ and are collocated with the actuators. Therefore the
modes shift with the level of the excitation, which hysteresis in front of linear dynamics cannot reproduce. There is no
feedthrough from w to z: w depends only on the state and the voltage of the same sample, so there is no algebraic loop.

States, weights and g have no unit; z, w and the radii are in volts.

References
----------
.. [1] Brokate & Sprekels, Hysteresis and Phase Transitions, 1996, section 2.3 (play operators).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.block import compiled, composite, interpreted, kernel
from hysteresis_ros.models.linear import NOTHING, SAMPLE_TIME_TOLERANCE, StateSpace, accumulate
from hysteresis_ros.models.linear_algebra import product, solve

#: Maximum number of inputs and of outputs.
MOST_CHANNELS = 16
#: Maximum number of fixed-point iterations for a steady state.
REST_STEPS = 1000
#: Relative change up to which the iterations have converged.
REST_CHANGE = 1e-13

# Layout of p: the sizes; for each row of A, the index of the first nonzero column and one plus the index of the last
# nonzero column; then the matrices, row by row, in the order A, B, B_w, C, D, C_z, g, radii, weights.
ORDER = 0
INPUTS = 1
OUTPUTS = 2
HYSTERESES = 3
PLAYS = 4  # number of plays of each hysteresis
ROWS = 5

# Layout of x: n states, n entries of scratch for the next states, w of the h hystereses, then the plays of all
# hystereses.


@dataclass(frozen=True)
class StructureParameters(Parameters):
    """Structure with m inputs, q outputs, n states and h hystereses of r plays; matrices are given row by row."""

    inputs: int = parameter(description="number of inputs m (actuators)", low=1, high=MOST_CHANNELS)
    outputs: int = parameter(description="number of outputs q (sensors)", low=1, high=MOST_CHANNELS)
    A: tuple[float, ...] = parameter(
        description="state matrix, n·n numbers, or 2·n numbers: the 2×2 blocks of a block-diagonal matrix (modes), in "
        "order"
    )
    B: tuple[float, ...] = parameter(description="input matrix, n·m numbers [1/V]")
    C: tuple[float, ...] = parameter(description="output matrix, q·n numbers [m]")
    D: tuple[float, ...] = parameter((), description="feedthrough, q·m numbers [m/V], or empty for none")
    B_w: tuple[float, ...] = parameter(
        (), description="input matrix of the hystereses, n·h numbers [1/V], or empty for none"
    )
    C_z: tuple[float, ...] = parameter(
        (), description="matrix from the states to the inputs of the hystereses, h·n numbers [V], or empty for none"
    )
    input_gains: tuple[float, ...] = parameter(
        (), description="gains g from the voltages to the inputs of the hystereses, h numbers; empty: all 1"
    )
    radii: tuple[float, ...] = parameter((), description="radii of the plays, r numbers ≥ 0", unit="V")
    weights: tuple[float, ...] = parameter((), description="weights a of the plays, h·r numbers; h is a multiple of m")
    sample_time: float = parameter(0.0, description="sample time of the matrices; 0: not stated", unit="s", low=0.0)

    @property
    def order(self) -> int:
        """Number of states n."""
        return len(self.B) // self.inputs

    @property
    def hystereses(self) -> int:
        """Number of hystereses h, a multiple of the number of inputs."""
        return len(self.weights) // len(self.radii) if self.radii else self.inputs

    @property
    def state_matrix(self) -> np.ndarray:
        """A, shape (n, n)."""
        n, A = self.order, np.array(self.A, dtype=float)
        if len(A) == n * n:
            return A.reshape(n, n)
        full = np.zeros((n, n))
        for block, values in enumerate(A.reshape(-1, 2, 2)):
            full[2 * block : 2 * block + 2, 2 * block : 2 * block + 2] = values
        return full

    def _matrix(self, name: str, rows: int, columns: int) -> np.ndarray:
        values = np.array(getattr(self, name), dtype=float)
        return values.reshape(rows, columns) if values.size else np.zeros((rows, columns))

    @property
    def linear(self) -> StateSpace:
        """The dynamics from u to y without the hysteresis."""
        n, m, q = self.order, self.inputs, self.outputs
        return StateSpace(self.state_matrix, self._matrix("B", n, m), self._matrix("C", q, n), self._matrix("D", q, m))

    @property
    def gains(self) -> np.ndarray:
        """Gains g, shape (h,)."""
        return np.array(self.input_gains, dtype=float) if self.input_gains else np.ones(self.hystereses)

    @property
    def hysteresis_gains(self) -> np.ndarray:
        """Gains from all inputs to the hystereses, shape (h, m): g_i in column i mod m."""
        rows = np.arange(self.hystereses)
        matrix = np.zeros((self.hystereses, self.inputs))
        matrix[rows, rows % self.inputs] = self.gains
        return matrix

    @property
    def play_weights(self) -> np.ndarray:
        """Weights a, shape (h, r)."""
        return np.array(self.weights, dtype=float).reshape(self.hystereses, len(self.radii))

    @property
    def hysteresis_input(self) -> np.ndarray:
        """B_w, shape (n, h)."""
        return self._matrix("B_w", self.order, self.hystereses)

    @property
    def hysteresis_motion(self) -> np.ndarray:
        """C_z, shape (h, n)."""
        return self._matrix("C_z", self.hystereses, self.order)

    def sliding(self, slopes) -> StateSpace:
        """Return the linear system from u to y for w_i = ``slopes``_i z_i.

        For small motions, the slopes are the weights of the plays with radius 0; for large motions, they are the sums
        of all weights of a hysteresis.
        """
        linear, into = self.linear, self.hysteresis_input * np.asarray(slopes, dtype=float)
        A = linear.A + product(into, self.hysteresis_motion)
        return StateSpace(A, linear.B + product(into, self.hysteresis_gains), linear.C, linear.D)

    @property
    def small(self) -> StateSpace:
        """The linear system for motions smaller than all radii above 0."""
        return self.sliding(self.play_weights[:, np.array(self.radii, dtype=float) == 0.0].sum(axis=1))

    @property
    def large(self) -> StateSpace:
        """The linear system for motions much larger than all radii."""
        return self.sliding(self.play_weights.sum(axis=1))

    def require_sample_time(self, sample_time: float, name: str = "sample_time") -> None:
        """Refuse a sample time [s] that differs from the stated sample time of the matrices."""
        if self.sample_time and abs(self.sample_time - sample_time) > SAMPLE_TIME_TOLERANCE * sample_time:
            allowed = (
                f"the matrices are for this sample time, but the loop runs at {sample_time:.9g} s: set its rate to "
                f"{1.0 / self.sample_time:.9g} Hz, or give matrices for its sample time"
            )
            raise ParameterError([Problem(name, self.sample_time, allowed)])

    def check(self):
        """Yield a Problem for inconsistent sizes, negative radii, or an unstable structure."""
        m, q, r = self.inputs, self.outputs, len(self.radii)
        n, h = self.order, self.hystereses
        problems = []
        if not n or len(self.B) % m:
            problems.append(Problem("B", self.B, f"must be n·{m} numbers, {m} for each of the n ≥ 1 states"))
        elif len(self.A) not in (n * n, 2 * n) or (len(self.A) != n * n and n % 2):
            blocks = f", or {2 * n} numbers, its 2×2 blocks" if n % 2 == 0 else ""
            problems.append(Problem("A", self.A, f"must be {n * n} numbers, as B has {n} rows{blocks}"))
        sizes = {"C": (q * n, "q·n", False), "D": (q * m, "q·m", True), "B_w": (n * h, "n·h", True)}
        sizes |= {"C_z": (h * n, "h·n", True), "input_gains": (h, "h", True)}
        for name, (size, words, optional) in sizes.items():
            value = getattr(self, name)
            if len(value) != size and not (optional and not value):
                problems.append(Problem(name, value, f"has {len(value)} numbers and must have {words} = {size}"))
        if len(self.weights) % (m * r) if r else self.weights:
            needed = f"{m * r} numbers, or a multiple" if r else "none, because radii is empty"
            problems.append(Problem("weights", self.weights, f"has {len(self.weights)} numbers and must have {needed}"))
        if any(radius < 0.0 for radius in self.radii):
            problems.append(Problem("radii", self.radii, "must be ≥ 0 V"))
        yield from problems
        if problems:
            return
        for system, words in ((self.linear, "without hysteresis"), (self.small, "small"), (self.large, "large")):
            radius = max(np.abs(system.poles), default=0.0)
            if radius >= 1.0:
                which = words if words.startswith("without") else f"for {words} motions, with the slopes of the plays"
                allowed = f"is unstable {which}: its largest pole has modulus {radius:.6g}, which must be below 1"
                yield Problem("A", self.A, allowed)
                return


@kernel
def structure_output(p, x, u, y):
    """Write C x + D u, for the present state and the inputs ``u`` (m), to ``y`` (q)."""
    n, m, q = int(p[ORDER]), int(p[INPUTS]), int(p[OUTPUTS])
    c = ROWS + 2 * n + n * n + n * m + n * int(p[HYSTERESES])
    d = c + q * n
    for i in range(q):
        y[i] = accumulate(accumulate(0.0, p, d + i * m, u, 0, m), p, c + i * n, x, 0, n)


@kernel
def structure_advance(p, x, u):
    """Hold the inputs ``u`` (m) for one sample; plays and states advance to the next sample."""
    n, m, q, h, r = int(p[ORDER]), int(p[INPUTS]), int(p[OUTPUTS]), int(p[HYSTERESES]), int(p[PLAYS])
    a = ROWS + 2 * n
    b = a + n * n
    bw = b + n * m
    cz = bw + n * h + q * n + q * m
    gain = cz + h * n
    radius = gain + h
    weight = radius + r
    drive = 2 * n
    for i in range(h):
        z = accumulate(p[gain + i] * u[i % m], p, cz + i * n, x, 0, n)
        w = 0.0
        for j in range(r):
            place = drive + h + i * r + j
            value = x[place]
            if z - p[radius + j] > value:
                value = z - p[radius + j]
            elif z + p[radius + j] < value:
                value = z + p[radius + j]
            x[place] = value
            w += p[weight + i * r + j] * value
        x[drive + i] = w
    for i in range(n):
        # if A is block-diagonal (modes), a row takes only two products
        first, behind = int(p[ROWS + 2 * i]), int(p[ROWS + 2 * i + 1])
        total = accumulate(0.0, p, b + i * m, u, 0, m)
        total = accumulate(total, p, bw + i * h, x, drive, h)
        x[n + i] = accumulate(total, p, a + i * n + first, x, first, behind - first)
    for i in range(n):
        value = x[n + i]
        # this form of the comparison keeps NaN
        x[i] = 0.0 if -NOTHING < value < NOTHING else value


@composite("void", "array", "array", "table", "table")
def run_structure(p, x, u, y):
    """Write the outputs for the inputs ``u`` (N, m) to ``y`` (N, q), sample by sample."""
    for k in range(u.shape[0]):
        structure_output(p, x, u[k], y[k])
        structure_advance(p, x, u[k])


class Structure:
    """A running structure: each step returns the output of the present state and advances by one sample.

    Parameters
    ----------
    parameters : StructureParameters
        Matrices and plays.
    sample_time : float
        Sample time of the loop [s].

    Raises
    ------
    ParameterError
        The parameters are wrong, or state another sample time.
    """

    def __init__(self, parameters: StructureParameters, sample_time: float):
        parameters.validated().require_sample_time(sample_time)
        self.parameters = parameters
        self.sample_time = float(sample_time)
        self.p = packed(parameters)
        self.x = self.initial_state()

    def initial_state(self) -> np.ndarray:
        """Return x at rest with zero input and plays in their initial state, shape (2 n + h + h r,)."""
        n, h = self.parameters.order, self.parameters.hystereses
        return np.zeros(2 * n + h + h * len(self.parameters.radii))

    @property
    def state(self) -> np.ndarray:
        """Copy of the state array; assign it to restore the state exactly."""
        return self.x.copy()

    @state.setter
    def state(self, value) -> None:
        self.x[:] = value

    def reset(self) -> None:
        """Return to the state at rest."""
        self.x[:] = 0.0

    def step(self, u) -> np.ndarray:
        """Return the output [m], shape (q,), at the inputs ``u`` [V], shape (m,); then advance by one sample."""
        u = np.ascontiguousarray(u, dtype=np.float64)
        y = np.empty(self.parameters.outputs)
        interpreted(structure_output)(self.p, self.x, u, y)
        structure_advance(self.p, self.x, u)
        return y

    def simulate(self, u) -> np.ndarray:
        """Return the outputs [m], shape (N, q), for inputs ``u`` [V], shape (N, m), starting at the present state."""
        u = np.ascontiguousarray(u, dtype=np.float64)
        if u.ndim != 2 or u.shape[1] != self.parameters.inputs:
            allowed = f"must have shape (N, {self.parameters.inputs}), a column for each input"
            raise ParameterError([Problem("u", u.shape, allowed)])
        y = np.empty((len(u), self.parameters.outputs))
        compiled(run_structure)(self.p, self.x, u, y)
        return y

    def settle(self, u) -> None:
        """Set the state to the steady state for constant inputs ``u`` [V], reached from zero without reversal.

        Raises
        ------
        ParameterError
            The search for a common steady state of hysteresis and structure does not converge.
        """
        given, u = self.parameters, np.asarray(u, dtype=float)
        n, h, r = given.order, given.hystereses, len(given.radii)
        linear, radii = given.linear, np.array(given.radii, dtype=float)
        still = np.eye(n) - linear.A
        plays, w = np.zeros((h, r)), np.zeros(h)
        for _ in range(REST_STEPS):
            x = solve(still, product(linear.B, u) + product(given.hysteresis_input, w))
            z = product(given.hysteresis_gains, u) + product(given.hysteresis_motion, x)
            # starting at zero, a play moves to the nearest value within its radius of z
            plays = np.sign(z)[:, None] * np.maximum(np.abs(z)[:, None] - radii, 0.0)
            before, w = w, (given.play_weights * plays).sum(axis=1)
            if np.all(np.abs(w - before) <= REST_CHANGE * np.abs(w)):
                break
        else:
            allowed = "the search for the steady state does not converge: lower weights, B_w or C_z"
            raise ParameterError([Problem("u", u.tolist(), allowed)])
        self.x[:] = np.concatenate([x, np.zeros(n), w, plays.ravel()])


def packed(parameters: StructureParameters) -> np.ndarray:
    """Return the parameter array p of the kernels."""
    linear, n = parameters.linear, parameters.order
    sizes = parameters.inputs, parameters.outputs, parameters.hystereses, len(parameters.radii)
    used = linear.A != 0.0
    rows = [(int(np.argmax(row)), n - int(np.argmax(row[::-1]))) if row.any() else (0, 0) for row in used]
    parts = [np.array([n, *sizes], dtype=float)]
    parts += [np.array(rows, dtype=float).ravel(), linear.A.ravel(), linear.B.ravel()]
    parts += [parameters.hysteresis_input.ravel(), linear.C.ravel(), linear.D.ravel()]
    parts += [parameters.hysteresis_motion.ravel(), parameters.gains]
    parts += [np.array(parameters.radii, dtype=float), np.array(parameters.weights, dtype=float)]
    return np.ascontiguousarray(np.concatenate(parts))
