# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Actions on an axis in any order: range, slew rate, clamps and modes keep their invariants."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from tick_support import (
    ACTUATOR_RETUNES,
    KINDS,
    MOTOR_SETPOINTS,
    REFUSED,
    REQUESTS,
    RETUNES,
    SETPOINTS,
    SPEEDS,
    CheckedAxis,
    sequences,
    text_of,
)

from hysteresis_ros.loop.faults import FAULTS

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
