# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Slider held and carried by friction: set-valued Coulomb friction with Moreau's time stepping, solved exactly.

The slider has two contacts: one fixed to the body (rear), one on the tip of an elastic extender (front). Over a step of
length h from k to k+1, with the extender's free displacement u at k+1 and its stiffness k_e,

* m (v⁺ - v) = h (F + λ_f + λ_r),  q⁺ = q + h v⁺
* rear: λ_r ∈ -R_r Sign(v⁺)
* front: λ_f ∈ -R_f Sign(h v⁺ - (t⁺ - t)), t⁺ = u - λ_f/k_e (the reaction of *this* step shortens the extender)

where R is the friction limit μ N at k+1. The inclusion of the front contact has the solution λ_f = clip(k_e (u - t - h
v⁺), ±R_f), a decreasing function of v⁺. Therefore v⁺ is the only zero of a strictly monotone function with two kinks
and one jump. This zero has a closed form without iteration for any step, mass and stiffness (Moreau, "Unilateral
contact and dry friction in finite freedom dynamics", 1988). A contact that stuck in the previous step has the static
limit μ_s N; a contact that slid has the kinetic limit μ_k N. A contact that begins to slide gets the kinetic limit
within the same step. A sticking contact does not move at all: its grip is stored as a distance and not summed from
steps, so it does not drift. End stops are rigid and stop the slider.

Real contacts deform before they slide, and they move the slider while they close. Each contact has a compliance c. The
rear contact is a spring k_r = 1/c_r to an anchor a; the front contact is in series with the extender, k_f = 1/(1/k_e +
c_f):

* λ_r = clip(k_r (a - q⁺) - d_r v⁺, ±R_r),  λ_f = clip(k_f (u + g - q⁺) + d_f (u̇ - v⁺), ±R_f)

with dampers d = 2 ζ √(k m). A sliding contact moves its anchor (a or g). An increase ΔN of the normal force moves the
anchor by κ ΔN, which is the kick of a clamp. The sum of the forces again decreases with v⁺, and has four kinks.

The scheme is unconditionally stable. Like every implicit Euler step it adds damping: while the front clamp sticks,
slider and extender oscillate at ω = √(k_e/m) with the damping ratio ω h/2 instead of the joint's ratio. With
compliant contacts the damping ratio of the joint is ζ, and a sample is divided into enough steps to make ω h/2 small
compared with ζ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, group, parameter
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models import elementary
from hysteresis_ros.models.block import Block, kernel
from hysteresis_ros.models.sensor import SensorParameters

# Layout of p.
STEP = 0  # sample time [s]
MASS = 1  # [kg]
FORCE = 2  # external force and gravity [N]; positive: towards larger displacement
STIFFNESS = 3  # stiffness of the extender [N/m]
MINIMUM = 4  # end stops [m]
MAXIMUM = 5
SUBSTEPS = 6  # number of steps within a sample; 0: rigid contacts with one step
FRONT_STIFFNESS = 7  # stiffness of the compliant contacts [N/m]; the front contact is in series with the extender
REAR_STIFFNESS = 8
FRONT_DAMPING = 9  # [N s/m]
REAR_DAMPING = 10
FRONT_KICK = 11  # motion of the contact divided by the change of its static limit [m/N]
REAR_KICK = 12

# Layout of x.
POSITION = 0  # position of the slider [m]
VELOCITY = 1  # [m/s]
TIP = 2  # displacement of the extender under its load [m]
GRIP = 3  # slider - tip [m] while the front contact sticks; with compliant contacts, the front anchor
FRONT_STUCK = 4  # 1 if the contact stuck in the last step
REAR_STUCK = 5
FRONT_FORCE = 6  # friction on the slider in the last step [N]; the extender carries -FRONT_FORCE
REAR_FORCE = 7
STOP_FORCE = 8  # force of the end stops [N]
FRONT_SLIP = 9  # sliding distance in the contact in the last step [m]
REAR_SLIP = 10
DISSIPATED = 11  # energy dissipated by friction so far [J]
FRONT_STATIC = 12  # friction limits [N] for this step; the caller writes them
FRONT_KINETIC = 13
REAR_STATIC = 14
REAR_KINETIC = 15
FREE = 16  # compliant contacts: free displacement of the extender after the last step [m]
ANCHOR = 17  # anchor of the rear contact [m]
BEFORE = 18  # the four friction limits of the last sample [N]
STATES = 22

#: Maximum number of passes in a step: each of the two contacts can change to kinetic friction once.
PASSES = 3
#: Allowed numerical damping of the steps within a sample, as a fraction of the damping of the joint.
CONVERGED = 0.1
MOST_SUBSTEPS = 1000


@kernel
def clip(value, bound):
    """Return ``value`` limited to ±``bound``."""
    return min(max(value, -bound), bound)


@kernel
def slider_velocity(p, velocity, lead, front, rear):
    """Return the velocity [m/s] at the end of a step, without end stops.

    ``velocity`` [m/s] is the velocity before the step; ``lead`` [m] is the extender's free displacement minus the tip;
    ``front`` and ``rear`` [N] are the friction limits.
    """
    step, mass, stiffness = p[STEP], p[MASS], p[STIFFNESS]
    drive = mass * velocity / step + p[FORCE]
    at_rest = drive + clip(stiffness * lead, front)
    if math.fabs(at_rest) <= rear:
        return 0.0
    direction = 1.0 if at_rest > 0.0 else -1.0
    drive -= direction * rear
    v = step * (drive + stiffness * lead) / (mass + step * step * stiffness)
    carried = stiffness * (lead - step * v)
    if carried > front:
        v = step * (drive + front) / mass
    elif carried < -front:
        v = step * (drive - front) / mass
    # the sign is known; without this limit, rounding could move a slowly moving slider against the force on it
    return v if v * direction > 0.0 else 0.0


@kernel
def slide(p, x, u):
    """Return the slider's position [m] one sample later; ``u`` is the extender's free displacement [m] at that sample.

    ``x[12:16]`` contains the friction limits of both contacts.
    """
    step, mass, stiffness = p[STEP], p[MASS], p[STIFFNESS]
    position, before = x[POSITION], x[VELOCITY]
    lead = u - x[TIP]
    front = x[FRONT_STATIC] if x[FRONT_STUCK] > 0.0 else x[FRONT_KINETIC]
    rear = x[REAR_STATIC] if x[REAR_STUCK] > 0.0 else x[REAR_KINETIC]
    v, following, wanted = before, position, 0.0
    for _ in range(PASSES):
        v = slider_velocity(p, before, lead, front, rear)
        following = position + step * v
        if following > p[MAXIMUM]:
            following = p[MAXIMUM]
            v = (following - position) / step
        elif following < p[MINIMUM]:
            following = p[MINIMUM]
            v = (following - position) / step
        wanted = stiffness * (lead - step * v)
        lets_go = False
        if math.fabs(wanted) > front and front > x[FRONT_KINETIC]:
            front = x[FRONT_KINETIC]
            lets_go = True
        if v != 0.0 and rear > x[REAR_KINETIC]:
            rear = x[REAR_KINETIC]
            lets_go = True
        if not lets_go:
            break
    front_force = clip(wanted, front)
    inertia = mass * (v - before) / step
    if v > 0.0:
        rear_force = -rear
    elif v < 0.0:
        rear_force = rear
    else:
        rear_force = clip(inertia - p[FORCE] - front_force, rear)
    at_stop = following == p[MAXIMUM] or following == p[MINIMUM]
    x[STOP_FORCE] = inertia - p[FORCE] - front_force - rear_force if at_stop else 0.0
    x[REAR_SLIP] = following - position
    x[REAR_STUCK] = 1.0 if v == 0.0 and rear > 0.0 else 0.0
    if front > 0.0 and math.fabs(wanted) <= front:
        x[FRONT_STUCK] = 1.0
        x[FRONT_SLIP] = 0.0
        x[TIP] = following - x[GRIP]
    else:
        tip = u - front_force / stiffness
        x[FRONT_STUCK] = 0.0
        x[FRONT_SLIP] = (following - position) - (tip - x[TIP])
        x[TIP] = tip
        x[GRIP] = following - tip
    x[DISSIPATED] -= front_force * x[FRONT_SLIP] + rear_force * x[REAR_SLIP]
    x[FRONT_FORCE] = front_force
    x[REAR_FORCE] = rear_force
    x[VELOCITY] = v
    x[POSITION] = following
    return following


@kernel
def elastic_velocity(p, step, velocity, front, rear):
    """Return the velocity [m/s] at the end of a step between compliant contacts, without end stops.

    ``velocity`` [m/s] is the velocity before the step. ``front`` and ``rear`` each contain three values, a [N],
    b [N s/m] and a bound [N]: the contact transmits the force a − b v, limited to ± the bound.
    """
    (a_f, b_f, most_f), (a_r, b_r, most_r) = front, rear
    inertia = p[MASS] / step
    drive = inertia * velocity + p[FORCE]
    # the imbalance of the forces increases with v; between two kinks it is linear
    low, high = -math.inf, math.inf
    for kink in ((a_f - most_f) / b_f, (a_f + most_f) / b_f, (a_r - most_r) / b_r, (a_r + most_r) / b_r):
        if inertia * kink - drive - clip(a_f - b_f * kink, most_f) - clip(a_r - b_r * kink, most_r) <= 0.0:
            low = max(low, kink)
        else:
            high = min(high, kink)
    if low == -math.inf:
        inside = high - 1.0
    elif high == math.inf:
        inside = low + 1.0
    else:
        inside = 0.5 * (low + high)
    for a, b, bound in (front, rear):
        carried = a - b * inside
        if carried > bound:
            drive += bound
        elif carried < -bound:
            drive -= bound
        else:
            drive += a
            inertia += b
    return min(max(drive / inertia, low), high)


@kernel
def elastic_step(p, x, step, u, rate, front_bounds, rear_bounds):
    """Compute a step with compliant contacts, in which the free displacement goes to ``u`` [m] at ``rate`` [m/s].

    ``front_bounds`` and ``rear_bounds`` are the friction limits [N], static and kinetic.
    """
    (front_static, front_kinetic), (rear_static, rear_kinetic) = front_bounds, rear_bounds
    k_f, k_r, d_f, d_r = p[FRONT_STIFFNESS], p[REAR_STIFFNESS], p[FRONT_DAMPING], p[REAR_DAMPING]
    position, before = x[POSITION], x[VELOCITY]
    a_f, b_f = k_f * (u + x[GRIP] - position) + d_f * rate, step * k_f + d_f
    a_r, b_r = k_r * (x[ANCHOR] - position), step * k_r + d_r
    front = front_static if x[FRONT_STUCK] > 0.0 else front_kinetic
    rear = rear_static if x[REAR_STUCK] > 0.0 else rear_kinetic
    v, following = before, position
    for _ in range(PASSES):
        v = elastic_velocity(p, step, before, (a_f, b_f, front), (a_r, b_r, rear))
        following = min(max(position + step * v, p[MINIMUM]), p[MAXIMUM])
        v = (following - position) / step
        lets_go = False
        if math.fabs(a_f - b_f * v) > front and front > front_kinetic:
            front = front_kinetic
            lets_go = True
        if math.fabs(a_r - b_r * v) > rear and rear > rear_kinetic:
            rear = rear_kinetic
            lets_go = True
        if not lets_go:
            break
    front_force, rear_force = clip(a_f - b_f * v, front), clip(a_r - b_r * v, rear)
    x[FRONT_STUCK] = 1.0 if front > 0.0 and math.fabs(a_f - b_f * v) <= front else 0.0
    x[REAR_STUCK] = 1.0 if rear > 0.0 and math.fabs(a_r - b_r * v) <= rear else 0.0
    # a sliding contact moves its anchor; an open contact has no spring and no damper
    if x[FRONT_STUCK] == 0.0:
        spring = front_force - d_f * (rate - v) if front > 0.0 else 0.0
        slid = spring / k_f - u + following - x[GRIP]
        x[GRIP] += slid
        x[FRONT_SLIP] += slid
        x[DISSIPATED] -= front_force * slid
    if x[REAR_STUCK] == 0.0:
        spring = rear_force + d_r * v if rear > 0.0 else 0.0
        slid = spring / k_r + following - x[ANCHOR]
        x[ANCHOR] += slid
        x[REAR_SLIP] += slid
        x[DISSIPATED] -= rear_force * slid
    at_stop = following == p[MAXIMUM] or following == p[MINIMUM]
    inertia = p[MASS] * (v - before) / step
    x[STOP_FORCE] = inertia - p[FORCE] - front_force - rear_force if at_stop else 0.0
    x[FRONT_FORCE], x[REAR_FORCE] = front_force, rear_force
    x[VELOCITY], x[POSITION] = v, following


@kernel
def slide_elastically(p, x, u):
    """Return the slider's position [m] one sample later, with compliant contacts; otherwise the same as :func:`slide`.

    Within the sample, free displacement and friction limits change linearly from their previous values.
    """
    steps = int(p[SUBSTEPS])
    step = p[STEP] / steps
    rise = (u - x[FREE]) / steps
    free = x[FREE]
    x[FRONT_SLIP] = x[REAR_SLIP] = 0.0
    for i in range(steps):
        part = (i + 1.0) / steps
        free += rise
        x[GRIP] += p[FRONT_KICK] * (x[FRONT_STATIC] - x[BEFORE]) / steps
        x[ANCHOR] += p[REAR_KICK] * (x[REAR_STATIC] - x[BEFORE + 2]) / steps
        elastic_step(
            p,
            x,
            step,
            free,
            rise / step,
            (
                x[BEFORE] + part * (x[FRONT_STATIC] - x[BEFORE]),
                x[BEFORE + 1] + part * (x[FRONT_KINETIC] - x[BEFORE + 1]),
            ),
            (
                x[BEFORE + 2] + part * (x[REAR_STATIC] - x[BEFORE + 2]),
                x[BEFORE + 3] + part * (x[REAR_KINETIC] - x[BEFORE + 3]),
            ),
        )
    for i in range(4):
        x[BEFORE + i] = x[FRONT_STATIC + i]
    x[FREE] = u
    x[TIP] = u - x[FRONT_FORCE] / p[STIFFNESS]
    return x[POSITION]


@dataclass(frozen=True)
class SliderParameters(Parameters):
    """Slider of an inchworm motor: mass, load and travel."""

    mass: float = parameter(description="mass that moves with the slider", unit="kg", low=1e-6, high=1e4)
    external_force: float = parameter(
        0.0, description="load on the slider, positive toward larger displacement", unit="N", low=-1e6, high=1e6
    )
    inclination: float = parameter(
        0.0,
        description="angle of the direction of larger displacement above the horizontal",
        unit="rad",
        low=-1.5707963267948966,
        high=1.5707963267948966,
    )
    gravity: float = parameter(9.80665, description="acceleration of free fall", unit="m/s²", low=0.0, high=100.0)
    minimum: float = parameter(description="end stop at the smallest displacement", unit="m")
    maximum: float = parameter(description="end stop at the largest displacement", unit="m")
    start: float = parameter(0.0, description="displacement at the start", unit="m")
    damping: float = parameter(
        0.0,
        description="damping ratio of the slider on compliant contacts",
        low=0.0,
        high=10.0,
        read_only=True,
    )
    substeps: int = parameter(
        1,
        description="steps within a sample, with compliant contacts; 0: enough for a numerical damping ≤ damping/10",
        low=0,
        high=1000,
        read_only=True,
    )
    sensor: SensorParameters = group(SensorParameters)

    @property
    def force(self) -> float:
        """External force plus the component of the weight in the direction of travel [N]."""
        return self.external_force - self.mass * self.gravity * elementary.sin(self.inclination)

    def check(self):
        """Yield a Problem for an empty travel, a start outside of it, or automatic substeps without damping."""
        if not self.minimum < self.maximum:
            yield Problem("minimum", self.minimum, f"must be below maximum ({self.maximum:g} m)")
        elif not self.minimum <= self.start <= self.maximum:
            remedy = f"must lie within the travel minimum … maximum = {self.minimum:g} … {self.maximum:g} m"
            yield Problem("start", self.start, remedy)
        if self.substeps == 0 and not self.damping > 0.0:
            remedy = "chooses as many steps as slider.damping needs: set slider.damping above 0, e.g. 0.03"
            yield Problem("substeps", self.substeps, remedy)


@dataclass(frozen=True)
class Contacts:
    """Compliance and kick of the contacts; the contacts are rigid unless both compliances are above 0.

    Parameters
    ----------
    front_compliance, rear_compliance : float
        [m/N]
    front_kick, rear_kick : float
        Motion of the contact divided by the change of its static friction limit [m/N].
    """

    front_compliance: float = 0.0
    rear_compliance: float = 0.0
    front_kick: float = 0.0
    rear_kick: float = 0.0

    @property
    def rigid(self) -> bool:
        """Whether the contacts are treated as rigid, which they are unless both are compliant."""
        return not (self.front_compliance > 0.0 and self.rear_compliance > 0.0)


class Slider(Block):
    """Slider between two friction contacts; write the friction limits [N] to ``x[12:16]`` before each step.

    Parameters
    ----------
    parameters : SliderParameters
        Mass, load and travel.
    sample_time : float
        Sample time [s].
    stiffness : float
        Stiffness of the extender that carries the front contact [N/m].
    contacts : Contacts, optional
        Compliance of the contacts; rigid by default.
    """

    def __init__(
        self, parameters: SliderParameters, sample_time: float, stiffness: float, contacts: Contacts | None = None
    ):
        self.stiffness = float(stiffness)
        self.contacts = contacts or Contacts()
        self.kernel = slide if self.contacts.rigid else slide_elastically
        super().__init__(parameters, sample_time)

    def pack(self, parameters: SliderParameters) -> np.ndarray:
        """Return p, shape (13,)."""
        travel = (parameters.minimum, parameters.maximum)
        head = [self.sample_time, parameters.mass, parameters.force, self.stiffness, *travel]
        contacts = self.contacts
        if contacts.rigid:
            return np.array([*head, *np.zeros(7)])
        springs = [1.0 / (1.0 / self.stiffness + contacts.front_compliance), 1.0 / contacts.rear_compliance]
        dampers = [2.0 * parameters.damping * math.sqrt(spring * parameters.mass) for spring in springs]
        steps = parameters.substeps
        if steps == 0:
            numerical = 0.5 * self.sample_time * math.sqrt(springs[0] / parameters.mass)
            steps = min(max(math.ceil(numerical / (CONVERGED * parameters.damping)), 1), MOST_SUBSTEPS)
        return np.array([*head, steps, *springs, *dampers, contacts.front_kick, contacts.rear_kick])

    def initial_state(self) -> np.ndarray:
        """Return x, shape (22,): at rest at the start, both contacts open, the extender at 0."""
        x = np.zeros(STATES)
        x[POSITION] = x[GRIP] = x[ANCHOR] = self.parameters.start
        return x

    def settle(self, free: float) -> None:
        """Set the slider to rest under its load; the rear contact carries the load, up to its limit in ``x``.

        Parameters
        ----------
        free : float
            Displacement of the extender without load [m].
        """
        x, load = self.x, self.p[FORCE]
        x[REAR_FORCE] = clip(-load, x[REAR_STATIC])
        x[FRONT_FORCE] = clip(-load - x[REAR_FORCE], x[FRONT_STATIC])
        x[REAR_STUCK], x[FRONT_STUCK] = float(x[REAR_STATIC] > 0.0), float(x[FRONT_STATIC] > 0.0)
        x[TIP] = free - x[FRONT_FORCE] / self.p[STIFFNESS]
        x[GRIP] = x[POSITION] - x[TIP]
        if not self.contacts.rigid:
            x[GRIP] = x[POSITION] - free + x[FRONT_FORCE] / self.p[FRONT_STIFFNESS]
            x[ANCHOR] = x[POSITION] + x[REAR_FORCE] / self.p[REAR_STIFFNESS]
            x[FREE] = free
            x[BEFORE : BEFORE + 4] = x[FRONT_STATIC : FRONT_STATIC + 4]

    def check_travel(self, parameters: SliderParameters) -> None:
        """Raise ParameterError if the slider is outside the new travel."""
        position = float(self.x[POSITION])
        for name, inside in (
            ("minimum", parameters.minimum <= position),
            ("maximum", position <= parameters.maximum),
        ):
            if not inside:
                remedy = f"the slider is at {position:g} m, outside the new travel: choose a travel that contains it"
                raise ParameterError([Problem(f"inchworm.slider.{name}", getattr(parameters, name), remedy)])
