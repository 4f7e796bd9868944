# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The initial state of a recording, outliers, and structures that must predict held-out parts."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification import separation, workflow
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.dynamics import TurnSearch, in_series
from hysteresis_ros.identification.linear_systems import LinearPart
from hysteresis_ros.identification.plant_model import simulate_chain
from hysteresis_ros.identification.prandtl_ishlinskii import (
    PRIOR_DECAY,
    SmoothDensity,
    find_ambiguity,
    fit_prandtl_ishlinskii,
)
from hysteresis_ros.identification.prediction import predict
from hysteresis_ros.identification.preprocessing import condense, simple_loops, wiped_out
from hysteresis_ros.identification.registry import parse_options
from hysteresis_ros.identification.separation import find_start, rests_behind
from hysteresis_ros.identification.workflow import identify
from hysteresis_ros.laboratory.benchmark.synthetic import synthetic_task
from hysteresis_ros.models.hysteresis import MODELS, HysteresisParameters, hysteresis_block
from hysteresis_ros.models.hysteresis.generalised_play import GeneralisedPlayParameters
from hysteresis_ros.models.hysteresis.polynomial import PolynomialHysteresis, assumed_stack
from hysteresis_ros.models.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiParameters
from hysteresis_ros.units import readable

T = 0.005
TIME = np.arange(800) * T  # four cycles of 1 Hz
RADII = 2.5 * np.arange(40)
DENSITY = np.exp(-1.9 * RADII / 50.0)


def stack(decay=1.9, bent=-0.15):
    """A stack for 0 … 100 V of 10 µm: reversible half, exponential density, and a map whose slope falls by 15 %."""
    density = np.exp(-decay * RADII / 50.0)
    density[0] = density[1:].sum()
    weights = 10e-6 * density / (100.0 * density.sum())
    zones = PrandtlIshlinskiiParameters(
        tuple(RADII), tuple(weights), tuple(1e-6 * np.arange(1, 8)), tuple(np.full(7, bent / 7.0))
    )
    return HysteresisParameters(type="prandtl_ishlinskii", prandtl_ishlinskii=zones)


def recorded(voltage, history=(), noise=2e-9, lag=0.01):
    part = LinearPart(lag=lag, settled=bool(history))
    y = simulate_chain(stack(), part.creep, part.dynamics(T), voltage, T, settled=part.settled, history=history)
    return y + noise * np.random.default_rng(1).standard_normal(y.size)


def loops(amplitude, time=TIME):
    return 0.5 * amplitude * (1.0 - np.cos(2.0 * np.pi * time))


GROWING, DECAYING = loops(25.0 * (TIME + 0.2) / 1.05), loops(100.0 - 20.0 * TIME)


def data(voltage, displacement):
    return IdentificationData(np.arange(len(voltage)) * T, voltage, displacement)


def test_the_past_is_wiped_out_only_where_a_rise_and_a_fall_come_after():
    assert wiped_out(loops(100.0, TIME[:200])) is None  # only one branch would remain
    assert wiped_out(GROWING) is None
    assert wiped_out(loops(100.0)) == pytest.approx(100, abs=15)
    assert wiped_out(DECAYING) == pytest.approx(100, abs=25)


@pytest.mark.slow
def test_one_cycle_from_rest_is_fitted_on_both_branches():
    voltage = loops(100.0, TIME[:201])
    found = identify(data(voltage, recorded(voltage)), linear="lag")
    assert found.figures["skipped"] == 0
    assert np.std(found.predicted - recorded(voltage)) < 0.03e-6


@pytest.mark.slow
def test_one_cycle_of_a_repeated_drive_is_found_periodic():
    voltage = loops(100.0)
    y = recorded(voltage)
    found = identify(data(voltage[400:601], y[400:601]), linear="lag")
    assert found.plant.initial == "periodic" and "periodic before" in found.figures["start"]
    other = predict(found.plant, DECAYING, T, initial="zero") - recorded(DECAYING)
    assert np.std(other[200:]) < 0.08e-6


@pytest.mark.slow
def test_a_remanent_stack_is_seen_where_the_ends_come_late():
    history = (120.0, 0.0)
    y = recorded(GROWING, history)
    start = find_start(data(GROWING, y))
    assert start.kind == "estimate" and start.history[0] > 60.0
    found = identify(data(GROWING, y), linear="lag")
    assert found.figures["rmse_m"] < 0.02e-6  # 0.06e-6 from rest
    assert "remanent" in found.text and "remanent" in found.figures["start"]


@pytest.mark.parametrize("voltage", [loops(100.0), DECAYING], ids=["loops", "decaying loops"])
@pytest.mark.parametrize("past", [40.0, 100.0, 150.0])
def test_an_unknown_past_is_left_out_where_a_cycle_remains(voltage, past):
    start = find_start(data(voltage, recorded(voltage, (past, 0.0))))
    assert start.skip == wiped_out(voltage) > 0 and "omitted" in start.note


@pytest.mark.parametrize("voltage", [loops(100.0), DECAYING], ids=["loops", "decaying loops"])
def test_the_first_rise_is_fitted_where_rest_explains_it_better_than_any_remanence(voltage):
    start = find_start(data(voltage, recorded(voltage)))
    assert (start.kind, start.skip) == ("zero", 0) and "explains its beginning" in start.note
    halfway = find_start(data(voltage[60:], recorded(voltage)[60:]))  # in the middle of the first rise
    assert halfway.skip == wiped_out(voltage[60:])


def test_a_start_at_rest_counts_where_much_would_be_left_out():
    rng = np.random.default_rng(5)
    levels = np.concatenate([rng.uniform(30.0, 70.0, 12), [100.0, 0.0], rng.uniform(0.0, 100.0, 6)])
    steps = np.repeat(levels, 40)
    assert wiped_out(steps) > 0.5 * len(steps)
    rested = find_start(data(steps, recorded(steps)))
    assert rested.skip == 0 and "explains its beginning" in rested.note
    for history in ((150.0, 0.0), (100.0, 50.0)):  # mid-history: remanent, and halfway down a loop
        unknown = find_start(data(steps, recorded(steps, history)))
        assert unknown.skip == wiped_out(steps) and "omitted" in unknown.note


@pytest.mark.slow
@pytest.mark.parametrize(
    "model, history", [("prandtl_ishlinskii", ()), ("prandtl_ishlinskii", (150.0, 0.0)), ("preisach", ())]
)
def test_a_sensor_that_read_zero_at_rest_keeps_its_zero(model, history):
    y = recorded(loops(100.0), history)
    found = identify(data(loops(100.0), y - y[0]), model, linear="lag")
    assert abs(found.plant.offset) < 0.01e-6 and found.figures["sensor_zero_m"] == found.plant.offset
    assert found.figures["rmse_m"] < 0.1e-6
    assert found.figures["noise_rms_m"] == pytest.approx(2e-9, rel=0.1)


def test_a_drive_that_does_not_repeat_is_not_taken_as_periodic():
    with pytest.raises(IdentificationError, match="whole periods"):
        find_start(data(DECAYING[:750], recorded(DECAYING)[:750]), initial="periodic")


@pytest.mark.slow
def test_outliers_are_counted_and_leave_the_fit_alone():
    y = recorded(loops(100.0))
    spoilt = y.copy()
    spoilt[40::89] += 3e-6
    clean, robust = (fit_prandtl_ishlinskii(loops(100.0), x, T, linear=("lag",)) for x in (y, spoilt))
    assert clean.numbers.get("outliers", 0) == 0 and robust.numbers["outliers"] == 8  # the first is too early
    assert robust.linear_part.lag == pytest.approx(clean.linear_part.lag, abs=2e-4)
    assert robust.numbers["held_out_rmse_m"] == pytest.approx(clean.numbers["held_out_rmse_m"], rel=0.5)
    error = robust.simulate(DECAYING) - clean.simulate(DECAYING)
    assert np.std(error) < 0.01e-6


def test_flexible_parts_do_not_survive_noise():
    voltage, truth = loops(100.0), recorded(DECAYING, noise=0.0, lag=0.0)
    noisy = recorded(voltage, noise=0.3e-6, lag=0.0)
    found, zones = (
        fit_prandtl_ishlinskii(voltage, noisy, T, linear=(), **options) for options in ({}, {"zone_count": 5})
    )
    errors = [np.std((fit.simulate(DECAYING) - truth)[100:]) for fit in (found, zones)]
    assert "density_decay" in found.numbers and errors[0] < 0.9 * errors[1]


def test_free_weights_survive_where_the_density_is_none_that_falls():
    weights = np.zeros(40)
    weights[[0, 4, 30]] = 60e-9, 20e-9, 20e-9
    two = replace(stack().prandtl_ishlinskii, weights=tuple(weights), thresholds=(), zone_weights=())
    hysteresis = HysteresisParameters(type="prandtl_ishlinskii", prandtl_ishlinskii=two)
    y = hysteresis_block(hysteresis, T).simulate(DECAYING) + 1e-9 * np.random.default_rng(0).standard_normal(800)
    found = fit_prandtl_ishlinskii(DECAYING, y, T, linear=())
    assert "density_decay" not in found.numbers
    assert found.rmse < 0.5 * fit_prandtl_ishlinskii(DECAYING, y, T, linear=(), density="exponential").rmse


def test_plays_and_dead_zones_stand_for_density_and_map():
    condensed = condense(DECAYING, recorded(DECAYING), T, 0)
    fit = SmoothDensity(condensed, 20).fit((), None)
    kernel = hysteresis_block(fit.parameters(), T).simulate(DECAYING)
    assert np.max(np.abs(kernel - fit.output())) < 0.015e-6


def test_decaying_loops_settle_the_density_and_one_major_loop_does_not():
    def decay(voltage, truth):
        y = hysteresis_block(stack(truth), T).simulate(voltage) + 50e-9 * np.random.default_rng(0).standard_normal(800)
        return fit_prandtl_ishlinskii(voltage, y, T, linear=(), density="exponential", skip=100).numbers[
            "density_decay"
        ]

    assert decay(DECAYING, 4.0) == pytest.approx(4.0, abs=0.8)
    assert decay(loops(100.0), 2.4) == PRIOR_DECAY


def test_loops_of_one_size_are_seen():
    sizes = [condense(v, recorded(v), T) for v in (loops(100.0), DECAYING, GROWING)]
    assert [simple_loops(size) for size in sizes] == [True, False, False]


@pytest.mark.slow
def test_what_one_major_loop_cannot_tell_is_said_and_covers_the_truth():
    def doubt(voltage, truth, before=()):
        y = hysteresis_block(stack(truth), T).simulate(np.append(before, voltage))[len(before) :]
        noise = 50e-9 * np.random.default_rng(0).standard_normal(800)
        return identify(data(voltage, y + noise), linear="none")

    one = doubt(loops(100.0), 0.8, before=np.linspace(150.0, 0.0, 50))
    low, high = (one.figures[f"small_loop_gain_{end}_percent"] for end in ("low", "high"))
    small = 50.0 + np.repeat([0.0, -50.0, 50.0, -5.0, 5.0], 50)
    truth, model = (hysteresis_block(law, T).simulate(small) for law in (stack(0.8), one.plant.hysteresis))
    ratio = (truth[-1] - truth[-51]) / (model[-1] - model[-51])
    assert low < 100.0 * (ratio - 1.0) < high and high - low > 5.0
    assert any("decaying" in text and "default" in text for text in one.warnings)
    assert "ambiguity_rms_m" in one.text
    settled = doubt(DECAYING, 0.8)
    assert settled.figures["ambiguity_rms_m"] < 0.4 * one.figures["ambiguity_rms_m"]
    # the first rise from rest tells it, too
    risen = doubt(loops(100.0), 0.8)
    assert risen.figures["skipped"] == 0 and risen.figures["density_decay"] == pytest.approx(0.8, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "remanent"), [(0, False), (12, False), (12, True)])
def test_the_response_of_modes_to_the_first_rise_is_no_remanence(seed, remanent):
    data = synthetic_task(seed).train
    assert wiped_out(data.input) > 0
    if remanent:  # after a movement over half of the range, the first rise from 0 V is about 1 µm lower
        first = wiped_out(data.input)
        data = replace(data, output=data.output + 1.5e-6 * (np.arange(len(data)) < first) * (1 - data.input / 100.0))
    assert (find_start(data).skip == 0) == (not remanent)


@pytest.mark.slow
@pytest.mark.parametrize("remanent", [False, True])
def test_the_first_rise_is_judged_again_when_the_modes_are_known(remanent):
    task = synthetic_task(19)
    data, truth = task.train, task.truth
    first = wiped_out(data.input)
    if remanent:
        data = replace(data, output=data.output + 3.0e-6 * (np.arange(len(data)) < first) * (1 - data.input / 100.0))
    modes = in_series(truth["lag"], [(truth["frequencies"][0], truth["dampings"][0])])
    part = LinearPart(lag=truth["lag"], delay=truth["delay"], modes=modes, hold=data.sample_time)
    assert find_start(data).skip == first  # with a lag alone, a small remanence explains the rise better
    assert rests_behind(data, first, part) == (not remanent)


@pytest.mark.slow
def test_drift_is_a_term_of_its_own_and_only_where_it_is():
    still = recorded(loops(100.0))
    drifting = still + 0.2e-6 * TIME
    without, beside = (identify(data(loops(100.0), y), linear="lag") for y in (still, drifting))
    assert "drift_m_per_s" not in without.figures
    assert beside.figures["drift_m_per_s"] == pytest.approx(0.2e-6, rel=0.02)
    assert beside.figures["rmse_m"] < 0.03e-6
    assert np.std((beside.predicted - drifting)[100:]) < 0.03e-6
    assert beside.plant.offset == pytest.approx(without.plant.offset, abs=0.02e-6)


@pytest.mark.slow
def test_auto_takes_what_predicts_held_out_thirds(monkeypatch):
    tried = ("proportional", "prandtl_ishlinskii")
    monkeypatch.setattr(workflow, "MODELS", {name: MODELS[name] for name in tried})
    identify_once, fitted = workflow.registry.identify, []
    monkeypatch.setattr(
        workflow.registry,
        "identify",
        lambda _, name, **request: fitted.append(name) or identify_once(_, name, **request),
    )
    found = identify(data(DECAYING, recorded(DECAYING)), "auto", linear="none")
    # a line is so far behind on the first third that it is not fitted to the other one
    assert fitted == ["prandtl_ishlinskii", "proportional"] + ["prandtl_ishlinskii"] * 2
    errors = [found.figures[f"held_out_{name}_rmse_m"] for name in tried]
    assert errors[0] > 2.0 * errors[1] and found.figures["model"] == "prandtl_ishlinskii"
    with pytest.raises(IdentificationError, match="auto has no options"):
        parse_options("auto", ["widths=3"])


@pytest.mark.slow
def test_a_remanence_that_fits_no_better_than_rest_is_searched_once(monkeypatch):
    passes = []
    found_voltage = separation.remanent_voltage
    monkeypatch.setattr(separation, "remanent_voltage", lambda *given: passes.append(0) or found_voltage(*given))
    find_start(data(GROWING, recorded(GROWING, (150.0, 0.0))))
    assert len(passes) == 2
    monkeypatch.setattr(separation, "remanent_voltage", lambda *_: passes.append(0) or (100.0, np.inf))
    assert find_start(data(GROWING, recorded(GROWING))).kind == "zero" and len(passes) == 3


@pytest.mark.slow
def test_a_separation_uses_the_play_model_that_was_fitted_before(monkeypatch):
    """The second model of the same data, which has no dynamics of its own, starts no search for them."""
    shared, measured = {}, data(DECAYING, recorded(DECAYING))
    asked = dict(linear="lag,creep", separations=shared)
    workflow.registry.identify(measured, "prandtl_ishlinskii", **asked)
    monkeypatch.setattr(separation, "found_with", lambda *_: pytest.fail("searched again"))
    found = workflow.registry.identify(measured, "polynomial", **asked)
    assert found.chain.hysteresis.type == "polynomial"


@pytest.mark.parametrize("first, blocks", [(1.4, 2), (1.6, 1)])
def test_auto_fits_models_that_are_behind_on_the_first_block_to_one_block_only(monkeypatch, first, blocks):
    """The model that is behind would win on both blocks together, were it fitted to the second one."""
    names, fitted = ("prandtl_ishlinskii", "preisach", "polynomial"), []

    def squares(_, name, part, *__, **request):
        fitted.append((name, part.start))
        late = {"preisach": 1.0, "prandtl_ishlinskii": 5.0, "polynomial": first}[name]
        return np.full(100, (late if part.start == 0 else {"polynomial": 0.1}.get(name, 1.0)) ** 2), 0.0

    monkeypatch.setattr(workflow, "MODELS", {name: MODELS[name] for name in names})
    monkeypatch.setattr(workflow, "held_out_squares", squares)
    chosen, errors = workflow.choose_model(data(DECAYING, recorded(DECAYING)), None)
    assert [name for name, _ in fitted].count("polynomial") == blocks
    assert chosen == ("polynomial" if blocks == 2 else "preisach")
    # the model with the stated prior is always completed, and no model sees the block that it predicts
    assert [name for name, start in fitted if start].count("prandtl_ishlinskii") == 1
    assert errors["polynomial"] == pytest.approx(first if blocks == 1 else np.sqrt((first**2 + 0.01) / 2.0))


def test_held_out_errors_are_those_within_the_range_of_the_fit_without_their_mean(monkeypatch):
    """Fitted from 20 V to 60 V; the held-out samples are at 10 V, 30 V and 70 V, with 2 µm of a constant."""
    voltage = np.concatenate([np.tile([20.0, 60.0], 50), np.repeat([10.0, 30.0, 70.0], 60)])
    error = np.concatenate([np.zeros(100), np.full(60, 1.0), 2e-6 + 3e-9 * (-1.0) ** np.arange(60), np.full(60, 1.0)])
    monkeypatch.setattr(
        workflow.registry, "identify", lambda *_, **__: SimpleNamespace(chain=None, numbers={"ambiguity_rms_m": 4e-9})
    )
    monkeypatch.setattr(workflow, "predict", lambda chain, voltage, step, measured: 1e-7 * voltage)
    whole = data(voltage, 1e-7 * voltage + error)
    squares, ambiguity = workflow.held_out_squares(whole, "preisach", slice(0, 100), slice(100, None))
    np.testing.assert_allclose(squares, np.full(60, 9e-18), rtol=1e-6)
    assert ambiguity == 4e-9


def test_auto_compares_each_model_on_both_ends_of_the_recording_and_drops_those_that_fail(monkeypatch):
    """Each part is two thirds; no model sees what it predicts, nor predicts before the past is wiped out."""
    names, asked = ("prandtl_ishlinskii", "preisach", "polynomial", "bouc_wen", "generalised_play"), []
    whole = data(DECAYING, recorded(DECAYING))
    count, edge, known = len(whole), round(len(whole) / 3), wiped_out(whole.input)
    assert 0 < known < edge

    def squares(given, name, part, rest, **request):
        asked.append((name, part.start, part.stop, *rest.indices(count)[:2]))
        first = part.start == 0
        if (name, first) in (("preisach", True), ("bouc_wen", False)):
            raise IdentificationError("does not fit")
        # too few samples of one model to be compared, and an ambiguity on the first block only
        size = 49 if name == "generalised_play" else 100
        return np.full(size, {"polynomial": 0.9, "prandtl_ishlinskii": 1.0}.get(name, 0.8) ** 2), float(first)

    monkeypatch.setattr(workflow, "MODELS", {name: MODELS[name] for name in names})
    monkeypatch.setattr(workflow, "held_out_squares", squares)
    chosen, errors = workflow.choose_model(whole, None)
    assert set(asked[: len(names)]) == {(name, 0, count - edge, count - edge, count) for name in names}
    assert set(asked[len(names) :]) == {(name, edge, count, known, edge) for name in names if name != "preisach"}
    assert errors == pytest.approx({"prandtl_ishlinskii": 1.0, "polynomial": 0.9})
    assert chosen == "prandtl_ishlinskii", "its ambiguity on one block is enough"


@pytest.mark.parametrize(
    "doubt, other, chosen",
    [(0.0, 0.9, "preisach"), (1e-6, 0.9, "prandtl_ishlinskii"), (1e-6, 0.4, "preisach")],
)
def test_auto_rests_on_the_prior_where_blocks_show_nothing_new(monkeypatch, doubt, other, chosen):
    sizes = {"prandtl_ishlinskii": 1e-7, "preisach": other * 1e-7}
    errors = {name: (np.full(100, size**2), doubt) for name, size in sizes.items()}
    monkeypatch.setattr(workflow, "MODELS", {name: MODELS[name] for name in errors})
    monkeypatch.setattr(workflow, "held_out_squares", lambda _, name, *__, **request: errors[name])
    assert workflow.choose_model(data(DECAYING, recorded(DECAYING)), None)[0] == chosen


def test_the_doubt_of_small_loops_is_a_ratio_of_gains():
    condensed = condense(loops(100.0), hysteresis_block(stack(), T).simulate(loops(100.0)), T, 100)
    one, other = (find_ambiguity(condensed, LinearPart(), stack().scaled(k), True).gain[1] for k in (0.5, 0.25))
    assert other == pytest.approx(2.0 * one, rel=1e-9) and one == pytest.approx(2.0, rel=0.02)


@pytest.mark.parametrize(
    ("sizes", "advice"),
    [
        ((1.0, 1.0, 0.4), "its smallest loop spans 40 % of the range: record decaying loops"),
        ((1.0, 1.0, 0.08), "its small loops are too few or too noisy: record more decaying loops"),
    ],
)
def test_the_advice_for_small_loops_depends_on_those_of_the_recording(sizes, advice):
    voltage = np.concatenate([50.0 + size * (loops(100.0) - 50.0) for size in sizes])
    condensed = condense(voltage, hysteresis_block(stack(), T).simulate(voltage), T, 100)
    found = find_ambiguity(condensed, LinearPart(), stack(), True)
    (text,) = replace(found, error=found.stroke).warnings
    assert advice in text


@pytest.mark.slow
def test_the_ambiguity_of_a_rate_dependent_model_holds_at_the_speed_of_the_recording():
    """The same loops of 1 Hz, sampled at 200 Hz and ten times as fast."""
    plays = GeneralisedPlayParameters(
        radii=tuple(RADII[1:20]), weights=tuple(1e-7 * DENSITY[1:20]), slope=1e-7, rate=0.01, memory=0.05
    )
    chosen, found = HysteresisParameters(type="generalised_play", generalised_play=plays), []
    for step in (T, 0.1 * T):
        voltage = loops(100.0, np.arange(0.0, 4.0, step))
        condensed = condense(voltage, hysteresis_block(chosen, step).simulate(voltage), step, round(1.0 / step))
        found.append(find_ambiguity(condensed, LinearPart(), chosen, True).error)
    assert found[1] == pytest.approx(found[0], rel=0.2)


def test_a_resonance_among_the_harmonics_of_a_sine_is_the_shape_of_the_loops():
    multisine = np.sum([np.sin(2.0 * np.pi * f * TIME + f**2) for f in np.arange(0.25, 10.0, 0.25)], axis=0)
    sine, rich = (TurnSearch(None, v, v, T, ("lag", "modes"), 0) for v in (loops(100.0), multisine))
    assert not sine.excited(4.2) and sine.excited(40.0)
    assert rich.excited(4.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("history", "voltage"), [((40.0, 0.0), DECAYING), ((150.0, 0.0), DECAYING), ((150.0, 10.0), 10.0 + 0.8 * DECAYING)]
)
def test_an_omitted_beginning_that_the_predicted_error_does_not_include_is_stated(history, voltage):
    y = recorded(voltage, history)
    found = identify(data(voltage, y), linear="lag")
    skipped, beginning = found.figures.get("skipped", 0), found.figures.get("beginning_rmse_m", 0.0)
    assert skipped == wiped_out(voltage) and found.figures["predicted_rmse_m"] < 30e-9
    assert beginning == pytest.approx(np.sqrt(np.mean((found.predicted - y)[:skipped] ** 2)), rel=1e-9)
    said = [text for text in found.warnings if "holds after the voltage has been near both ends" in text]
    assert len(said) == 1 and readable(beginning, "m") in said[0]
    assert ("--initial zero" in said[0]) == (voltage[0] == 0.0)


@pytest.mark.slow
def test_a_recording_from_rest_that_is_fitted_from_its_beginning_has_no_such_warning():
    found = identify(data(DECAYING, recorded(DECAYING)), linear="lag")
    assert found.figures.get("skipped", 0) == 0
    assert np.std(found.predicted - recorded(DECAYING)) < 10e-9
    assert "beginning_rmse_m" not in found.figures and not any("near both ends" in text for text in found.warnings)


@pytest.mark.slow
def test_an_omitted_beginning_is_compared_without_the_constant_of_a_free_offset():
    history, v = (40.0, 0.0), DECAYING
    y = recorded(v, history)
    found = identify(data(v, y + 123e-6), linear="lag", offset="free")
    skipped, offset = found.figures["skipped"], found.figures["offset_m"]
    assert offset == pytest.approx(123e-6, abs=1e-6)
    beginning = np.sqrt(np.mean((found.data.output - found.predicted - offset)[:skipped] ** 2))
    assert found.figures["beginning_rmse_m"] == pytest.approx(beginning, rel=1e-9) and beginning < 1e-6


def bursts(*heights):
    """Bursts from 0 V after a rest."""
    one = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(300) / 300)
    return np.concatenate([np.zeros(100), *(height * one for height in heights)])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_virgin_curve_of_polynomials_comes_from_the_first_rise(seed):
    v = bursts(100, 100, 80, 60, 40)
    y = PolynomialHysteresis(assumed_stack(voltage_low=0.0), T).simulate(v)
    noise = 5e-9 * np.random.default_rng(seed).standard_normal(v.size)
    found = identify(data(v, y + noise), "polynomial", linear="none")
    assert "at rest at 0 V" in found.figures["start"]
    assert np.max(np.abs(found.predicted - y)) < 5e-9
