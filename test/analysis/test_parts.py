# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Parts of synthetic runs whose parts are known, and of runs that were stopped."""

import json

import numpy as np
import pytest

from hysteresis_ros.analysis.metrics import compute_metrics
from hysteresis_ros.analysis.page import chart_payload
from hysteresis_ros.analysis.parts import Kind, disturbed, find_parts, period_ends, scan_start, stopped, within
from hysteresis_ros.analysis.report import columns_of
from hysteresis_ros.analysis.run_charts import error_chart, judged, traces_chart
from hysteresis_ros.analysis.side_by_side import format_runs
from hysteresis_ros.analysis.tables import format_table, leading
from hysteresis_ros.recordings import Recording

RATE = 1000.0
TIME = np.arange(1000) / RATE
TRIANGLE = 10e-6 * (1.0 - np.abs(1.0 - 2.0 * ((5.0 * TIME + 1e-9) % 1.0)))
SINE = 5e-6 + 3e-6 * np.sin(2.0 * np.pi * 5.0 * TIME)
STEPS = np.repeat([0.0, 2e-6, 0.0, 5e-6, 9e-6, 3e-6, 0.0], 200)
REST = np.zeros(200)
DWELL = np.tile(np.r_[np.linspace(0, 1, 100), np.ones(30), np.linspace(1, 0, 100), np.zeros(30)], 4)

RUNS = {
    "triangle": (TRIANGLE, [("scan", 0, 1000)]),
    "triangle between rests": ([REST, TRIANGLE, REST], [("hold", 0, 200), ("scan", 200, 1200), ("hold", 1200, 1400)]),
    "steps": (STEPS, [("hold", 0, 190), ("steps", 190, 1400)]),
    "one step": (np.repeat([0.0, 1.0], 200), [("hold", 0, 190), ("steps", 190, 400)]),
    "a slow move": ([REST, np.linspace(0, 1, 300), REST + 1], [("hold", 0, 190), ("steps", 190, 700)]),
    "approach, scan, way back": (
        [REST, np.linspace(0, 5e-6, 200), SINE, np.linspace(5e-6, 0, 200), REST],
        [("hold", 0, 200), ("approach", 200, 400), ("scan", 400, 1400), ("path", 1400, 1600), ("hold", 1600, 1800)],
    ),
    "a move to where a scan begins": (
        [REST, np.linspace(0, 5e-6, 200), REST + 5e-6, SINE],
        [("hold", 0, 190), ("approach", 190, 600), ("scan", 600, 1600)],
    ),
    "steps before a scan": (
        [STEPS, TRIANGLE, REST],
        [("hold", 0, 190), ("steps", 190, 1400), ("scan", 1400, 2400), ("hold", 2400, 2600)],
    ),
    "a small scan after large steps": (
        [30.0 * STEPS, TRIANGLE],
        [("hold", 0, 190), ("steps", 190, 1400), ("scan", 1400, 2400)],
    ),
    "a scan that rests at its ends": (DWELL, [("scan", 0, 1010), ("hold", 1010, 1040)]),
    "periods of one length that are not alike": (
        np.concatenate([k * TRIANGLE[:200] for k in (1.0, 2.0, 1.5, 3.0, 1.2)]),
        [("path", 0, 1000)],
    ),
    "chirp": (np.sin(40.0 * TIME**2), [("path", 0, 1000)]),
    "one way there and back": (TRIANGLE[:200], [("path", 0, 200)]),
    "at rest": (REST, [("hold", 0, 200)]),
    "one sample": ([0.0], [("hold", 0, 1)]),
}


def run(reference, displacement=None, **more):
    reference = np.concatenate(reference) if isinstance(reference, list) and np.ndim(reference[0]) else reference
    columns = {"reference": reference, "displacement": reference if displacement is None else displacement, **more}
    return Recording.from_columns({"time": np.arange(len(reference)) / RATE, **columns})


@pytest.mark.parametrize("name", RUNS)
def test_a_run_falls_into_its_parts(name):
    given, expected = RUNS[name]
    reference = np.concatenate(given) if np.ndim(given[0]) else np.asarray(given)
    found = find_parts(reference)
    assert [part.kind for part in found] == [kind for kind, *_ in expected]
    # the beginning of a scan is known only to a fraction of its period, because the motion before it is similar
    for part, (_, start, stop) in zip(found, expected, strict=True):
        assert part.start == pytest.approx(start, abs=12) and part.stop == pytest.approx(stop, abs=12)
    assert found[0].start == 0 and found[-1].stop == reference.size
    assert all(one.stop == other.start for one, other in zip(found[:-1], found[1:], strict=True))


@pytest.mark.parametrize("reference", [STEPS, STEPS[200:1200], np.repeat([0.0, 2e-6, 0.0, 5e-6, 0.0], 200)])
def test_no_period_is_invented_for_steps_that_do_not_repeat(reference):
    assert not period_ends(run(reference)).size
    assert all("period_s" not in part for part in compute_metrics(run(reference))["parts"])
    assert [name for name, *_ in columns_of(run(reference), compute_metrics(run(reference)))][-1] != "last period"


@pytest.mark.parametrize("frequency", [5.0, 7.3, 13.7])
@pytest.mark.parametrize(("shape", "kind"), [(np.sin, "scan"), (lambda phase: np.sign(np.sin(phase + 0.1)), "steps")])
def test_what_repeats_has_its_period(frequency, shape, kind):
    (*_, part) = compute_metrics(run(1e-6 * shape(2.0 * np.pi * frequency * TIME)))["parts"]
    assert part["part"] == kind and part["period_s"] == pytest.approx(1.0 / frequency, abs=1.1 / RATE)
    assert part["periods"] in (int(frequency) - 1, int(frequency))


@pytest.mark.parametrize("periodic", [True, False])
def test_a_start_that_outlasts_the_first_reversal_is_not_judged(periodic):
    # the axis rests 1 µm below the scan until 0.25 s, then approaches it; 20 nm of error remain
    number = np.arange(2000)
    time = number / RATE
    reference = np.tile(TRIANGLE, 2) if periodic else 1e-5 * np.sin(20.0 * time + 6.0 * time**2) ** 2
    reference = reference + 5e-6
    away = np.where(number < 250, reference - 4e-6, (reference[250] - 4e-6) * np.exp(-(number - 250) / 10.0))
    steady = 20e-9 * np.sin(2.0 * np.pi * number / 40)
    figures = compute_metrics(run(reference, reference - away - steady))
    assert max(np.abs(away[100:])) > 5 * abs(away[0]), "the error grows beyond that of the jump"
    assert figures["max_error_m"] < 0.3e-6 and figures["rms_error_m"] == pytest.approx(14e-9, rel=0.3)
    (note,) = [note for note in figures["notes"]["recording"] if "the axis follows from this reversal on" in note]
    approach, rest = figures["parts"]
    assert approach["part"] == "approach" and 0.25 < approach["to_s"] < 0.45
    assert rest["part"] == ("scan" if periodic else "path") and rest["max_error_m"] < 0.3e-6
    # errors that come back later, as large as those of the start, count
    later = np.where((number > 1200) & (number < 1250), 8e-6, 0.0)
    assert compute_metrics(run(reference, reference - away - steady - later))["max_error_m"] > 8e-6


def test_two_tones_repeat_after_all_of_their_reversals():
    (part,) = compute_metrics(run(np.sin(10.0 * np.pi * TIME) + 0.7 * np.sin(30.0 * np.pi * TIME + 1.0)))["parts"]
    assert part["part"] == "scan" and part["period_s"] == pytest.approx(0.2)


def test_a_scan_is_judged_over_its_whole_periods():
    """The error before the first reversal and at rest is different; it is not counted for the scan."""
    reference = np.concatenate([REST, TRIANGLE, REST])
    time = np.arange(1400) / RATE
    inside = (time >= 0.299) & (time < 1.1)
    error = np.where(inside, np.sqrt(2.0) * 20e-9 * np.sin(2.0 * np.pi * 25.0 * time), 300e-9)
    hold, scan, rest = compute_metrics(run(reference, reference - error))["parts"]
    assert scan["rms_error_m"] == pytest.approx(20e-9, rel=1e-2)
    assert scan["max_error_m"] == pytest.approx(np.sqrt(2.0) * 20e-9, rel=1e-2)
    assert scan["rms_error_percent_of_stroke"] == pytest.approx(0.2, rel=1e-2)
    assert (scan["periods"], scan["period_s"]) == (4, pytest.approx(0.2))
    assert hold["rms_error_m"] == pytest.approx(300e-9) and "loop_width_percent" in scan and "steps" not in scan
    assert compute_metrics(run(reference))["steps"] == 0, "a scan between two rests is not a step"
    higher = np.concatenate([REST, TRIANGLE, np.full(200, 5e-6)])
    assert compute_metrics(run(higher))["overshoot_percent"] is None


def stopped_run(stop: int = 1000, signal: str = "tripped", value: float = 3.0):
    """Steps that are tracked with 10 % overshoot; then the axis is stopped, which moves it by 1.5 µm."""
    displacement = STEPS.copy()
    for start in np.flatnonzero(np.diff(STEPS)) + 1:
        displacement[start : start + 5] += 0.1 * (STEPS[start] - STEPS[start - 1])
    displacement[stop:] = 1.5e-6
    flag = np.where(np.arange(STEPS.size) >= stop, value, 0.0)
    voltage = np.where(flag, 0.0, STEPS / 0.1e-6 + 1.0)
    return run(STEPS, displacement, voltage=voltage, **{signal: flag})


@pytest.mark.parametrize(
    ("signal", "value"),
    [("tripped", 3.0), ("plant_mode", 4.0), ("controller_mode", 3.0), ("compensator_mode", 3.0), ("plant_mode", 2.0)],
)
def test_a_shutdown_is_no_step_and_is_not_judged(signal, value):
    recording = stopped_run(signal=signal, value=value)
    figures = compute_metrics(recording)
    assert [part["part"] for part in figures["parts"]] == ["hold", "steps", "shutdown"]
    assert set(figures["parts"][-1]) == {"part", "from_s", "to_s"} and figures["parts"][-1]["from_s"] == 1.0
    assert figures["overshoot_percent"] == pytest.approx(10.0) and figures["steps"] == 4
    assert figures["settling_time_s"] == pytest.approx(0.005) and figures["steady_state_error_m"] < 1e-15
    assert figures["max_error_m"] == pytest.approx(0.5e-6), "10 % of 5 µm, without the motion of the shutdown"
    assert figures["duration_s"] == pytest.approx(1.399) and figures["samples"] == 1400
    assert "0.4 s of shutdown" in " ".join(figures["notes"]["recording"])
    assert not judged(recording).counted[1000:].any() and judged(recording).counted[:1000].all()
    names, *_ = zip(*columns_of(recording, figures), strict=True)
    assert names == ("whole run", "steps")
    assert columns_of(recording, figures)[0][1:3] == (0.0, pytest.approx(1.399))
    assert columns_of(recording, figures)[1][3]["overshoot_percent"] == pytest.approx(10.0)


def test_what_stopped_the_nodes_counts_where_no_signal_says_it():
    recording = stopped_run(signal="skipped")
    changes = [{"sample": 1000, "node": "plant_simulator", "action": "halt"}]
    known = Recording(recording.time, recording.signals, recording.units, {"changes": changes})
    assert not stopped(recording).any() and np.flatnonzero(stopped(known))[0] == 1000
    again = [*changes, {"sample": 1200, "node": "plant_simulator", "action": "start"}]
    known = Recording(recording.time, recording.signals, recording.units, {"changes": again})
    assert np.count_nonzero(stopped(known)) == 200 and not stopped(known)[1200:].any()
    assert [part.kind for part in find_parts(STEPS, off=stopped(known))].count(Kind.SHUTDOWN) == 1
    # a change keeps its sample in an excerpt, also in one of an excerpt
    excerpt = within(within(known, 0.3, 1.35), 0.2, 1.0)
    assert np.flatnonzero(stopped(excerpt)).tolist() == list(range(500, 700))


def a_table(**other):
    """Return a run without modes, as from a table: steps that settle, then the voltage falls to 0 V in 50 samples."""
    reference = np.concatenate([STEPS[:1000], np.full(400, STEPS[999])])
    fall = np.concatenate([np.ones(1000), np.linspace(1.0, 0.0, 50), np.zeros(350)])
    rng = np.random.default_rng(3)
    displacement = reference * fall + rng.normal(0.0, 2e-9, 1400)
    voltage = reference * fall * 1e7 + rng.normal(0.0, 0.02, 1400) * (fall == 1.0)
    return run(reference, displacement, **{"voltage": voltage} | other)


def test_a_table_that_ends_in_a_shutdown_shows_it_in_its_voltage():
    recording = a_table()
    begins = int(np.flatnonzero(stopped(recording))[0])
    assert 995 <= begins <= 1001 and stopped(recording)[begins:].all()
    figures = compute_metrics(recording)
    assert figures["parts"][-1]["part"] == "shutdown" and figures["max_error_m"] < 0.1e-6
    assert "inferred: the voltage left a settled hold" in " ".join(figures["notes"]["recording"])


@pytest.mark.parametrize(
    "other",
    [
        pytest.param({"plant_mode": np.zeros(1400)}, id="a recording that says it was running"),
        pytest.param({"voltage": STEPS * 1e7}, id="a voltage that does not leave"),
        pytest.param({"voltage": np.random.default_rng(1).normal(size=1400)}, id="a voltage that does not stand still"),
    ],
)
def test_an_axis_that_is_not_shown_to_be_stopped_is_judged(other):
    assert not stopped(a_table(**other)).any()


def test_saturation_is_no_shutdown():
    reference = np.repeat([0.0, 5e-6, 9e-6], 400)
    reached = np.minimum(reference, 7e-6)
    assert not stopped(run(reference, reached, voltage=reached * 1e7)).any()


def test_a_node_that_waits_for_input_for_a_while_has_not_stopped_the_axis():
    mode = np.zeros(1400)
    mode[700:760] = 2.0
    assert not stopped(run(STEPS, controller_mode=mode)).any()
    mode[1000:] = 2.0
    assert np.count_nonzero(stopped(run(STEPS, controller_mode=mode))) == 400


def test_a_run_that_is_stopped_throughout_says_so():
    figures = compute_metrics(run(STEPS, STEPS - 1e-6, tripped=np.ones(1400)))
    assert figures["rms_error_m"] is None and "not evaluated" in figures["notes"]["rms_error_m"]
    assert "not evaluated" in format_table(figures) and json.dumps(figures, allow_nan=False)


def test_a_jump_to_the_first_reference_is_an_approach():
    reference = np.full(500, 5e-6)
    displacement = reference * (1.0 - np.exp(-TIME[:500] / 0.01))
    approach, hold = compute_metrics(run(reference, displacement))["parts"]
    assert approach["part"] == "approach" and approach["to_s"] == pytest.approx(0.039)
    assert hold["part"] == "hold" and hold["max_error_m"] <= 0.1e-6


def test_text_leads_with_the_parts_and_what_judges_the_longest():
    lines = format_table(compute_metrics(stopped_run())).splitlines()
    assert lines[1].startswith("steps") and "overshoot 10 %" in lines[1] and "worst of 4 steps" in lines[1]
    assert lines[2].startswith("shutdown") and "not evaluated" in lines[2]
    assert lines[3].startswith("Overshoot")
    assert [name for name, *_ in leading([compute_metrics(run(TRIANGLE))])][:1] == ["rms_error_m"]
    figures = {"a": compute_metrics(stopped_run()), "b": compute_metrics(run(TRIANGLE))}
    text = format_runs(figures)
    assert "a: shutdown" in text and "b: scan" in text and text.index("b: scan") < text.index("Overshoot")
    assert "over 4 whole periods of 200 ms" in text


@pytest.mark.slow
@pytest.mark.parametrize("samples", [4, 24, 90])
def test_errors_are_also_given_without_what_skipped_samples_disturbed(samples):
    # an error of 2 nm; after each of forty skipped samples 1 µm of error that decays within the given number of samples
    random = np.random.default_rng(5)
    skipped = np.zeros(40000)
    skipped[random.choice(np.arange(200, 39000), 40, replace=False)] = 1.0
    decay = np.exp(-np.arange(40000) * np.log(1e3) / samples)
    clean = random.normal(0.0, 2e-9, 40000)
    reference = 5e-6 * np.sin(2 * np.pi * np.arange(40000) / 2000)
    error = clean + 1e-6 * np.convolve(skipped, decay)[:40000]
    span = disturbed(skipped > 0.0, error)
    assert span[skipped > 0.0].all() and not span[: np.flatnonzero(skipped)[0]].any()
    lengths = np.diff(np.flatnonzero(np.diff(span.astype(int))))[::2]
    assert 0.7 * samples <= np.median(lengths) <= 4 * samples
    time = np.arange(40000) * 1e-3
    signals = {"reference": reference, "displacement": reference - error, "skipped": skipped}
    figures = compute_metrics(Recording(time, signals, {}, {}), parts=False)
    first = scan_start(reference, reference - error)
    assert figures["disturbed_percent"] == pytest.approx(100.0 * np.mean(span[first:]), rel=0.05)
    assert figures["undisturbed_rms_error_m"] == pytest.approx(2e-9, rel=0.05)
    assert figures["undisturbed_max_error_m"] < 0.05 * figures["max_error_m"]
    assert figures["rms_error_m"] > 4 * figures["undisturbed_rms_error_m"]


def test_without_a_skipped_sample_nothing_is_disturbed_and_the_figures_say_so():
    assert not disturbed(np.zeros(5, dtype=bool), np.ones(5)).any()
    figures = compute_metrics(run(STEPS, STEPS - 1e-6, skipped=np.zeros(1400)))
    assert figures["disturbed_percent"] == 0.0 and figures["undisturbed_rms_error_m"] is None
    assert "no sample was skipped" in figures["notes"]["undisturbed_rms_error_m"]
    assert compute_metrics(run(STEPS, STEPS - 1e-6))["disturbed_percent"] is None


@pytest.mark.parametrize("delay", [1, 3])
def test_a_large_error_at_the_start_does_not_hide_what_skipped_samples_disturbed(delay):
    # the error at the start is far from all skipped samples, and their effect begins after the delay of the axis
    number, skipped = np.arange(8000), np.zeros(8000)
    skipped[[2500, 4000, 5500]] = 1.0
    decay = np.where(number >= delay, np.exp(-number * np.log(1e3) / 60), 0.0)
    noise = np.random.default_rng(5).normal(0.0, 2e-9, 8000)
    error = noise + 1e-7 * np.convolve(skipped, decay)[:8000] + 4e-5 * np.exp(-number / 100.0)
    reference = 5e-6 * np.sin(2 * np.pi * number / 2000)
    measured = np.where(skipped > 0.0, np.nan, reference - error)
    assert 30 <= np.sum(disturbed(skipped > 0.0, reference - measured)) / 3 <= 128
    signals = {"reference": reference, "measured": measured, "skipped": skipped}
    figures = compute_metrics(Recording(number * 1e-3, signals, {}, {"excerpt": True}), parts=False)
    assert figures["disturbed_percent"] > 1.0 and figures["undisturbed_rms_error_m"] > 1e-6
    # a skipped sample outside what is evaluated was skipped, but disturbs nothing
    signals["skipped"] = np.where(number == 10, 1.0, 0.0)
    notes = compute_metrics(Recording(number * 1e-3, signals, {}), parts=False)["notes"]
    assert notes["undisturbed_rms_error_m"] == "samples were skipped, but no evaluated sample is disturbed"


def test_a_skipped_sample_of_a_device_disturbs_although_it_has_no_measurement_and_charts_mark_it():
    random = np.random.default_rng(5)
    skipped = np.zeros(8000)
    skipped[[1200, 1230, 4000, 5500]] = 1.0
    decay = np.exp(-np.arange(8000) * np.log(1e3) / 60)
    error = random.normal(0.0, 2e-9, 8000) + 1e-7 * np.convolve(skipped, decay)[:8000]
    reference = 5e-6 * np.sin(2 * np.pi * np.arange(8000) / 2000)
    measured = np.where(skipped > 0.0, np.nan, reference - error)
    recording = Recording(np.arange(8000) * 1e-3, {"reference": reference, "measured": measured, "skipped": skipped})
    figures = compute_metrics(recording, parts=False)
    assert figures["undisturbed_rms_error_m"] == pytest.approx(2e-9, rel=0.05)
    assert figures["rms_error_m"] > 2.0 * figures["undisturbed_rms_error_m"]
    run = judged(recording)
    for chart in (traces_chart(run), error_chart(run)):
        assert chart.marked.shape == (3, 2)  # the first two overlap
        assert chart.marked[:, 0] == pytest.approx([1.2, 4.0, 5.5]) and np.all(np.diff(chart.marked) > 0.03)
        assert chart_payload([chart])["charts"][0]["marked"] == chart.marked.tolist()
        assert "disturbed by 4 skipped samples" in chart.note
    assert f"without these spans {1e9 * figures['undisturbed_rms_error_m']:.4g} nm" in error_chart(run).note
    still = Recording(recording.time, {"reference": reference, "measured": reference - error, "skipped": 0.0 * skipped})
    assert traces_chart(judged(still)).marked is None and not error_chart(judged(still)).note


@pytest.mark.parametrize("shape", [lambda t: np.abs((5.0 * t + 0.5) % 1.0 - 0.5), lambda t: np.sin(10.0 * np.pi * t)])
def test_a_scan_with_missing_samples_is_one_scan_with_its_period(shape):
    time = np.arange(2000) / RATE
    there = np.random.default_rng(3).random(2000) > 0.05
    there[900:915] = False
    reference = 1e-5 * shape(time)
    columns = {"reference": reference, "displacement": np.where(there, reference, np.nan)}
    (part,) = compute_metrics(Recording.from_columns({"time": time, **columns}))["parts"]
    assert part["part"] == "scan" and part["period_s"] == pytest.approx(0.2, abs=1.1 / RATE) and part["periods"] == 9
    removed = Recording.from_columns({"time": time[there], **{k: v[there] for k, v in columns.items()}})
    assert period_ends(removed).size == 10


def test_measurements_that_a_sensor_did_not_give_are_counted_and_skipped_samples_are_not():
    reference = 1e-6 * np.sin(10.0 * np.pi * TIME)
    displacement, skipped = reference.copy(), np.zeros(len(TIME))
    displacement[[300, 301, 500]] = np.nan
    skipped[500] = 1.0
    notes = compute_metrics(run(reference, displacement, skipped=skipped))["notes"]["recording"]
    (note,) = [note for note in notes if "the sensor gave no measurement" in note]
    assert "in 2 of 1000 samples, first at 0.3 s" in note
    assert not any("no measurement" in note for note in compute_metrics(run(reference))["notes"]["recording"])
