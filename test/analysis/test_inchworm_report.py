# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Report of an inchworm's run: figures compared with values calculated by hand, and the page."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import hysteresis_ros as hr
from hysteresis_ros.analysis.inchworm import REQUIRED, format_inchworm, inchworm_figures, inchworm_run, is_inchworm
from hysteresis_ros.analysis.side_by_side import laid_over, summary
from hysteresis_ros.cli.recording import report
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import RecordingError
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.recordings import Recording
from hysteresis_ros.recordings.files import save_run
from hysteresis_ros.references import inchworm_layout as at

CYCLE = 20  # samples of a step
RATE = 1000.0
#: 8 µm in 20 ms: 400 µm/s without slip.
CONFIGURATION = """
/**/inchworm_sequencer:
  ros__parameters:
    minimum: -1.0e-3
    maximum: 1.0e-3
    home_position: -2.0e-5
    fine: {tolerance: 2.0e-8}
    gait:
      release: 2.0e-3
      grip: 2.0e-3
      extend: 5.0e-3
      contract: 5.0e-3
      settle: 1.0e-3
      threshold_voltage: 60.0
      lowest_extension: 1.0e-6
      highest_extension: 9.0e-6
"""


class Story:
    """A synthetic run: the slider jumps at the end of each step."""

    def __init__(self):
        self.now = dict.fromkeys((*REQUIRED, "setpoint", "displacement", "error", "request", "speed"), 0.0)
        self.now |= {"front_voltage": 100.0, "rear_voltage": 100.0}
        self.rows = []

    def wait(self, samples, **changes):
        """Keep all signals for some samples; a request lasts one sample."""
        self.now |= changes
        for _ in range(samples):
            self.rows.append(dict(self.now))
            self.now["request"] = 0.0
        return self

    def step(self, extension, moved, commanded=None, missed=False):
        """One step: signed extension and movement [m]."""
        way = np.sign(extension)
        self.now["arrived"] = 0.0
        for phase in range(at.RELEASING_REAR, at.GRIPPING_FRONT + 1):
            samples = {at.CARRYING: 7, at.RETURNING: 7}.get(phase, 1)
            self.wait(samples, phase=float(phase), front_voltage=0.0 if phase == at.RETURNING else 100.0)
        self.wait(CYCLE - 19)
        self.now |= {
            "displacement": self.now["displacement"] + moved,
            "steps": self.now["steps"] + way,
            "total_steps": self.now["total_steps"] + 1.0,
            "missed": self.now["missed"] + missed,
            "step_commanded": extension if commanded is None else commanded,
            "step_achieved": moved,
            "slip": way * (extension - moved),
            "phase": float(at.HOLDING),
        }
        self.wait(1)
        return self

    def recording(self, configuration=CONFIGURATION, without=()):
        columns = {name: np.array([row[name] for row in self.rows]) for name in self.now if name not in without}
        time = np.arange(len(self.rows)) / RATE
        return Recording.from_columns({"time": time, **columns}, {"configuration": configuration})


def walk(steps=5, moved=7.6e-6):
    """Ten samples at rest, a setpoint, steps of 8 µm that slip by 0.4 µm, and 40 samples at the setpoint."""
    story = Story().wait(10, arrived=1.0)
    story.now["setpoint"] = steps * moved
    for _ in range(steps):
        story.step(8.0e-6, moved, commanded=7.7e-6)
    return story.wait(40, arrived=1.0, phase=float(at.POSITIONING))


def test_a_walk_by_hand():
    story = walk()
    # from the arrival (sample 110 of 150) on: in the second half of the hold, errors of 3 nm and 5 nm alternate
    for k in range(130, 150):
        story.rows[k]["displacement"] = 5 * 7.6e-6 - (3.0e-9 if k % 2 else 5.0e-9)
    story.rows[112]["displacement"] = 5 * 7.6e-6 + 50.0e-9
    figures = inchworm_figures(story.recording())
    (move,) = figures["moves"]
    assert move["outcome"] == "arrived"
    assert move["start_s"] == pytest.approx(0.010)
    assert move["setpoint_m"] == move["travel_m"] == pytest.approx(38.0e-6)
    assert move["time_s"] == pytest.approx(0.100)
    assert (move["steps"], move["missed"]) == (5, 0)
    assert move["mean_speed_m_s"] == pytest.approx(38.0e-6 / 0.100)
    # four cycles lie between the first and the last of five steps
    assert move["walking_speed_m_s"] == pytest.approx(7.6e-6 / 0.020)
    assert move["walking_speed_percent"] == pytest.approx(95.0)
    assert move["slip_m"] == pytest.approx(5 * 0.4e-6)
    assert move["slip_percent"] == pytest.approx(5.0)
    assert move["overshoot_m"] == pytest.approx(50.0e-9)
    assert move["final_error_mean_m"] == pytest.approx(4.0e-9)
    assert move["final_error_rms_m"] == pytest.approx(np.sqrt(17.0) * 1.0e-9)
    assert move["final_error_max_m"] == pytest.approx(5.0e-9)
    run = figures["run"]
    assert run["gait_speed_m_s"] == pytest.approx(400.0e-6) and run["period_s"] == pytest.approx(0.020)
    assert (run["steps"], run["steps_forward"], run["steps_backward"], run["missed"]) == (5, 5, 0, 0)
    assert run["step_error_mean_m"] == pytest.approx(0.1e-6) and run["step_error_std_m"] == pytest.approx(
        0.0, abs=1e-15
    )
    assert run["clamp_voltage_v"] == 100.0 and run["clamp_threshold_v"] == 60.0
    assert run["clamp_force_n"] is None
    assert figures["samples"] == 150 and figures["sample_rate_hz"] == pytest.approx(RATE)


def test_backward_slip_and_missed_grips_count_along_the_step():
    story = Story().wait(5)
    story.now["setpoint"] = -15.0e-6
    story.step(-8.0e-6, -8.0e-6).step(-8.0e-6, -1.0e-6, missed=True).step(-6.0e-6, -7.0e-6, commanded=-6.0e-6)
    figures = inchworm_figures(story.recording())
    (move,) = figures["moves"]
    assert move["outcome"] == "not arrived" and move["time_s"] is None and move["final_error_rms_m"] is None
    assert (move["steps"], move["missed"]) == (3, 1)
    assert move["slip_m"] == pytest.approx(7.0e-6 - 1.0e-6)
    assert move["slip_percent"] == pytest.approx(100.0 * 6.0 / 22.0)
    assert move["overshoot_m"] == pytest.approx(1.0e-6)
    run = figures["run"]
    assert (run["steps_forward"], run["steps_backward"]) == (0, 3)
    assert run["step_error_mean_m"] == pytest.approx((0.0 + 7.0e-6 - 1.0e-6) / 3.0)
    steps = inchworm_run(story.recording()).steps
    assert steps.missed.tolist() == [False, True, False]
    assert steps.extension == pytest.approx([8.0e-6, 8.0e-6, 6.0e-6])


def test_arrival_is_for_good():
    story = walk(steps=2)
    story.wait(10, arrived=0.0).wait(10, arrived=1.0)
    (move,) = inchworm_figures(story.recording())["moves"]
    assert move["time_s"] == pytest.approx(2 * 0.020 + 0.040 + 0.010)
    story.wait(1, arrived=0.0)
    assert inchworm_figures(story.recording())["moves"][0]["outcome"] == "not arrived"


def test_requests_and_speeds_begin_moves_of_their_own():
    story = walk(steps=2)
    story.wait(10, request=float(at.STOP_REQUEST), arrived=0.0)
    story.wait(10, request=float(at.RELEASE_REQUEST))
    story.wait(10, request=float(at.HOME_REQUEST)).wait(10, arrived=1.0, displacement=-20.0e-6)
    story.wait(10, arrived=0.0, speed=1.0e-4).wait(10, speed=0.0)
    story.wait(10, setpoint=5.0e-6, error=float(at.NO_MOTION_ERROR))
    moves = inchworm_figures(story.recording())["moves"]
    outcomes = ["arrived", "stopped", "released", "arrived", "walking", "holding", "error: no_motion"]
    assert [move["outcome"] for move in moves] == outcomes
    goals = [move["setpoint_m"] for move in moves]
    assert goals == pytest.approx([15.2e-6, None, None, -20.0e-6, None, None, 5.0e-6])
    assert moves[3]["time_s"] == pytest.approx(0.010)
    assert moves[3]["final_error_rms_m"] == pytest.approx(0.0, abs=1e-15)


def test_the_beginning_is_a_move_only_when_the_slider_is_elsewhere():
    there = Story().wait(20, arrived=1.0, displacement=15.0e-9).recording()
    assert inchworm_figures(there)["moves"] == []
    assert "no moves" in format_inchworm(inchworm_figures(there))
    away = Story().wait(20, arrived=1.0, displacement=25.0e-9).recording()
    assert len(inchworm_figures(away)["moves"]) == 1


def test_clamps_that_are_both_open_are_seen():
    story = walk()
    story.rows[30] |= {"front_voltage": 12.0, "rear_voltage": 40.0}
    assert inchworm_figures(story.recording())["run"]["clamp_voltage_v"] == 40.0


def test_samples_without_signals_are_left_out():
    story = walk()
    complete = inchworm_figures(story.recording())["moves"]
    for k in (0, 15, 149):
        story.rows[k]["slip"] = np.nan
    (move,) = inchworm_figures(story.recording())["moves"]
    assert move["slip_m"] == complete[0]["slip_m"] and move["steps"] == 5


def test_without_configuration_the_gait_is_unknown():
    figures = inchworm_figures(walk().recording(""))
    assert figures["moves"][0]["walking_speed_percent"] is None and figures["run"]["gait_speed_m_s"] is None
    assert figures["moves"][0]["walking_speed_m_s"] == pytest.approx(380.0e-6)


def test_hardware_is_judged_by_the_measured_slider():
    run = walk().recording()
    columns = {"time": run.time, **run.signals}
    columns["measured"] = columns.pop("displacement")
    figures = inchworm_figures(Recording.from_columns(columns))
    assert figures["moves"][0]["slip_m"] == pytest.approx(2.0e-6)
    assert any("measured" in note for note in figures["notes"]["recording"])


def test_missing_columns_are_named():
    run = walk().recording(without=("slip", "arrived"))
    assert is_inchworm(run)
    with pytest.raises(RecordingError, match=r"lacks slip, arrived; record inchworm_sequencer/state"):
        inchworm_figures(run)


def test_an_ordinary_axis_is_none():
    time = np.arange(10.0)
    assert not is_inchworm(Recording.from_columns({"time": time, "reference": time, "displacement": time}))
    described = Recording.from_columns({"time": time, "displacement": time}, {"configuration": CONFIGURATION})
    assert is_inchworm(described)


@pytest.fixture(scope="module")
def simulated():
    """Forward 20 µm and back 12 µm with config/inchworm_travel.yaml."""
    setpoints = np.repeat([0.0, 20.0e-6, 8.0e-6], [1000, 2600, 2400])
    return simulate(single_axis(load_configuration("inchworm_travel")), setpoints=setpoints)


def test_a_simulated_run(simulated):
    figures = inchworm_figures(simulated)
    assert [move["outcome"] for move in figures["moves"]] == ["arrived", "arrived"]
    for move, travel in zip(figures["moves"], (20.0e-6, -12.0e-6), strict=True):
        assert move["travel_m"] == pytest.approx(travel, abs=30e-9)
        assert move["final_error_rms_m"] < 5e-9
    assert figures["run"]["clamp_voltage_v"] >= figures["run"]["clamp_threshold_v"]
    assert figures["run"]["clamp_force_n"] > 20.0


@pytest.mark.slow
@pytest.mark.parametrize("case", ["simulated", "made up", "at rest", "one step"])
def test_plots_say_quantity_and_unit(simulated, case):
    pytest.importorskip("matplotlib", reason="plots need Matplotlib")
    from hysteresis_ros.analysis.inchworm_report import IN_THE_PLACE, INCHWORM_PLOTS, inchworm_charts
    from hysteresis_ros.analysis.plots import chart_figure, png

    recordings = {
        "simulated": lambda: simulated,
        "made up": lambda: walk().recording(),
        "at rest": lambda: Story().wait(20).recording(),
        "one step": lambda: walk(steps=1).recording(),
    }
    run = inchworm_run(recordings[case]())
    drawn = [draw(run) for *_, draw in (*INCHWORM_PLOTS, *IN_THE_PLACE)]
    for figure in [*drawn, *(chart_figure(chart) for chart in inchworm_charts(run))]:
        assert png(figure).startswith(b"\x89PNG")
        for axis in figure.axes:
            for label in (axis.get_xlabel(), axis.get_ylabel()):
                assert re.search(r"\[(s|ms|V|N|nm|µm|mm|1)\]$", label), label


@pytest.mark.slow
def test_the_command_writes_page_and_figures(simulated, tmp_path):
    pytest.importorskip("matplotlib", reason="reports need Matplotlib")
    pytest.importorskip("jinja2", reason="reports need Jinja2")
    save_run(simulated, tmp_path / "run.npz")
    page, figures = tmp_path / "page.html", tmp_path / "page.json"
    arguments = [str(tmp_path / "run.npz"), "-o", str(page), "--json", str(figures)]
    result = CliRunner().invoke(report, arguments, catch_exceptions=False)
    assert result.exit_code == 0 and "final error" in result.output
    text = page.read_text(encoding="utf-8")
    assert text.count('src="data:image/png;base64,') == 7
    addresses = re.findall(r'(?:src|href)="([^"]*)"', re.sub(r"<script.*?</script>", "", text, flags=re.S))
    assert ">move 2</option>" in text and 'id="chart-final_error"' in text and len(text) < 2_000_000
    assert all(address.startswith("data:") for address in addresses)
    assert "Moves" in text and "arrived" in text and "inchworm_sequencer" in text
    stored = json.loads(figures.read_text(encoding="utf-8"))
    assert stored == json.loads(json.dumps(inchworm_figures(simulated)))
    assert [move["steps"] for move in stored["moves"]] == [
        move["steps"] for move in inchworm_figures(simulated)["moves"]
    ]


@pytest.mark.slow
def test_runs_of_motors_stand_side_by_side(tmp_path):
    one, other = walk().recording(), walk(steps=3, moved=7.0e-6).recording()
    paths = [tmp_path / "one.npz", tmp_path / "other.npz"]
    save_run(one, paths[0])
    save_run(replace(other, time=other.time + 5.0), paths[1])
    page, figures = tmp_path / "both.html", tmp_path / "both.json"
    result = CliRunner().invoke(report, [*map(str, paths), "-o", str(page), "--json", str(figures)])
    assert result.exit_code == 0, result.output
    found = json.loads(figures.read_text(encoding="utf-8"))["runs"]
    summary = found["other.npz"]["summary"]
    assert (summary["moves"], summary["arrived"], summary["failed"]) == (1, 1, 0)
    assert summary["time_s"] == pytest.approx(0.060) and summary["final_error_max_m"] == pytest.approx(0.0)
    assert summary["walking_speed_m_s"] == pytest.approx(7.0e-6 / 0.020)
    assert found["one.npz"]["moves"] == inchworm_figures(one)["moves"]
    html = page.read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="data">(.*?)</script>', html, re.S).group(1))
    assert [chart["name"] for chart in data["charts"]] == ["travel", "final_error"]
    assert [line["label"] for line in data["charts"][0]["lines"]] == ["one.npz", "other.npz"]
    assert data["whole"] == [0.0, pytest.approx(one.time[-1])]  # each from its first sample on
    late = replace(other, time=other.time + 5.0)
    assert [line.x[0] for chart in laid_over({"one": one, "late": late})[:1] for line in chart.lines] == [0.0, 0.0]
    # the same in Python, by files and by names
    assert hr.report(paths) == found
    assert list(hr.report({"first": one, "second": paths[1]})) == ["first", "second"]


def test_moves_that_fail_are_counted_and_the_worst_is_told():
    move = dict.fromkeys(("time_s", "walking_speed_m_s", "final_error_rms_m", "final_error_max_m", "overshoot_m"))
    moves = [
        {**move, "outcome": "arrived", "time_s": 2.0, "final_error_rms_m": 1e-9, "walking_speed_m_s": 3e-4},
        {**move, "outcome": "arrived", "time_s": 3.0, "final_error_rms_m": 4e-9, "walking_speed_m_s": 2e-4},
        {**move, "outcome": "not arrived"},
        {**move, "outcome": "error: slip"},
        {**move, "outcome": "stopped"},
    ]
    found = summary(moves)
    assert (found["moves"], found["arrived"], found["failed"], found["time_s"]) == (5, 2, 2, 5.0)
    assert (found["final_error_rms_m"], found["walking_speed_m_s"], found["overshoot_m"]) == (4e-9, 2e-4, None)


def test_several_runs_that_are_none_or_twice_the_same_are_refused(tmp_path):
    for given in ([], {}):
        with pytest.raises(RecordingError, match="give at least one"):
            hr.report(given)
    with pytest.raises(RecordingError, match="more than once"):
        hr.report([tmp_path / "a.npz", tmp_path / "a.npz"])
