# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Checks of an inchworm's gait against the parameters of motor and compensator."""

from __future__ import annotations

import cmath
import math

from hysteresis_ros.errors import Problem
from hysteresis_ros.models.compensator import reachable_commands
from hysteresis_ros.models.linear_algebra import eigenvalues
from hysteresis_ros.references.inchworm_parameters import SWING_RANGE
from hysteresis_ros.references.inchworm_steps import LOAD_PART

#: Ratio of holding force to load below which a warning is given.
SAFETY_FACTOR = 2.0
#: Shortest motion of the extender without a warning, in periods of the slider's oscillation on the extender.
SWINGS = 2.0
#: Largest crossover frequency of a designed loop, as a fraction of the slider's resonance on the extender.
CROSSOVER_PART = 0.25


def inchworm_problems(plant, parts):
    """Yield a Problem for each parameter of the gait that does not fit the other nodes.

    The problems are: an adaptive inverse, extensions beyond the range of the compensator, clamps that hold too little
    or are too slow, voltages beyond the range of the clamps' amplifiers, travel beyond the end stops.
    """
    adaptation = parts["hysteresis_compensator"].adaptation
    if adaptation.type != "none":
        remedy = "needs a measurement of the actuator itself, but a motor measures its slider: use none"
        yield Problem("hysteresis_compensator: adaptation.type", adaptation.type, remedy)
    sequencer = parts["inchworm_sequencer"]
    gait, motor = sequencer.gait, plant.inchworm
    lowest, highest = reachable_commands(parts["hysteresis_compensator"], 1.0 / plant.sample_rate)
    for name, value in (
        ("lowest_extension", gait.lowest_extension - gait.fine_margin),
        ("highest_extension", gait.highest_extension + gait.fine_margin),
    ):
        if not lowest <= value <= highest:
            remedy = f"lies, with fine_margin, beyond the range of the compensator, {lowest:.4g} … {highest:.4g} m"
            yield Problem(f"inchworm_sequencer: gait.{name}", getattr(gait, name), remedy)
    yield from motor.holding_problems(gait.grip_voltage, gait.grip_voltage, prefix="plant_simulator: inchworm.")
    for name in ("front_clamp", "rear_clamp"):
        clamp = getattr(motor, name)
        settling = clamp.lag.settling_time()
        if gait.clamp_settling < settling:
            remedy = f"shorter than the settling time of the plant's {name}: must be ≥ {settling:.3g} s"
            yield Problem("inchworm_sequencer: gait.clamp_settling", gait.clamp_settling, remedy)
        low, high = clamp.limits.minimum, clamp.limits.maximum
        for which in ("grip_voltage", "release_voltage", "initial_voltage"):
            value = getattr(gait, which)
            if not low <= value <= high:
                remedy = f"outside the limits of the plant's {name}: {low:g} … {high:g} V"
                yield Problem(f"inchworm_sequencer: gait.{which}", value, remedy)
    travel = motor.slider.minimum, motor.slider.maximum
    for which, value in (("minimum", sequencer.minimum), ("maximum", sequencer.maximum)):
        if not travel[0] <= value <= travel[1]:
            remedy = f"beyond the end stops of the plant's slider: {travel[0]:g} … {travel[1]:g} m"
            yield Problem(f"inchworm_sequencer: {which}", value, remedy)


def inchworm_warnings(plant, sequencer) -> tuple[str, ...]:
    """Return the warnings about the holding force of the clamps, the load, fast motions and continuous walking."""
    return (*_doubts(plant.inchworm, sequencer.gait), *_walking_doubts(plant, sequencer.walk))


def design_warnings(plant, crossovers) -> tuple[str, ...]:
    """Return a warning if one of the ``crossovers`` [Hz] of a design is close to the slider's resonance, or above it.

    The resonance is not in the model.
    """
    frequency = 1.0 / _swing(plant.inchworm)
    highest = max(crossovers, default=0.0)
    if highest <= CROSSOVER_PART * frequency:
        return ()
    return (
        f"the design's crossover frequency is {highest:.4g} Hz, and its model lacks the slider's resonance on the "
        f"extender at {frequency:.4g} Hz: the loop will oscillate; give a --bandwidth below "
        f"{CROSSOVER_PART * frequency:.3g} Hz",
    )


def _swing(motor) -> float:
    """Return the period of the slider's oscillation on the extender [s]."""
    return 2.0 * math.pi * math.sqrt(motor.slider.mass / motor.extender_stiffness)


def _walking_doubts(plant, walk):
    """Yield a warning for each assumption of continuous walking that the motor violates."""
    if not walk.continuous:
        return
    motor = plant.inchworm
    swing = 1.0 / _swing(motor)
    if walk.swing > 0.0 and abs(walk.swing / swing - 1.0) > SWING_RANGE:
        yield (
            f"inchworm_sequencer: walk.swing = {walk.swing:g} Hz, but the slider oscillates on the extender at "
            f"{swing:.4g} Hz: learning may not converge; set walk.swing to this frequency"
        )
    poles = [complex(pole) for pole in eigenvalues(plant.dynamics.matrices.A)]
    modes = [abs(cmath.log(pole)) * plant.sample_rate / (2.0 * math.pi) for pole in poles if pole.imag > 0.0]
    if walk.resonance > 0.0 and not any(abs(walk.resonance / mode - 1.0) <= SWING_RANGE for mode in modes):
        said = " and ".join(f"{mode:.4g} Hz" for mode in sorted(modes)) or "none"
        yield (
            f"inchworm_sequencer: walk.resonance = {walk.resonance:g} Hz, but the extender's resonance is {said}: the "
            "error rises with the square of the speed; set walk.resonance to this frequency"
        )
    deflection = abs(motor.slider.force) / motor.extender_stiffness
    if deflection > walk.bound:
        yield (
            f"inchworm_sequencer: the load bends the extender by {deflection:.3g} m, more than walk.bound = "
            f"{walk.bound:g} m can compensate: raise walk.bound and shorten walk.step"
        )


def _doubts(motor, gait):
    load = abs(motor.slider.force)
    holding = motor.holding_force(gait.grip_voltage, gait.grip_voltage)
    for name, force in zip(("front_clamp", "rear_clamp"), holding, strict=True):
        if force < SAFETY_FACTOR * load:
            yield (
                f"plant_simulator: inchworm.{name} holds {force:.3g} N at {gait.grip_voltage:g} V, "
                f"{force / load:.3g} times the load of {load:.3g} N; at least {SAFETY_FACTOR:g} times is advisable"
            )
    deflection = load / motor.extender_stiffness
    if deflection > LOAD_PART * gait.stroke:
        yield (
            f"plant_simulator: the load of {load:.3g} N bends the extender by {deflection:.3g} m, more than "
            f"{LOAD_PART:g} of the gait's stroke of {gait.stroke:.3g} m: steps against it hardly move the slider; "
            f"lower the load to {LOAD_PART * gait.stroke * motor.extender_stiffness:.3g} N or lengthen the stroke"
        )
    swing = _swing(motor)
    for name in ("extend", "contract"):
        value = getattr(gait, name)
        if value < SWINGS * swing:
            yield (
                f"inchworm_sequencer: gait.{name} = {value:g} s is shorter than {SWINGS:g} periods of the slider's "
                f"oscillation on the extender ({1.0 / swing:.4g} Hz), {SWINGS * swing:.3g} s: the slider still "
                "oscillates at the end of a step"
            )
