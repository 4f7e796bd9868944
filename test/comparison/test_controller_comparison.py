# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The tables that rank controllers: their contents, in the documentation, in the page and in the file of the best."""

from __future__ import annotations

import json
import os
import pathlib
import re
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from waiting import until

from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration, parse_configuration
from hysteresis_ros.errors import ConfigurationError, ParameterError
from hysteresis_ros.laboratory.comparison import table
from hysteresis_ros.laboratory.comparison.candidates import candidates, known, names
from hysteresis_ros.laboratory.comparison.compare import Comparison, Tried, compare, table_of_others, trial_around
from hysteresis_ros.laboratory.comparison.rows import Row
from hysteresis_ros.laboratory.comparison.table import ranking_figure
from hysteresis_ros.laboratory.comparison.tasks import Conditions, make_tasks
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate

FED, ALONE, OPEN = ("PID + feedforward", "exact inverse with creep"), ("PID", "none"), ("open loop", "none")
INTEGRAL = "integral + static feedforward", "none"
DOCUMENT = pathlib.Path(__file__).resolve().parents[2] / "docs" / "comparison.md"


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    conditions = Conditions(draws=3, others=0)
    return compare(load_configuration("picma_stage"), conditions, only={FED, ALONE, OPEN, INTEGRAL}, workers=1)


def test_rows_are_ranked_by_their_worst_plants_and_compared_with_a_tuned_pi(comparison):
    around = comparison.around
    assert [row.name for row in around.rows] == [FED, ALONE, INTEGRAL, OPEN]
    scores = [row.score for row in around.rows]
    assert scores == sorted(scores)
    best, measure = around.rows[0], around.yardstick
    for task in around.tasks:
        assert best.better[task] == pytest.approx(measure.results[task].worst / best.results[task].worst)
        assert best.better[task] > 1.0 > around.row(*OPEN).better[task]
    # tuned on the plant by the score, it is better than an integrator that was not tuned this way
    assert best.score < measure.score < around.row(*INTEGRAL).score


def test_a_delay_is_taken_off_that_the_table_states(comparison):
    row = comparison.around.row(*FED)
    # the inverse of the dynamics has one sample of preview, 5 ms
    assert row.delays[0] == pytest.approx(5e-3, abs=5e-4)
    for task, result in row.results.items():
        assert np.all(result.undelayed > 2.0 * result.rms), task
    sine = next(name for name in row.results if "sine" in name)
    expected = 0.9 * np.sqrt(0.5) * np.sin(np.pi * row.delays[0])
    assert row.results[sine].undelayed[0] == pytest.approx(expected, rel=0.05)


def test_medians_are_called_medians(comparison):
    headings = [
        heading for name, columns in table.blocks(comparison.around) if "sine" in name for heading, _ in columns
    ]
    assert headings[:2] == ["median RMS", "worst RMS"]
    changed = replace(comparison.around.row(*FED).results[comparison.around.tasks[0]], rms=np.array([1e-3, 2e-3, 9e-3]))
    row = replace(comparison.around.row(*FED), results={name: changed for name in comparison.around.tasks})
    assert table.cells(comparison.around.tasks, "1", row)[4:6] == ["0.2", "0.9"]


def test_equal_seeds_give_equal_rows(comparison):
    trial = trial_around(load_configuration("picma_stage"), Conditions(draws=3, others=0))
    (again,) = trial.rows({INTEGRAL})
    for name, result in again.results.items():
        assert np.array_equal(result.rms, comparison.around.row(*INTEGRAL).results[name].rms)


def test_a_row_that_misses_margins_or_is_unstable_has_no_rank(comparison):
    row = comparison.around.row(*FED)
    assert row.ranked and not row.marked and row.candidate.margins.meets
    lost = {name: replace(result, unstable=1) for name, result in row.results.items()}
    changed = [replace(row, marked="M_s 2.5 above 2"), replace(row, results=lost), replace(row, refused="no model")]
    rows = sorted([*changed, *comparison.around.rows], key=lambda one: one.order)
    assert [one.ranked for one in rows] == [True] * 4 + [False] * 3
    found = replace(comparison.around, rows=tuple(rows))
    assert table.ranks(found)[-3:] == ["marked", "unstable", "–"] or table.ranks(found)[-3:] == [
        "unstable",
        "marked",
        "–",
    ]
    text = table.format_table(found)
    assert "M_s 2.5 above 2" in text and "on 1 plants, not marked beforehand" in text and "no model" in text


def test_rows_on_plants_of_other_classes_are_joined_by_their_worst(comparison):
    row, other = comparison.around.row(*FED), comparison.around.row(*ALONE)
    measure = comparison.around.yardstick
    plain = replace(other, controller=FED[0], compensator="exact inverse")
    tried = [
        Tried(2, "duhem", 2e-5, [plain, replace(other, marked="M_s 3")], measure),
        Tried(1, "play", 1e-5, [row, other], measure),
    ]
    found = table_of_others(Conditions(), tried)
    joined = found.row(*FED)
    for task in found.tasks:
        # if the second model has no creep, the row with creep equals the one without
        assert joined.results[task].worst == max(row.results[task].worst, plain.results[task].worst)
        assert joined.better[task] == min(row.better[task], plain.better[task])
    assert len(joined.delays) == 2 and joined.ranked
    marked = found.row(*ALONE)
    assert marked.marked == "plant 2: M_s 3" and not marked.ranked
    with pytest.raises(ConfigurationError, match="no row"):
        found.row(FED[0], "none")


def test_the_best_has_a_rank_in_both_tables(comparison, tmp_path):
    assert comparison.best.name == FED
    lost = {name: replace(result, unstable=1) for name, result in comparison.around.row(*FED).results.items()}
    others = replace(comparison.around, rows=(Row(*FED, results=lost), comparison.around.row(*ALONE)))
    assert replace(comparison, others=others).best.name == ALONE
    with pytest.raises(ConfigurationError, match="no combination has a rank"):
        _ = replace(comparison, around=replace(comparison.around, rows=())).best


def test_the_file_of_the_best_is_an_axis_with_it(comparison):
    text = table.best_text(comparison)
    axis = single_axis(parse_configuration(text, "best.yaml"))
    assert axis.plant_simulator.limits.slew_rate > 0.0 and axis.hysteresis_compensator.limits.slew_rate > 0.0
    assert not axis.reference_generator.approach.unlimited
    assert axis.motion_controller.type == "pid" and axis.motion_controller.feedforward.preview == 1
    assert axis.hysteresis_compensator.creep.type == "logarithmic"
    assert axis.plant_simulator.hysteresis == single_axis(comparison.configuration).plant_simulator.hysteresis
    run = simulate(axis, duration=5.0)
    settled = (run.time > 2.0) & (run.time < 2.2)
    assert np.abs(run["reference"] - run["displacement"])[settled] == pytest.approx(0.0, abs=5e-8)
    assert FED[0] in text.splitlines()[0]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (dict(mismatch=0.9), "mismatch = 0.9.*0 … 0.5"),
        (dict(draws=-1), "draws = -1.*0 … 10000"),
        (dict(others=-1), "others = -1.*0 … 1000"),
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
    first = found["tables"][0]["rows"][0]
    assert (first["controller"], first["compensator"]) == FED and first["rank"] == 1
    worst = first["results"][comparison.around.tasks[0]]["rms_worst_percent"]
    assert f"{worst:.3g}" in next(line for line in text.splitlines() if FED[0] in line)
    assert found["tables"][0]["rows"][-1]["controller"] == comparison.around.yardstick.controller


def test_the_page_holds_the_table_and_its_plots(comparison, tmp_path):
    pytest.importorskip("matplotlib")
    table.write_comparison_page(comparison, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert page.count("<img") == 3 and FED[0] in page


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


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["inchworm_travel", "--draws", "1"], "describes an inchworm motor"),
        (["picma_stage", "--mismatch", "2"], "mismatch = 2"),
        (["picma_stage", "--best"], "--best and -o FILE.yaml belong together"),
        (["picma_stage", "-o", "best.yaml"], "best.yaml: --best and -o FILE.yaml belong together"),
        (["picma_stage", "--workers", "0"], "workers"),
    ],
)
def test_the_command_names_what_is_wrong(words, named):
    answer = CliRunner().invoke(main, ["compare", *words])
    assert answer.exit_code == 2 and named in answer.output and "Traceback" not in answer.output


def test_an_interrupt_ends_the_command_and_all_who_work_for_it():
    """The command prints one line, and no worker remains that could print another."""
    words = ["compare", "picma_stage", "--draws", "1", "--others", "2", "--workers", "2"]
    process = subprocess.Popen(
        [sys.executable, "-m", "hysteresis_ros.cli.entry", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=dict(
            os.environ,
            PYTHONPATH=os.pathsep.join(filter(None, [str(DOCUMENT.parents[1]), os.environ.get("PYTHONPATH")])),
        ),
        process_group=0,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    workers = until(lambda: len(found := workers_of(process)) == 2 and found, what="both workers")
    assert all(is_deaf(worker) for worker in workers)
    # a worker whose parent ends while it reads what to import reports this itself
    until(lambda: all("_multiarray_umath" in (worker / "maps").read_text() for worker in workers), what="their imports")
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to all of them
    output, errors = process.communicate(timeout=120)
    assert (process.returncode, output, errors) == (130, "", "hysteresis: interrupted\n")


def workers_of(process: subprocess.Popen) -> list[pathlib.Path]:
    """Return the folders in /proc of the workers of a command."""
    tasks = pathlib.Path(f"/proc/{process.pid}/task")
    children = [child for path in tasks.glob("*/children") for child in path.read_text().split()]
    places = [pathlib.Path("/proc", child) for child in children]
    return [place for place in places if "spawn_main" in (place / "cmdline").read_text()]


def is_deaf(place: pathlib.Path) -> bool:
    """Return whether a process blocks or ignores interrupts."""
    masks = re.findall(r"^Sig(?:Blk|Ign):\s*(\w+)$", (place / "status").read_text(), re.MULTILINE)
    return any(int(mask, 16) & 1 << (signal.SIGINT - 1) for mask in masks)


def printed_rows(title: str) -> dict[tuple[str, str], list[str]]:
    """Return the cells after the names in the rows of a table in the documentation."""
    text = DOCUMENT.read_text(encoding="utf-8")
    lines = text[text.index(f"\n{title}\n") + 1 :].splitlines()
    heading = next(line for line in lines if "controller" in line)
    first, second = heading.index("controller"), heading.index("compensator")
    found = {}
    for line in lines[lines.index(heading) + 2 :]:
        if not line.strip():
            return found
        numbers = re.split(r"\s{2,}", line[second:].strip())
        found[line[first:second].strip(), numbers[0]] = numbers[1:]
    raise AssertionError("the table has no end")


def test_the_documented_table_is_what_a_run_prints():
    """Some of its rows, with the seeds of the full run."""
    printed = printed_rows("Plants close to the configured plant")
    assert len(printed) > 30
    trial = trial_around(load_configuration("picma_stage"), Conditions())
    tasks = tuple(task.name for task in trial.tasks)
    for row in trial.rows({FED, INTEGRAL, OPEN}):
        now, shown = table.cells(tasks, "", row)[3:], printed[row.name]
        assert len(now) == len(shown)
        # the yardstick, of which columns 5 and 10 are multiples, is not tuned here
        for place in set(range(len(now))) - {5, 10}:
            assert float(now[place]) == pytest.approx(float(shown[place]), rel=0.02, abs=1e-3), (row.name, place)


def test_an_axis_with_a_resonance_has_a_row_with_damping_and_one_without_has_none():
    bare = load_configuration("stage700").override("motion_controller", damping__type="none", type="open_loop")
    given = known(bare, 16)
    row = ("PID + damping", "exact inverse")
    force = ("PID + force feedback", "exact inverse")
    assert {row, force} <= set(names(given.axis))
    deaf = bare.override("motion_controller", model__force__stack_stiffness=0.0)
    assert force not in names(known(deaf, 16).axis) and row in names(known(deaf, 16).axis)
    assert row[0] not in {name for name, _ in names(known(load_configuration("picma_stage"), 16).axis)}
    conditions = Conditions()
    found, forced = candidates(given, conditions, make_tasks(conditions, (0.0, 2e-5)), {row, force})
    assert not found.refused and not found.marked and not forced.refused
    assert forced.motion_controller["damping.type"] == "iff" and forced.margins.bandwidth > 250.0
    assert found.motion_controller["damping.type"] == "irc" and found.margins.bandwidth > 300.0
    node = given.designed(found).motion_controller
    assert node.damping.type == "irc" and node.type == "pid"


@pytest.mark.parametrize(("through", "form"), [(0.0, "current"), (0.1, "predictor")])
def test_a_model_with_feedthrough_gets_a_filter_that_allows_it(through, form):
    dynamics = {"model.dynamics.C": [1.0 - through], "model.dynamics.D": [through]}
    configuration = load_configuration("picma_stage").override("motion_controller", **dynamics)
    trial = trial_around(configuration, Conditions(draws=1, others=0))
    (candidate,) = candidates(trial.given, trial.conditions, trial.tasks, {("offset-free", "none")})
    assert not candidate.refused and candidate.motion_controller["kalman.form"] == form
