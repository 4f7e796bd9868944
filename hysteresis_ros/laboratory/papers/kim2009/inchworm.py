# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Figures of the inchworm axis: moves in both directions, spread of step lengths, speed, and random sequences.

``python -m hysteresis_ros.laboratory.papers.kim2009.inchworm`` prints them all; ``--moves``, ``--plants`` and
``--sequences`` set the numbers of runs.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Configuration, load_configuration
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.plant import MotorPlant
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import mismatched
from hysteresis_ros.loop.source import SequencerSource
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references.inchworm_sequencer import InchwormSequencer

#: The harder case: a load of 2 N, and clamps with 20 % less normal force.
LOADED = {
    "inchworm__slider__external_force": -2.0,
    "inchworm__front_clamp__wear": 0.8,
    "inchworm__rear_clamp__wear": 0.8,
}

#: Realistic conditions: each parameter of the extender deviates by up to 5 %, and it creeps by 1.5 % per decade.
MISMATCH = 0.05
CREEP = {"creep__type": "logarithmic", "creep__logarithmic__rate": 0.015}

#: Fastest continuous walking in the random sequences [m/s].
FASTEST = 3.0e-4


def inchworm(configuration: Configuration | None = None, plant=None, sequencer=None, controller=None, compensator=None):
    """Return the axis of ``config/inchworm_travel.yaml``, or of ``configuration``, with some parameters changed."""
    configuration = configuration or load_configuration("inchworm_travel")
    for node, values in (
        ("plant_simulator", plant),
        ("inchworm_sequencer", sequencer),
        ("motion_controller", controller),
        ("hysteresis_compensator", compensator),
    ):
        if values:
            configuration = configuration.override(node, **values)
    return Axis(single_axis(configuration))


@dataclass(frozen=True)
class Move:
    """Result of one setpoint."""

    setpoint: float  #: Setpoint [m].
    error: float  #: RMS of displacement minus setpoint over the last part of the move [m].
    overshoot: float  #: Largest displacement beyond the setpoint in the direction of the move [m].
    duration: float  #: Time until the sequencer reports arrival, rounded up to an eighth of a second [s].
    steps: int  #: Number of steps.
    arrived: bool  #: Whether the motor arrived in time and without an error.


def sequencer_of(axis: Axis) -> InchwormSequencer:
    """Return the sequencer of a motor."""
    if not isinstance(axis.source, SequencerSource):
        raise TypeError(f"{type(axis.source).__name__}: no sequencer of an inchworm motor")
    return axis.source.sequencer


def _place(axis: Axis) -> float:
    """Return the position of a motor's slider [m]."""
    if not isinstance(axis.plant, MotorPlant):
        raise TypeError(f"{type(axis.plant).__name__}: no inchworm motor")
    return axis.plant.motor.displacement


def move(axis: Axis, setpoint: float, hold: float = 0.25, longest: float = 60.0) -> Move:
    """Go to ``setpoint`` [m], wait for ``hold`` [s], and evaluate the next ``hold`` [s]."""
    rate, x = axis.sample_rate, sequencer_of(axis).x
    way = np.sign(setpoint - _place(axis))
    steps, beyond, elapsed, arrived = x[at.TOTAL_STEPS], 0.0, 0.0, False
    while elapsed < longest and not arrived and not x[at.ERROR]:
        table = axis.run(np.full(round(rate / 8), setpoint))
        elapsed += 0.125
        beyond = max(beyond, float(np.max(way * (table["displacement"] - setpoint))))
        arrived = bool(np.all(table["arrived"][-round(rate / 20) :]))
    axis.run(np.full(round(hold * rate), setpoint))
    table = axis.run(np.full(round(hold * rate), setpoint))
    error = float(np.sqrt(np.mean((table["displacement"] - setpoint) ** 2)))
    return Move(setpoint, error, beyond, elapsed, int(x[at.TOTAL_STEPS] - steps), arrived)


def honest_moves(seed: int, plant=None, setpoints=(5e-3, 0.0)) -> list[Move]:
    """Move a motor whose extender differs from its models; errors are evaluated from 50 to 100 ms after the arrival.

    Units: ``setpoints`` [m].
    """
    creeping = load_configuration("inchworm_travel").override("plant_simulator", **CREEP)
    axis = inchworm(mismatched(creeping, MISMATCH, seed), plant=plant)
    axis.run(np.zeros(round(0.1 * axis.sample_rate)))
    return [move(axis, setpoint, hold=0.05, longest=120.0) for setpoint in setpoints]


def speed(axis: Axis, samples: int = 20000) -> float:
    """Return the mean speed [m/s] of walking to a far setpoint."""
    far = axis.parameters.source.maximum
    axis.run(np.full(2000, far))
    before = _place(axis)
    period = int(sequencer_of(axis).p[at.CYCLE_SAMPLES])
    samples -= samples % period
    axis.run(np.full(samples, far))
    return (_place(axis) - before) * axis.sample_rate / samples


def step_errors(inverse: str, steps: int = 200, seed: int = 1, learning: bool = True, plant=None) -> np.ndarray:
    """Return commanded minus achieved lengths [m] of open-loop steps of 10 … 99 % of the stroke, in both directions."""
    sequencer = {"fine__enabled": False, "fine__tolerance": 0.4e-6, "learning__enabled": learning}
    axis = inchworm(
        plant=plant, sequencer=sequencer, controller={"type": "open_loop"}, compensator={"inverse__type": inverse}
    )
    random = np.random.default_rng(seed)
    stroke = sequencer_of(axis).parameters.gait.stroke
    wait = round(0.06 * axis.sample_rate)
    axis.run(np.zeros(1000))
    errors: list[float] = []
    while len(errors) < steps:
        x = sequencer_of(axis).x
        if x[at.MODE] == at.FAILED:
            raise RuntimeError(f"the motor stopped with the error {sequencer_of(axis).error} after {len(errors)} steps")
        before = x[at.TOTAL_STEPS]
        start = _place(axis)
        way = random.choice([-1.0, 1.0]) if abs(start) < 1e-4 else -np.sign(start)
        setpoint = start + way * stroke * random.uniform(0.1, 0.99)
        table = axis.run(np.full(wait, setpoint))
        made = np.flatnonzero(table["total_steps"] > before)
        if made.size:
            first = made[0]
            errors.append(table["step_commanded"][first] - (table["displacement"][first] - start))
        axis.run(np.full(4 * wait, setpoint))  # time for further steps
    return np.array(errors)


@dataclass(frozen=True)
class Sequences:
    """Result of random sequences."""

    count: int  #: Number of sequences.
    both_open: int  #: Samples at which both clamps were commanded below the threshold voltage.
    least_force: float  #: Normal force of the clamp that grips harder, minimum over all samples [N].
    beyond_limits: int  #: Samples at which a voltage was outside its limits, counted for each voltage.
    #: Largest displacement beyond the range that start, setpoints and walking distance of a sequence define [m].
    farthest: float
    unsafe_stops: int  #: Stops after which the two clamps did not both close within the longest phase.
    slowest_stop: float  #: Longest time from a stop to both clamps above the threshold voltage [s].
    errors: int  #: Sequences that ended with an error of the sequencer.


def random_inputs(random, samples: int, rate: float):
    """Return setpoints [m], requests and walking speeds [m/s], shape (samples,) each, and faults of one sequence."""
    setpoints, requests = np.zeros(samples), np.zeros(samples)
    speeds, faults = np.full(samples, np.nan), []
    for k in random.integers(0, samples, random.integers(1, 8)):
        setpoints[k:] = random.choice([random.uniform(-1e-4, 1e-4), random.uniform(-5e-6, 5e-6), 2.0e-2])
    codes = (at.START_REQUEST, at.STOP_REQUEST, at.HOME_REQUEST, at.RELEASE_REQUEST)
    for k in random.integers(0, samples, random.integers(0, 6)):
        requests[k] = random.choice(codes)
        if random.uniform() < 0.7:
            requests[min(k + random.integers(1, round(0.05 * rate)), samples - 1)] = at.START_REQUEST
    for k in random.integers(0, samples, random.integers(0, 3)):
        speeds[k] = random.choice([0.0, random.uniform(-FASTEST, FASTEST)])
    for k in random.integers(0, samples, random.integers(0, 4)):
        faults.append(f"stale:{float(k / rate)!r}:{float(random.integers(1, round(0.03 * rate)) / rate)!r}")
    return setpoints, requests, speeds, tuple(faults)


def walking_distance(speeds, before: float, rate: float) -> tuple[float, float]:
    """Return the largest backward and forward distances of continuous walking [m].

    Units: ``speeds`` [m/s], ``before`` [m/s], ``rate`` [Hz].
    """
    given = np.concatenate([[before], speeds])
    last = np.maximum.accumulate(np.where(np.isnan(given), 0, np.arange(len(given))))
    in_force = given[last[1:]]
    return float(-in_force[in_force < 0.0].sum() / rate), float(in_force[in_force > 0.0].sum() / rate)


def sequences(count: int, seconds: float = 0.4, seed: int = 1, plant=None) -> Sequences:
    """Run ``count`` random sequences of setpoints, stops, faults and reversals, and count violations.

    Every tenth sequence starts from rest; the other sequences continue from the end of the previous sequence.
    """
    axis = inchworm(plant=plant)
    gait = sequencer_of(axis).parameters.gait
    rate, threshold = axis.sample_rate, gait.threshold_voltage
    limits = axis.parameters.plant_simulator.limits
    home = sequencer_of(axis).parameters.home_position
    longest = round(max(gait.extend, gait.contract) * rate) + round(gait.grip * rate)
    random = np.random.default_rng(seed)
    both_open = beyond = unsafe = errors = slowest = 0
    least, farthest = np.inf, 0.0
    for number in range(count):
        if number % 10 == 0:
            axis.reset()
        setpoints, requests, speeds, faults = random_inputs(random, round(seconds * rate), rate)
        if number % 10:
            requests[0] = at.START_REQUEST
        start, target = _place(axis), sequencer_of(axis).x[at.TARGET]
        walked = walking_distance(speeds, sequencer_of(axis).x[at.SPEED], rate)
        axis.inject(faults)
        table = axis.run(setpoints, requests=requests, speeds=speeds)
        front, rear = table["front_voltage"], table["rear_voltage"]
        both_open += int(np.count_nonzero(np.maximum(front, rear) < threshold))
        least = min(least, float(np.min(np.maximum(table["front_force"], table["rear_force"]))))
        for name, lower, upper in (
            ("front_voltage", gait.release_voltage, gait.grip_voltage),
            ("rear_voltage", gait.release_voltage, gait.grip_voltage),
            ("plant_voltage", limits.minimum, limits.maximum),
        ):
            beyond += int(np.count_nonzero((table[name] < lower) | (table[name] > upper)))
        good = setpoints[np.abs(setpoints) < 9e-3]
        asked = np.concatenate([good, [start, target, home]])
        low, high = asked.min() - walked[0], asked.max() + walked[1]
        above, below = np.max(table["displacement"]) - high, low - np.min(table["displacement"])
        farthest = max(farthest, float(above), float(below))
        closed = np.minimum(front, rear) >= threshold
        for k in np.flatnonzero(requests == at.STOP_REQUEST):
            after = np.flatnonzero(closed[k:])
            again = np.flatnonzero(requests[k + 1 :]) + 1
            wait = int(after[0]) if after.size else len(closed)
            if again.size and again[0] <= wait:
                continue  # another request arrived earlier
            if k + wait < len(closed):
                slowest = max(slowest, wait)
            unsafe += int(wait > longest and k + longest < len(closed))
        errors += int(table["error"][-1] not in (at.NO_ERROR, at.SENSOR_ERROR))
    return Sequences(count, both_open, least, beyond, farthest, unsafe, slowest / rate, errors)


def main(arguments=None) -> int:
    """Print the figures; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moves", type=int, default=10, help="number of moves of 5 mm, back and forth")
    parser.add_argument("--plants", type=int, default=10, help="number of extenders that differ from their models")
    parser.add_argument("--sequences", type=int, default=10000, help="number of random sequences")
    chosen = parser.parse_args(arguments)
    for title, plant in (("no load", None), ("2 N against, clamps 20 % weaker", LOADED)):
        axis = inchworm(plant=plant)
        axis.run(np.zeros(10))
        axis.reset()
        began = time.process_time()
        moves = [move(axis, 5e-3 * (number % 2 == 0) - 0.0) for number in range(chosen.moves)]
        real_time = axis.sample / axis.sample_rate / (time.process_time() - began) if moves else float("nan")
        print(f"{title}: {len(moves)} moves of 5 mm, {sum(one.arrived for one in moves)} arrived")
        if moves:
            print(f"  error {max(one.error for one in moves) * 1e9:.2f} nm RMS at worst")
            print(f"  overshoot {max(one.overshoot for one in moves) * 1e6:.3f} um at worst")
            print(f"  {np.mean([one.duration for one in moves]):.1f} s and {moves[-1].steps} steps a move")
            print(f"  {real_time:.0f} simulated seconds per second of processor time")
            print("  learned:", ", ".join(f"{name} {value:.4g}" for name, value in sequencer_of(axis).learned.items()))
    for title, plant in (("no load", None), ("2 N against, clamps 20 % weaker", LOADED)):
        moves = [one for seed in range(1, chosen.plants + 1) for one in honest_moves(seed, plant)]
        print(
            f"{title}, {chosen.plants} extenders up to 5 % off that creep: {sum(one.arrived for one in moves)} arrived"
        )
        if moves:
            print(f"  error {max(one.error for one in moves) * 1e9:.2f} nm RMS at worst")
            print(f"  overshoot {max(one.overshoot for one in moves) * 1e6:.3f} um at worst")
            print(f"  {min(one.steps for one in moves)} to {max(one.steps for one in moves)} steps a move")
    axis = inchworm()
    gait = sequencer_of(axis).parameters.gait
    reached = speed(axis)
    print(f"speed {reached * 1e3:.4f} mm/s, {reached / gait.speed:.4f} of stroke times frequency")
    for name, plant in (("equal model", None), ("plant 3 % off", {"hysteresis__polynomial__scale": 1.03})):
        for learning in (True, False):
            spread = {kind: float(np.std(step_errors(kind, 200, 1, learning, plant))) for kind in ("none", "exact")}
            print(f"1 sigma of the step length, {name}, {'with' if learning else 'without'} learning:")
            values = f"{spread['none'] * 1e9:.1f} nm without compensation, {spread['exact'] * 1e9:.1f} nm with it"
            print(f"  {values}, ratio {spread['none'] / spread['exact']:.1f}")
    for title, plant in (("no load", None), ("2 N, clamps 20 % weaker", LOADED)):
        print(f"random sequences, {title}:", sequences(chosen.sequences // 2, plant=plant))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
