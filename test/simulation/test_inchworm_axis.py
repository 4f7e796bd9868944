# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The inchworm axis offline: bits, figures of merit of short moves, the clamps' invariant, and refusals."""

from __future__ import annotations

import numpy as np
import pytest

from hysteresis_ros.configuration import load_configuration, parse_configuration
from hysteresis_ros.control.law import APPLIED, COMMAND, FEEDFORWARD
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.laboratory.papers.kim2009.inchworm import (
    LOADED,
    honest_moves,
    inchworm,
    move,
    sequences,
    speed,
    step_errors,
)
from hysteresis_ros.loop.inchworm_checks import design_warnings, inchworm_warnings
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.references import inchworm_layout as at

#: Without machine code a simulated second takes a minute.
slow = pytest.mark.skipif(not COMPILED, reason="takes minutes without Numba")


def test_a_run_repeats_bit_for_bit_after_reset_and_may_be_cut_in_pieces():
    axis = inchworm()
    setpoints = 2e-5 * (np.arange(900) > 200)
    whole = axis.run(setpoints)
    axis.reset()
    pieces = [axis.run(part) for part in np.split(setpoints, [1, 250, 777])]
    for name, values in whole.items():
        np.testing.assert_array_equal(np.concatenate([piece[name] for piece in pieces]), values, err_msg=name)


def test_blocks_called_one_by_one_as_nodes_do_give_the_same_bits():
    setpoint = 2e-5
    table = inchworm().run(np.full(700, setpoint))
    axis = inchworm()
    motor, sequencer, part = axis.plant.motor, axis.source.sequencer, axis.controller
    controller, compensator = part.controller, axis.compensator.compensator
    for k in range(700):
        slider, extender = motor.measure()[:2]
        reference = sequencer.step(setpoint, slider, extender)
        origin = sequencer.origin
        delayed = part.feedforward.step(reference)
        controller.x[FEEDFORWARD] = part.feedforward.command
        command = part.handover.step(controller.step(delayed, slider - origin))
        voltage = compensator.step(command)
        controller.x[COMMAND] = command
        controller.x[APPLIED] = compensator.applied
        front, rear = sequencer.front_voltage, sequencer.rear_voltage
        names = ("measured", "reference", "origin", "command", "voltage", "front_voltage", "rear_voltage")
        assert (slider, reference, origin, command, voltage, front, rear) == tuple(table[name][k] for name in names), k
        motor.advance(voltage, front, rear)


@slow
@pytest.mark.parametrize(("plant", "allowed"), [(None, 5e-9), (LOADED, 10e-9)])
def test_moves_there_and_back_end_within_nanometres_and_without_overshoot_beyond_a_step(plant, allowed):
    axis = inchworm(plant=plant)
    stroke = axis.source.sequencer.parameters.gait.stroke
    moves = [move(axis, setpoint, hold=0.1) for setpoint in (1e-4, -1e-4, -0.5e-4, 1e-6, 6.5e-6)]
    assert all(one.arrived for one in moves)
    assert max(one.error for one in moves) < allowed
    assert max(one.overshoot for one in moves) < stroke
    if plant is None:
        assert moves[1].steps == pytest.approx(2e-4 / stroke, abs=2)
    else:
        # the load bends the extender by 4.9 um, for which the steps leave room
        assert axis.source.sequencer.learned["load_deflection"] < -3e-6
        assert 2e-4 / stroke < moves[1].steps < 3 * 2e-4 / stroke


@slow
def test_walking_is_as_fast_as_stroke_times_frequency():
    axis = inchworm()
    assert speed(axis, 6000) == pytest.approx(axis.source.sequencer.parameters.gait.speed, rel=0.05)


@pytest.mark.slow
@slow
@pytest.mark.parametrize("learning", [True, False])
def test_compensated_hysteresis_spreads_step_lengths_at_least_five_times_less(learning):
    spread = {kind: np.std(step_errors(kind, 60, learning=learning)) for kind in ("none", "exact")}
    assert spread["exact"] < 0.2 * spread["none"]


@pytest.mark.slow
@slow
@pytest.mark.parametrize("plant", [None, LOADED])
def test_no_random_sequence_opens_both_clamps_breaks_limits_or_runs_away(plant):
    found = sequences(150, seconds=0.3, plant=plant)
    assert found.both_open == found.beyond_limits == found.unsafe_stops == found.errors == 0
    # at any time one clamp has at least four fifths of the normal force of a closed clamp
    assert found.least_force > 15.0
    assert found.farthest < inchworm().source.sequencer.parameters.gait.stroke * 2.0


@slow
def test_a_slider_that_cannot_move_stops_the_motor_with_an_error():
    axis = inchworm(
        plant={"inchworm__front_clamp__static_friction": 1e-6, "inchworm__front_clamp__kinetic_friction": 1e-6}
    )
    table = axis.run(np.full(5000, 1e-4))
    assert axis.source.sequencer.error == "no_motion" and table["total_steps"][-1] == 5.0
    assert table["phase"][-1] == at.HOLDING and table["front_voltage"][-1] == table["rear_voltage"][-1] == 100.0


def test_the_schedule_of_the_configuration_is_the_default_run():
    configuration = load_configuration("inchworm_travel").override(
        "inchworm_sequencer", setpoints__times=[0.01], setpoints__values=[1e-5], setpoints__duration=0.05
    )
    run = simulate(single_axis(configuration))
    assert run.time.size == 500 and run.units["front_force"] == "N" and run.units["origin"] == "m"
    np.testing.assert_array_equal(run["setpoint"], np.where(np.arange(500) < 100, 0.0, 1e-5))
    again = simulate(single_axis(parse_configuration(run.metadata["configuration"], "text")))
    np.testing.assert_array_equal(again["displacement"], run["displacement"])


@pytest.mark.parametrize(
    ("node", "values", "name", "said"),
    [
        ("plant_simulator", {"inchworm__slider__external_force": 9.0}, "front_clamp", "cannot hold the load of 9 N"),
        ("plant_simulator", {"type": "actuator"}, "plant_simulator: type", "needs a section inchworm_sequencer"),
        ("motion_controller", {"use_origin": False}, "use_origin", "must be true"),
        ("inchworm_sequencer", {"gait__clamp_settling": 5e-4}, "gait.clamp_settling", "must be ≥ 0.000782 s"),
        ("inchworm_sequencer", {"gait__grip_voltage": 130.0}, "gait.grip_voltage", "0 … 120 V"),
        (
            "inchworm_sequencer",
            {"gait__highest_extension": 12e-6},
            "gait.highest_extension",
            "beyond the range of the compensator",
        ),
        ("inchworm_sequencer", {"maximum": 2e-2}, "inchworm_sequencer: maximum", "-0.01 … 0.01 m"),
        ("inchworm_sequencer", {"gait__walking_speed": 1e-3}, "gait.walking_speed", "reaches 0.000307692 m/s"),
    ],
)
def test_what_does_not_fit_together_is_refused_by_name_with_the_number(node, values, name, said):
    with pytest.raises(ParameterError) as error:
        single_axis(load_configuration("inchworm_travel").override(node, **values))
    assert any(name in problem.name and said in problem.remedy for problem in error.value.problems), str(error.value)


def test_clamps_that_hold_with_little_reserve_are_doubted():
    configuration = load_configuration("inchworm_travel")
    fine = single_axis(configuration)
    assert inchworm_warnings(fine.plant_simulator, fine.inchworm_sequencer) == ()
    near = single_axis(configuration.override("plant_simulator", inchworm__slider__external_force=5.0))
    first, *_ = inchworm_warnings(near.plant_simulator, near.inchworm_sequencer)
    assert "front_clamp holds 7.5 N at 100 V, 1.5 times the load of 5 N" in first


@slow
@pytest.mark.parametrize(("force", "setpoint"), [(2.0, 2e-4), (-2.0, 2e-4), (2.0, 1.7e-5)])
def test_short_moves_under_a_load_that_nobody_knows_stay_within_a_shortened_step(force, setpoint):
    axis = inchworm(plant={"inchworm__slider__external_force": force})
    axis.run(np.zeros(1000))
    table = axis.run(np.full(32000, setpoint))
    whole = np.abs(table["step_achieved"][table["total_steps"] > 0])
    assert table["arrived"][-1] == 1.0
    assert np.max(table["displacement"]) - setpoint < 0.5 * np.max(whole) < 5e-6
    assert axis.source.sequencer.learned["load_deflection"] == pytest.approx(force / 0.41e6, rel=0.2)


@slow
def test_extenders_off_by_five_percent_that_creep_end_within_nanometres():
    for plant, allowed in ((None, 5e-9), (LOADED, 10e-9)):
        moves = honest_moves(1, plant, (1e-4, 0.0))
        assert all(one.arrived for one in moves) and max(one.error for one in moves) < allowed


def test_doubts_name_their_numbers():
    plant = single_axis(
        load_configuration("inchworm_travel").override("plant_simulator", inchworm__slider__external_force=-5.0)
    )
    hasty = single_axis(load_configuration("inchworm_travel").override("inchworm_sequencer", gait__extend=2e-3))
    text = " ".join(inchworm_warnings(plant.plant_simulator, plant.inchworm_sequencer))
    assert "1.5 times the load of 5 N" in text and "lower the load to 2.62 N" in text
    (sentence,) = inchworm_warnings(hasty.plant_simulator, hasty.inchworm_sequencer)
    assert "gait.extend = 0.002 s" in sentence and "455.8 Hz" in sentence
    assert design_warnings(hasty.plant_simulator, [100.0]) == ()
    assert "517 Hz" in design_warnings(hasty.plant_simulator, [50.0, 517.0])[0]
    # a quarter of 455.8 Hz
    assert design_warnings(hasty.plant_simulator, [113.0]) == () != design_warnings(hasty.plant_simulator, [115.0])
