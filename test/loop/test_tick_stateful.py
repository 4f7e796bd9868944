# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Actions on an axis in any order: range, slew rate, clamps and modes keep their invariants.

``python test/loop/test_tick_stateful.py COUNT SEED LENGTH`` runs this number of random sequences.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from loop_support import HOLD, parameters

from hysteresis_ros.errors import ParameterError
from hysteresis_ros.loop.axis import Axis, Change
from hysteresis_ros.loop.faults import FAULTS
from hysteresis_ros.loop.watch import FOLLOWING, HOLDING, RUNNING, STALE, STOPPED, TRIPPED
from hysteresis_ros.references import inchworm_layout as gait

#: Short time-outs, so that short sequences reach them.
SHORT = {
    "motion_controller": {"measurement_timeout": 0.003, "safe_slew_rate": 1e-3},
    "hysteresis_compensator": {"command_timeout": 0.004, "safe_slew_rate": 2e4},
    "plant_simulator": {"voltage_timeout": 0.002, "safe_slew_rate": 1.5e4, "late_limit": 9},
}
SLOW_AMPLIFIER = {
    **SHORT,
    "hysteresis_compensator": {**SHORT["hysteresis_compensator"], "limits__slew_rate": 3e4},
    "plant_simulator": {**SHORT["plant_simulator"], "limits__slew_rate": 3e4, "sensor__noise": 5e-9},
}

SETPOINTS = (0.0, 5e-6, 9e-6, 2e-6, -1.0, np.nan, np.inf)
MOTOR_SETPOINTS = (0.0, 2e-5, -3e-6, 5e-4, 1.0, np.nan, -np.inf)
REQUESTS = (gait.STOP_REQUEST, gait.START_REQUEST, gait.HOME_REQUEST)
SPEEDS = (np.nan, 1e-4, -2e-4, 0.0)

RETUNES = (
    ("motion_controller", {"safe_slew_rate": 2e-4}),
    ("motion_controller", {"handover_time": 0.002}),
    ("motion_controller", {"measurement_timeout": 0.0012, "spike_limit": 2e-7, "spike_samples": 2}),
    ("motion_controller", {"measurement_timeout": 0.004, "spike_limit": 0.0, "frozen_samples": 3}),
    ("motion_controller", {"frozen_samples": 0, "safe_command": 1e-6}),
    ("motion_controller", {"safe_command": 0.0, "handover_time": 0.05}),
    ("motion_controller", {"type": "open_loop"}),
    ("motion_controller", {"type": "pid", "pid.Ki": 100.0}),
    ("hysteresis_compensator", {"safe_slew_rate": 4e3, "safe_voltage": 20.0}),
    ("hysteresis_compensator", {"safe_voltage": 0.0, "handover_time": 0.01}),
    ("hysteresis_compensator", {"hysteresis.polynomial.scale": 1.05}),
    ("hysteresis_compensator", {"hysteresis.polynomial.scale": 0.97, "limits.maximum": 90.0}),
    ("hysteresis_compensator", {"limits.maximum": 120.0, "command_timeout": 0.0012}),
    ("plant_simulator", {"safe_slew_rate": 5e3, "late_limit": 3}),
    ("plant_simulator", {"late_limit": -1, "voltage_timeout": 0.001}),
    ("plant_simulator", {"late_limit": 12, "voltage_timeout": 0.004, "hysteresis.polynomial.scale": 1.02}),
)
ACTUATOR_RETUNES = (
    ("motion_controller", {"type": "sliding_mode", "sliding_mode.phi": 0.9}),
    ("motion_controller", {"type": "sliding_mode", "sliding_mode.phi": 0.95}),
)
REFUSED = (
    ("motion_controller", {"safe_slew_rate": -1.0}),
    ("motion_controller", {"type": "sliding_mode", "sliding_mode.phi": 2.0}),
    ("hysteresis_compensator", {"limits.maximum": -40.0}),
    ("plant_simulator", {"safe_voltage": 1e3}),
)


class CheckedAxis:
    """An axis and its last state; :meth:`run` checks every sample.

    Parameters
    ----------
    name : str
        Configuration.
    overrides : dict
        As for :func:`loop_support.parameters`.
    """

    def __init__(self, name="kim2009", overrides=None):
        overrides = dict(SHORT if overrides is None else overrides)
        if name == "kim2009":
            overrides |= HOLD
        self.axis = Axis(parameters(name, **overrides))
        self.motor = self.axis.kind.motor
        self.last, self.follows = None, False
        self.samples = 0
        self.setpoint = 0.0

    def run(self, count, setpoint=None, request=0.0, speed=np.nan, skipped=None):
        """Run ``count`` samples, some of which may be skipped, and check them."""
        self.setpoint = self.setpoint if setpoint is None else setpoint
        asked = {}
        if self.motor:
            asked = {
                "requests": np.r_[request, np.zeros(count - 1)],
                "speeds": np.r_[speed, np.full(count - 1, np.nan)],
            }
        table = self.axis.run(np.full(count, self.setpoint), skipped=skipped, **asked)
        self.samples += count
        self.look_at(table)
        self.last = {name: values[-1] for name, values in table.items()}
        return table

    def look_at(self, table):
        """Refuse forbidden states, for any actions."""
        parts = self.axis.by_node
        plant, compensator = parts["plant_simulator"].parameters, parts["hysteresis_compensator"].parameters
        controller, rate = parts["motion_controller"].parameters, self.axis.sample_rate
        # without a force sensor there is no force
        deaf = set() if parts["plant_simulator"].measures_force else {"force"}
        silent = {"seen", "setpoint", "speed", "slip"} | deaf
        for name, values in table.items():
            if name not in silent:
                assert np.all(np.isfinite(values)), name
        running = table["controller_mode"] == RUNNING
        assert not np.any(np.isnan(table["seen"]) & running)
        within(table["voltage"], compensator.limits)
        within(table["plant_voltage"], plant.limits)
        modes = {name: table[f"{name}_mode"] for name in ("source", "controller", "compensator", "plant")}
        legal(modes["source"], RUNNING, STOPPED, TRIPPED)
        legal(modes["controller"], RUNNING, HOLDING, STALE, STOPPED, TRIPPED, FOLLOWING)
        legal(modes["compensator"], RUNNING, HOLDING, STALE, STOPPED, TRIPPED)
        legal(modes["plant"], RUNNING, HOLDING, STALE, TRIPPED)
        for name, values in modes.items():
            stopped = table["tripped"] != 0.0
            assert np.all(values[stopped] == TRIPPED), name
            assert name == "plant" or not np.any(values[~stopped] == TRIPPED), name
        if self.last is not None:
            table = {name: np.r_[self.last[name], values] for name, values in table.items()}
        safe = (STALE, STOPPED, TRIPPED)
        rise = limit_step(compensator.limits, rate)
        # from a stop by the plant until the controller runs again, the command follows the voltage
        follows = following(table["controller_mode"], self.follows)
        self.follows = bool(follows[-1])
        slewing = {**table, "controller_mode": np.where(follows, -1, table["controller_mode"])}
        moves(slewing, "command", "controller_mode", (*safe, FOLLOWING), controller.safe_slew_rate / rate, 0.0)
        if not self.axis.controller.controller.predicts:
            moves(table, "command", "controller_mode", (HOLDING,), 0.0, 0.0)
        moves(table, "voltage", "compensator_mode", safe, compensator.safe_slew_rate / rate, grid(compensator.limits))
        moves(table, "voltage", "compensator_mode", tuple(range(6)), rise, grid(compensator.limits))
        # an amplifier with its own slew rate may still be moving to the voltage from which the return to safe begins
        slews = limit_step(plant.limits, rate) if plant.limits.slew_rate else plant.safe_slew_rate / rate
        moves(table, "plant_voltage", "plant_mode", (STALE, TRIPPED), slews, grid(plant.limits))
        moves(table, "plant_voltage", "plant_mode", tuple(range(6)), limit_step(plant.limits, rate), grid(plant.limits))
        assert np.all(np.diff(table["late"]) >= 0.0)
        missed = table["skipped"][1:] != 0.0
        assert not np.any(np.diff(table["voltage"])[missed] != 0.0), "a skipped sample put out another voltage"
        assert np.all(np.isnan(table["seen"][1:][missed])), "a skipped sample was measured"
        back = (table["controller_mode"][:-1] >= STALE) & (table["controller_mode"][1:] == RUNNING)
        assert not np.any(np.diff(table["command"])[back] != 0.0), "a jump at the return"
        if self.motor:
            self.look_at_clamps(table, plant)

    def look_at_clamps(self, table, plant):
        """Refuse a motor that opens both clamps or drives one beyond its voltages."""
        given = self.axis.source.parameters.gait
        open_ = np.maximum(table["front_plant_voltage"], table["rear_plant_voltage"]) < given.threshold_voltage
        assert not np.any(open_), "both clamps are open"
        slack = 1e-2
        for name in ("front", "rear"):
            asked, put_out = table[f"{name}_voltage"], table[f"{name}_plant_voltage"]
            assert np.all((asked >= given.release_voltage - slack) & (asked <= given.grip_voltage + slack)), name
            within(put_out, getattr(plant.inchworm, f"{name}_clamp").limits)

    def apply(self, node, action, values=None):
        """Start, stop or retune a part, now."""
        values = values or {}
        self.axis.apply(Change(self.axis.sample, node, action, values))
        if "limits.maximum" in values:
            self.last = None  # a new range applies at once, whatever the slew rate

    def refuse(self, node, values):
        """Send parameters that must be refused and must change nothing."""
        part = self.axis.by_node[node]
        before = part.parameters
        states = [np.copy(array) for array in arrays_of(part.arrays)]
        try:
            self.apply(node, "retune", values)
        except ParameterError:
            assert part.parameters is before
            for array, state in zip(arrays_of(part.arrays), states, strict=True):
                np.testing.assert_array_equal(array, state)
        else:
            raise AssertionError(f"{node} took {values}")

    def reset(self):
        """Reset; faults and trips are cleared, a stop by hand is not."""
        self.axis.reset()
        self.last, self.follows = None, False


def arrays_of(arrays):
    """Return all arrays of nested named tuples."""
    return [array for part in arrays for array in arrays_of(part)] if isinstance(arrays, tuple) else [arrays]


def within(values, limits):
    """Refuse voltages outside the limits."""
    assert np.all((values >= limits.minimum - 1e-9) & (values <= limits.maximum + 1e-9))


def legal(values, *modes):
    """Refuse modes that a part cannot have."""
    assert np.isin(values, modes).all(), set(values)


def grid(limits):
    """Return the contribution of rounding to a difference of voltages [V]."""
    return (limits.maximum - limits.minimum) / (2**limits.bits - 1) if limits.bits else 0.0


def limit_step(limits, rate):
    """Return the largest change that the slew rate allows in a sample [V]."""
    return limits.slew_rate / rate if limits.slew_rate > 0.0 else np.inf


def following(modes, before: bool) -> np.ndarray:
    """Return in which samples the controller has not run since the plant stopped the axis; ``before``: before them."""
    numbers = np.arange(1, len(modes) + 1)
    tripped, ran = (np.maximum.accumulate(np.where(modes == mode, numbers, 0)) for mode in (TRIPPED, RUNNING))
    return (tripped > ran) | (before & (ran == 0))


def moves(table, signal, mode, modes, step, rounding):
    """Refuse a signal that changes by more than a step in samples with these modes."""
    there = np.isin(table[mode][1:], modes)
    moved = np.abs(np.diff(table[signal]))[there]
    # and the rounding of the signal itself
    slack = 1e-9 * step + rounding + 4e-16 * np.max(np.abs(table[signal]), initial=0.0)
    assert np.all(moved <= step + slack), (signal, float(np.max(moved)), step)


def fault_text(random, motor, rate):
    """Return a random fault that is possible for an axis."""
    name = random.choice([name for name, kind in FAULTS.items() if motor or not kind.motor])
    return text_of(name, random.integers(0, 20), random.integers(1, 60), random.random(), rate)


def text_of(name, first, count, part, rate):
    """Return a fault as text; ``part`` (0 … 1) selects its value within the range."""
    text = f"{name}:{first / rate:.9f}:{count / rate:.9f}"
    kind = FAULTS[name]
    if kind.value is None:
        return text
    if name == "late":
        return f"{text}:{1 + int(part * 20)}"
    low, high = (kind.low, kind.high) if np.isfinite(kind.high) else (-5e-6, 5e-6)
    return f"{text}:{low + part * (high - low):.12g}"


def random_sequence(checked, random, length=8):
    """Execute ``length`` actions on an axis, each followed by some samples."""
    axis, motor = checked.axis, checked.motor
    retunes = RETUNES + (() if motor else ACTUATOR_RETUNES)
    startable = ["motion_controller", "hysteresis_compensator"] + ([] if motor else ["reference_generator"])
    for _ in range(length):
        what = random.integers(0, 9)
        if what <= 1:
            number = random.integers(1, 4)
            axis.inject(tuple(fault_text(random, motor, axis.sample_rate) for _ in range(number)))
        elif what == 2:
            node, values = retunes[random.integers(len(retunes))]
            checked.apply(node, "retune", values)
        elif what == 3:
            checked.apply(random.choice(startable), "stop")
        elif what in (4, 5):
            checked.apply(random.choice(startable), "start")
        elif what == 6:
            checked.apply("plant_simulator", "start")
        elif what == 7 and random.random() < 0.2:
            checked.reset()
        elif what == 8 and random.random() < 0.3:
            checked.apply("plant_simulator", "halt")
        setpoints = MOTOR_SETPOINTS if motor else SETPOINTS
        setpoint = setpoints[random.integers(len(setpoints))] if random.random() < 0.5 else None
        request = float(random.choice(REQUESTS)) if random.random() < 0.2 else 0.0
        speed = float(SPEEDS[random.integers(len(SPEEDS))])
        count = int(random.integers(1, 60))
        skipped = random.random(count) < random.choice((0.0, 0.0, 0.1, 1.0))
        checked.run(count, setpoint, request, speed, skipped)


#: Kinds of axes for the sequences.
KINDS = (("kim2009", SHORT), ("kim2009", SLOW_AMPLIFIER), ("inchworm_travel", SHORT))


def sequences(count, seed=1, length=8, renewed=200):
    """Execute random sequences, with a new axis after every ``renewed`` ones; return the number of checked samples."""
    samples = 0
    random = np.random.default_rng(seed)
    for first in range(0, count, renewed):
        checked = CheckedAxis(*KINDS[first // renewed % len(KINDS)])
        for number in range(first, min(first + renewed, count)):
            state = random.bit_generator.state["state"]
            try:
                random_sequence(checked, random, length)
            except AssertionError as error:
                raise AssertionError(f"sequence {number} of seed {seed}, generator {state}: {error}") from error
            if number % 5 == 4:
                checked.axis.inject(())
                for node in ("motion_controller", "hysteresis_compensator", "plant_simulator"):
                    checked.apply(node, "start")
                checked.reset()
        samples += checked.samples
    return samples


STOPPABLE = ["motion_controller", "hysteresis_compensator", "reference_generator"]

fault = st.tuples(
    st.sampled_from(sorted(FAULTS)), st.integers(0, 20), st.integers(1, 60), st.floats(0.0, 1.0, exclude_max=True)
)


class Tick(RuleBasedStateMachine):
    """An axis under any actions of users, partners and sensors."""

    @initialize(kind=st.sampled_from(KINDS))
    def begin(self, kind):
        """An axis at rest."""
        self.checked = CheckedAxis(*kind)
        self.motor = self.checked.motor

    @rule(count=st.integers(1, 60), setpoint=st.integers(0, len(SETPOINTS) - 1))
    def run(self, count, setpoint):
        """Some samples with a possibly invalid setpoint."""
        self.checked.run(count, (MOTOR_SETPOINTS if self.motor else SETPOINTS)[setpoint])

    @rule(count=st.integers(1, 60), request=st.sampled_from(REQUESTS), speed=st.sampled_from(SPEEDS))
    def ask(self, count, request, speed):
        """A request to the sequencer of a motor; no effect on an actuator."""
        self.checked.run(count, None, request, speed)

    @rule(faults=st.lists(fault, min_size=1, max_size=3))
    def fail(self, faults):
        """Faults from now on, and some samples with these faults."""
        rate = self.checked.axis.sample_rate
        texts = [text_of(*given, rate) for given in faults if self.motor or not FAULTS[given[0]].motor]
        self.checked.axis.inject(tuple(texts))
        self.checked.run(30)

    @rule(skipped=st.lists(st.booleans(), min_size=1, max_size=30))
    def miss(self, skipped):
        """Missed samples."""
        self.checked.run(len(skipped), skipped=skipped)

    @rule()
    def halt(self):
        """An emergency stop."""
        self.checked.apply("plant_simulator", "halt")
        self.checked.run(9)

    @rule(node=st.sampled_from(STOPPABLE))
    def stop(self, node):
        """Stop a part; a sequencer is stopped by its request."""
        if node in self.checked.axis.by_node:
            self.checked.apply(node, "stop")
            self.checked.run(9)

    @rule(
        node=st.sampled_from(["motion_controller", "hysteresis_compensator", "reference_generator", "plant_simulator"])
    )
    def start(self, node):
        """Start a part that may not have been stopped."""
        if node in self.checked.axis.by_node:
            self.checked.apply(node, "start")
            self.checked.run(9)

    @rule(number=st.integers(0, len(RETUNES + ACTUATOR_RETUNES) - 1))
    def retune(self, number):
        """New parameters of the running axis."""
        if number < len(RETUNES) or not self.motor:
            self.checked.apply(*with_action((RETUNES + ACTUATOR_RETUNES)[number]))
            self.checked.run(9)

    @rule(number=st.integers(0, len(REFUSED) - 1))
    def retune_wrongly(self, number):
        """Invalid new parameters change nothing."""
        self.checked.refuse(*REFUSED[number])

    @rule()
    def reset(self):
        """Reset to the initial state."""
        self.checked.reset()

    @invariant()
    def parts_know_what_they_do(self):
        """The reported state of a part agrees with its arrays."""
        plant = self.checked.axis.plant
        assert plant.late >= 0 and np.isfinite([plant.held(number) for number in range(3)]).all()


def with_action(retune):
    """Return the arguments of :meth:`CheckedAxis.apply` for a retune."""
    node, values = retune
    return node, "retune", values


TestTick = Tick.TestCase
TestTick.settings = settings(max_examples=60, stateful_step_count=15, deadline=None)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_random_sequences_keep_every_invariant(seed):
    assert sequences(150, seed, renewed=50) > 20000


if __name__ == "__main__":
    began = time.monotonic()
    asked = [int(word) for word in sys.argv[1:]]
    looked_at = sequences(*asked)
    print(f"sequences, seed, length {asked}: {looked_at} samples in {time.monotonic() - began:.0f} s")
