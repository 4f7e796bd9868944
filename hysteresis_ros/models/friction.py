"""A slider held and carried by friction: set-valued Coulomb friction, time stepping after Moreau, solved exactly.

The slider has two contacts, one fixed to the body (rear), one on the tip of an elastic extender (front). Over a step h
from k to k+1, with the extender's free displacement u at k+1 and its stiffness k_e,

* m (v⁺ - v) = h (F + λ_f + λ_r),  q⁺ = q + h v⁺
* rear: λ_r ∈ -R_r Sign(v⁺)
* front: λ_f ∈ -R_f Sign(h v⁺ - (t⁺ - t)), t⁺ = u - λ_f/k_e (the reaction of *this* step shortens the extender)

where R is the friction limit μ N at k+1. The front's inclusion has the solution λ_f = clip(k_e (u - t - h v⁺), ±R_f),
a falling function of v⁺, so v⁺ is the only zero of a strictly monotone function with two kinks and one jump: it is
found in closed form, without iteration and for any step, mass and stiffness (Moreau, "Unilateral contact and dry
friction in finite freedom dynamics", 1988). A contact that stuck before has the static limit μ_s N, one that slid the
kinetic μ_k N; one that lets go at its static limit gets the kinetic one within the same step. A sticking contact moves
by exactly nothing; the grip is remembered as a distance and not as a sum, so nothing drifts. End stops are rigid and
take all of the speed.

The scheme is unconditionally stable. Like every implicit Euler step it damps: slider and extender, while the front
clamp sticks, oscillate at ω = √(k_e/m) with the damping ratio ω h/2, which stands for the damping of the real joint.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros import elementary
from hysteresis_ros.block import Block, kernel
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.sensor import SensorParameters
from hysteresis_ros.parameters import Parameters, group, parameter

# Layout of p.
STEP = 0  # sample time [s]
MASS = 1  # [kg]
FORCE = 2  # external force and gravity [N], positive: toward larger displacement
STIFFNESS = 3  # of the extender [N/m]
MINIMUM = 4  # end stops [m]
MAXIMUM = 5

# Layout of x.
POSITION = 0  # of the slider [m]
VELOCITY = 1  # [m/s]
TIP = 2  # displacement of the extender under its load [m]
GRIP = 3  # slider - tip while the front contact sticks [m]
FRONT_STUCK = 4  # 1 when the contact stuck in the last step
REAR_STUCK = 5
FRONT_FORCE = 6  # friction on the slider in the last step [N]; the extender carries -FRONT_FORCE
REAR_FORCE = 7
STOP_FORCE = 8  # of the end stops [N]
FRONT_SLIP = 9  # how far the slider slid in the contact in the last step [m]
REAR_SLIP = 10
DISSIPATED = 11  # energy that friction took so far [J]
FRONT_STATIC = 12  # friction limits of this step [N]: inputs, written by whoever knows the normal forces
FRONT_KINETIC = 13
REAR_STATIC = 14
REAR_KINETIC = 15
STATES = 16

#: Two contacts can each go once from static to kinetic friction within a step.
PASSES = 3


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
    sensor: SensorParameters = group(SensorParameters)

    @property
    def force(self) -> float:
        """External force and the part of the weight along the travel [N]."""
        return self.external_force - self.mass * self.gravity * elementary.sin(self.inclination)

    def check(self):
        """Yield a Problem when the travel is empty or does not hold the start."""
        if not self.minimum < self.maximum:
            yield Problem("minimum", self.minimum, f"must be below maximum ({self.maximum:g} m)")
        elif not self.minimum <= self.start <= self.maximum:
            allowed = f"must lie within the travel minimum … maximum = {self.minimum:g} … {self.maximum:g} m"
            yield Problem("start", self.start, allowed)


@kernel
def _clip(value, bound):
    """Return ``value`` limited to ±``bound``."""
    return min(max(value, -bound), bound)


@kernel
def slider_velocity(p, velocity, lead, front, rear):
    """Velocity [m/s] at the end of a step, without end stops.

    ``velocity`` [m/s] is that before; ``lead`` [m] how far the extender's free displacement is ahead of the tip;
    ``front`` and ``rear`` [N] are the friction limits.
    """
    step, mass, stiffness = p[STEP], p[MASS], p[STIFFNESS]
    drive = mass * velocity / step + p[FORCE]
    at_rest = drive + _clip(stiffness * lead, front)
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
    # the sign is certain, but rounding could turn a creeping slider against its force
    return v if v * direction > 0.0 else 0.0


@kernel
def slide(p, x, u):
    """Position [m] of the slider one sample on, when the extender without load would be at ``u`` [m] then.

    The friction limits of both contacts stand in ``x[12:16]``.
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
    front_force = _clip(wanted, front)
    inertia = mass * (v - before) / step
    if v > 0.0:
        rear_force = -rear
    elif v < 0.0:
        rear_force = rear
    else:
        rear_force = _clip(inertia - p[FORCE] - front_force, rear)
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


class Slider(Block):
    """Slider between two friction contacts; write their limits [N] to ``x[12:16]`` before each step.

    Parameters
    ----------
    parameters : SliderParameters
        Mass, load and travel.
    sample_time : float
        Sample time [s].
    stiffness : float
        Stiffness of the extender that carries the front contact [N/m].
    """

    kernel = staticmethod(slide)

    def __init__(self, parameters: SliderParameters, sample_time: float, stiffness: float):
        self.stiffness = float(stiffness)
        super().__init__(parameters, sample_time)

    def pack(self, parameters: SliderParameters) -> np.ndarray:
        """Return p, shape (6,)."""
        travel = (parameters.minimum, parameters.maximum)
        return np.array([self.sample_time, parameters.mass, parameters.force, self.stiffness, *travel])

    def initial_state(self) -> np.ndarray:
        """Return x, shape (16,): at rest at the start, both contacts open, the extender at 0."""
        x = np.zeros(STATES)
        x[POSITION] = x[GRIP] = self.parameters.start
        return x

    def settle(self, free: float) -> None:
        """Put the slider to rest under its load and the limits in ``x``; the rear contact carries what it can.

        Parameters
        ----------
        free : float
            Displacement of the extender without load [m].
        """
        x, load = self.x, self.p[FORCE]
        x[REAR_FORCE] = _clip(-load, x[REAR_STATIC])
        x[FRONT_FORCE] = _clip(-load - x[REAR_FORCE], x[FRONT_STATIC])
        x[REAR_STUCK], x[FRONT_STUCK] = float(x[REAR_STATIC] > 0.0), float(x[FRONT_STATIC] > 0.0)
        x[TIP] = free - x[FRONT_FORCE] / self.p[STIFFNESS]
        x[GRIP] = x[POSITION] - x[TIP]

    def check_travel(self, parameters: SliderParameters) -> None:
        """Raise ParameterError when a new travel leaves the slider outside."""
        position = float(self.x[POSITION])
        for name, inside in (
            ("minimum", parameters.minimum <= position),
            ("maximum", position <= parameters.maximum),
        ):
            if not inside:
                allowed = f"must leave the slider, now at {position:g} m, inside the travel"
                raise ParameterError([Problem(f"inchworm.slider.{name}", getattr(parameters, name), allowed)])
