"""The table that ranks controllers: what it promises for the measured piezo stage, and that it judges honestly."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from hysteresis_ros.analysis.ranking import ranking_figure
from hysteresis_ros.analysis.settings import delayed
from hysteresis_ros.cli.main import main
from hysteresis_ros.comparison import table
from hysteresis_ros.comparison.compare import (
    Conditions,
    compare,
    honest,
    judge,
    make_tasks,
    reachable,
)
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.simulation.axes import single_axis
from hysteresis_ros.simulation.run import simulate

BEST = "drift-free + feedforward", "exact inverse with creep"
ALONE = "PID", "none"
OPEN = "open loop", "none"


@pytest.fixture(scope="module")
def comparison():
    return compare(load_configuration("picma_stage"), Conditions(draws=4), only={BEST, ALONE, OPEN})


def test_the_measured_stage_is_followed_as_promised(comparison):
    best, alone = comparison.row(*BEST), comparison.row(*ALONE)
    sine, triangle = (task.name for task in comparison.tasks)
    assert comparison.percent(np.max(best.results[sine].rms)) <= 0.05
    assert comparison.percent(np.max(best.results[triangle].rms)) <= 0.3
    assert np.all(10.0 * best.results[triangle].rms < alone.results[triangle].rms)


def test_rows_are_ranked_by_their_worst_plants(comparison):
    scores = [row.score for row in comparison.rows]
    assert scores == sorted(scores)
    assert [(row.candidate.controller, row.candidate.compensator) for row in comparison.rows] == [BEST, ALONE, OPEN]


def test_equal_seeds_give_equal_rows(comparison):
    again = compare(load_configuration("picma_stage"), Conditions(draws=4), only={BEST})
    for name, result in again.rows[0].results.items():
        assert np.array_equal(result.rms, comparison.row(*BEST).results[name].rms)


def test_every_plant_reaches_the_stroke_within_its_limits():
    configuration, conditions = load_configuration("picma_stage"), Conditions(draws=3)
    plants = honest(configuration, conditions)
    low, high = reachable(configuration, plants)
    widest = make_tasks(conditions, (low, high))[0]
    for plant in plants:
        open_loop = plant.override("motion_controller", type="open_loop")
        # a perfect model of this very plant in the compensator: what it cannot do no controller can
        known = {
            name.removeprefix("hysteresis."): value
            for name, value in plant.node("plant_simulator").items()
            if name.startswith("hysteresis.prandtl")
        }
        exact = open_loop.override(
            "hysteresis_compensator", **{f"hysteresis.{name}": value for name, value in known.items()}
        )
        run = simulate(single_axis(exact.override("reference_generator", **widest.overrides())), duration=2.0)
        assert np.mean(run["saturated"][200:]) < 0.1


def test_the_error_is_the_true_one_against_the_delayed_reference():
    configuration = load_configuration("picma_stage")
    task = make_tasks(Conditions(), (10e-6, 40e-6))[0]
    values = {"type": "open_loop", "feedforward.type": "inverse_dynamics", "feedforward.preview": 3}
    moved = configuration.override("motion_controller", **values).override("reference_generator", **task.overrides())
    axis = single_axis(moved.override("plant_simulator", sensor__noise=1e-6))
    run = simulate(axis, duration=task.duration)
    rms = judge(run, axis, task).rms
    judged = run.time >= task.settling - 1e-4
    wanted = np.concatenate([np.full(3, run["reference"][0]), run["reference"][:-3]])
    assert rms == pytest.approx(np.sqrt(np.mean((wanted - run["displacement"])[judged] ** 2)))
    # a perfect model and no feedback: noise of 1 µm in the measurement is not in the error
    assert rms < 1e-9
    assert np.array_equal(delayed(wanted, 0), wanted)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (dict(mismatch=0.9), "mismatch = 0.9.*0 … 0.5"),
        (dict(draws=0), "draws = 0.*1 … 10000"),
        (dict(sine_frequency=0.0), "sine = 0.*above 0"),
        (dict(bits=40), "bits = 40.*0 … 32"),
    ],
)
def test_conditions_without_sense_are_named(given, words):
    with pytest.raises(ParameterError, match=words):
        Conditions(**given)


def test_a_reference_too_fast_for_the_samples_is_named():
    with pytest.raises(ParameterError, match="triangle = 50.*tenth of the sample rate"):
        compare(load_configuration("picma_stage"), Conditions(triangle_frequency=50.0))


def test_table_and_json_tell_the_same(comparison):
    text = table.format_comparison(comparison)
    found = table.to_json(comparison)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    first = found["rows"][0]
    assert (first["controller"], first["compensator"]) == BEST
    worst = first["results"][comparison.tasks[0].name]["rms_worst_percent"]
    assert f"{worst:.3g}" in next(line for line in text.splitlines() if BEST[0] in line)


def test_the_page_holds_the_table_and_its_plots(comparison, tmp_path):
    pytest.importorskip("matplotlib")
    table.write_page(comparison, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert page.count("<img") == 3 and BEST[0] in page


@pytest.mark.parametrize("most", [3.0, 40.0, 3000.0])
def test_labels_of_the_error_scale_do_not_overlap(most):
    pytest.importorskip("matplotlib")
    errors = [np.array([2.5, 2.6]), np.array([0.9 * most, most])]
    figure = ranking_figure(["one", "other"], {"sine": errors, "triangle": errors})
    figure.canvas.draw()
    for axis in figure.axes:
        ticks = axis.xaxis.get_ticklabels(which="both")
        boxes = [tick.get_window_extent() for tick in ticks if tick.get_text()]
        inside = sorted((box.x0, box.x1) for box in boxes if axis.bbox.x0 <= 0.5 * (box.x0 + box.x1) <= axis.bbox.x1)
        assert all(one[1] < other[0] for one, other in zip(inside, inside[1:], strict=False))


def test_unlimited_converters_are_called_so():
    found = compare(load_configuration("picma_stage"), Conditions(draws=1, bits=0), only={OPEN})
    assert "converters without steps" in table.format_comparison(found)


def test_the_command_names_what_is_wrong():
    answer = CliRunner().invoke(main, ["compare", "inchworm_travel", "--draws", "1"])
    assert answer.exit_code == 2 and "sequencer" in answer.output and "Traceback" not in answer.output
    answer = CliRunner().invoke(main, ["compare", "picma_stage", "--mismatch", "2"])
    assert answer.exit_code == 2 and "mismatch = 2" in answer.output and "Traceback" not in answer.output
