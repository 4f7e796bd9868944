# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Joint learning of all axes of a stage, from run to run, on plants that differ from the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain_stage_support import SAMPLE_TIME, SPIRAL, errors, late_structure, stage

from hysteresis_ros.control.learning import write_learned
from hysteresis_ros.control.uncertainty import Uncertainty
from hysteresis_ros.designs import coupled_learning as learn
from hysteresis_ros.designs.coupled_learning import Belief, CoupledLearning, Loops, applied, possible_loops, trial
from hysteresis_ros.designs.learning import LearningRequest
from hysteresis_ros.errors import ConfigurationError, RecordingError
from hysteresis_ros.loop.stage_response import scanned_paths, stage_response
from hysteresis_ros.loop.stage_simulation import simulate_stage
from hysteresis_ros.models.linear import zero_order_hold
from hysteresis_ros.recordings.dataset import Recording

ANGLES = np.array([1e-3, 0.05, 0.3, 0.44, 0.5, 1.0, 2.5])
CERTAIN = Uncertainty(gain=0.0, hysteresis=0.0, resonance=0.0, delay=0.0, draws=2)


def modal(frequencies, dampings=(0.01, 0.01), crossed=0.04) -> dict:
    """Return a structure of two modes with cross-talk, as values of the section of the stage."""
    A, B, C = np.zeros((2, 2, 2)), np.zeros((4, 2)), np.zeros((2, 4))
    for i, (frequency, damping) in enumerate(zip(frequencies, dampings, strict=True)):
        w = 2.0 * np.pi * frequency
        A[i], held = zero_order_hold([[0.0, w], [-w, -2.0 * damping * w]], [[0.0], [w]], SAMPLE_TIME)
        B[2 * i : 2 * i + 2, i] = held[:, 0]
    C[:, ::2] = [[1.0, crossed], [crossed, 1.0]]
    return {f"structure__{name}": tuple(matrix.ravel()) for name, matrix in (("A", A), ("B", B), ("C", C))}


def with_corrections(learning: CoupledLearning, plant, corrections, folder):
    """Return the plant with the corrections of a run."""
    files = {name: str(folder / f"{name}.yaml") for name in plant.names}
    for name, correction in learning.learned(corrections).items():
        write_learned(files[name], correction)
    chosen = learning.chosen(corrections, files)
    axes = [
        replace(axis, motion_controller=replace(axis.motion_controller, learning=chosen[name]))
        for name, axis in zip(plant.names, plant.axes, strict=True)
    ]
    return replace(plant, axes=tuple(axes))


@pytest.mark.parametrize("structure", [None, late_structure()], ids=["as it is", "zero outside"])
def test_the_loop_of_a_certain_model_is_that_of_the_stage(structure):
    parameters = stage(structure=structure)
    found = possible_loops(parameters, ANGLES, CERTAIN)
    np.testing.assert_allclose(found.mean, stage_response(parameters, ANGLES), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.covariance, np.broadcast_to(learn.UNSEEN**2 * np.eye(2), (7, 2, 2, 2)), atol=1e-12)


def test_slower_modes_are_those_of_a_slower_structure(monkeypatch):
    """A draw in which all times are 5 % longer is a structure whose modes have 5 % lower frequencies."""

    class Slowest:
        def uniform(self, low, high, count):
            return np.full(count, high)

    monkeypatch.setattr(np.random, "default_rng", lambda seed: Slowest())
    found = possible_loops(stage(structure=modal((700.0, 800.0))), ANGLES, replace(CERTAIN, resonance=0.05, draws=1))
    slower = stage_response(stage(structure=modal((700.0 / 1.05, 800.0 / 1.05))), ANGLES)
    # a slower mode of the held structure has another sampling zero, far above the modes
    np.testing.assert_allclose(found.mean[:5], slower[:5], rtol=0.02, atol=2e-3)


def loops_of(mean, deviation: float) -> Loops:
    """Return closed loops whose entries are uncertain by a standard deviation."""
    count = mean.shape[1]
    covariance = np.broadcast_to(deviation**2 * np.eye(count), (*mean.shape, count))
    return Loops(mean.astype(complex), covariance.astype(complex))


def test_runs_teach_a_loop_that_the_model_does_not_know():
    """The model has a phase error of 80 degrees and no coupling; a few runs identify c and T from their excitation."""
    random = np.random.default_rng(3)
    true = np.array([[1.0, 0.4], [-0.3, 0.8]]) * np.exp(1.4j)
    wanted = np.array([1.0 + 0.5j, -0.7j])
    belief, correction, left = None, np.zeros((1, 2), dtype=complex), []
    for _ in range(12):
        noise = 1e-6 * random.normal(size=2)
        error = (wanted - true @ correction[0] + noise)[np.newaxis]
        left.append(np.linalg.norm(error))
        variance = np.full((1, 2), 1e-12) + 1e-4 * np.abs(error) ** 2
        known = correction, error, variance
        loops = loops_of(np.eye(2)[np.newaxis], 1.2)
        belief = Belief.after(loops, *known) if belief is None else belief.given(*known)
        correction = correction + belief.step(correction, np.full((1, 2), 1e-12))
    assert left[-1] < 1e-3 * left[0]
    # with the inverse of the model alone, learning does not converge on such a loop
    assert np.max(np.abs(np.linalg.eigvals(np.eye(2) - true))) > 1.0


def test_the_first_step_is_norm_optimal():
    """Without runs the weight on the change is the covariance of the loop: M = (T* T + n s² I)⁻¹ T* E."""
    mean = np.array([[[0.9, 0.2j], [0.1, 0.7]]])
    error = np.array([[1.0, 0.5j]])
    given = np.array([[0.3, -0.2j]])
    belief = Belief.after(loops_of(mean, 0.3), given, error, np.zeros((1, 2)))
    expected = np.linalg.solve(mean[0].conj().T @ mean[0] + 2 * 0.3**2 * np.eye(2), mean[0].conj().T @ error[0])
    np.testing.assert_allclose(belief.step(given, np.zeros((1, 2)))[0], expected, rtol=1e-12)
    # an error that may be noise is not corrected
    np.testing.assert_array_equal(belief.step(given, np.full((1, 2), 1.0)), 0.0)


@pytest.mark.slow
def test_axes_learn_together_what_the_model_does_not_have(tmp_path):
    """Compared with the model the plant has 3 % lower modes, 8 % more gain and twice the cross-talk."""
    model = stage(*SPIRAL, structure=modal((700.0, 800.0)))
    wrong = modal((679.0, 776.0), crossed=0.08)
    wrong["structure__C"] = tuple(1.08 * np.array(wrong["structure__C"]))
    plant = stage(*SPIRAL, structure=wrong)
    learning = CoupledLearning.of(model, LearningRequest("coupled", maximum=20e-6))
    runs, corrections, left = [], learning.after([]), [np.max(np.abs(errors(plant)))]
    for _ in range(4):
        now = with_corrections(learning, plant, corrections, tmp_path)
        run = simulate_stage(now, duration=3.0 * model.scan.period)
        left.append(np.max(np.abs(run["x/reference"] - run["x/displacement"])[-2500:]))
        runs.append(trial(model, run, applied(now)))
        corrections = learning.after(runs)
    assert left[1] < 0.2 * left[0], "the inverse of the model reduces the error"
    assert left[2] < 0.2 * left[1], "and a run reduces it further"
    assert left[4] < 0.01 * left[1]


def test_a_run_that_begins_at_rest_is_judged_from_the_first_whole_period_of_its_scan_on():
    """At 0.15 mm/s the way to the middle takes longer than the period of 0.125 s."""
    parameters = stage(*SPIRAL)
    slow = {"maximum_velocity": 1.5e-4, "maximum_acceleration": 0.0, "maximum_jerk": 0.0, "from_rest": True}
    axes = []
    for axis in parameters.axes:
        own = axis.reference_generator
        axes.append(replace(axis, reference_generator=replace(own, approach=replace(own.approach, **slow))))
    parameters = replace(parameters, axes=tuple(axes))
    period = round(parameters.scan.period * parameters.sample_rate)
    run = simulate_stage(parameters, duration=4.0 * parameters.scan.period)
    found = trial(parameters, run, np.zeros((2, period)))
    for place, name in enumerate(parameters.names):
        error = (run[f"{name}/reference"] - run[f"{name}/measured"]).reshape(4, period)[2:]
        np.testing.assert_allclose(found.error[place], error.mean(axis=0), atol=1e-9)
    short = simulate_stage(parameters, duration=3.0 * parameters.scan.period)
    with pytest.raises(RecordingError, match="differs from the configured scan"):
        trial(parameters, short, np.zeros((2, period)))


@pytest.mark.parametrize("late", ["x", "y"])
def test_periods_of_a_run_count_from_where_every_axis_follows_its_scan(late):
    """One axis needs two periods from rest, the other one; then the error of period j is j nm."""
    parameters = stage(*SPIRAL)
    axes = []
    for axis in parameters.axes:
        own = axis.reference_generator
        axes.append(replace(axis, reference_generator=replace(own, approach=replace(own.approach, from_rest=True))))
    resting = replace(parameters, axes=tuple(axes))
    paths = scanned_paths(parameters)
    period, none = paths.shape[1], np.zeros(paths.shape)

    def run(count, away):
        """Return a run whose reference is 0.1 µm below the scan in some periods."""
        signals = {}
        for name, axis, path in zip(parameters.names, parameters.axes, paths, strict=True):
            table = np.tile(axis.generator.initial_setpoint + path, (count, 1))
            table[away[name]] -= 1e-7
            signals[f"{name}/reference"] = table.ravel()
            signals[f"{name}/measured"] = (table - 1e-9 * np.arange(count)[:, np.newaxis]).ravel()
        time = np.arange(count * period) / parameters.sample_rate
        return Recording(time, signals, dict.fromkeys(signals, "m"))

    away = {name: [0, 1] if name == late else [0] for name in parameters.names}
    np.testing.assert_allclose(trial(resting, run(6, away), none).error, 3.5e-9, rtol=1e-6)
    refused = (
        (resting, run(3, away)),  # one whole period is left
        (parameters, run(6, away)),  # it does not begin at rest
        (resting, run(6, away | {late: [0, 1, 4]})),
    )
    for given, short in refused:
        with pytest.raises(RecordingError, match=f"{late}/reference differs from the configured scan"):
            trial(given, short, none)


def test_samples_without_a_measurement_are_omitted_from_the_average_of_the_periods():
    parameters = stage(*SPIRAL)
    period = round(parameters.scan.period * parameters.sample_rate)
    run, none = simulate_stage(parameters, duration=4.0 * parameters.scan.period), np.zeros((2, period))
    noisy = run["y/measured"] + np.random.default_rng(5).normal(scale=1e-9, size=len(run))

    def without(*lost):
        """Return the result of the run without measurements of y at some samples."""
        measured = noisy.copy()
        measured[list(lost)] = np.nan
        return trial(parameters, Recording(run.time, run.signals | {"y/measured": measured}, run.units), none)

    # the same sample of two of the three periods after the first, and two neighbours
    lost = (period + 70, 2 * period + 70, 3 * period + 200, 3 * period + 201)
    found, whole = without(*lost), without()
    np.testing.assert_array_equal(found.missing, [0, 4])
    np.testing.assert_array_equal(whole.missing, 0)
    errors_of_y = (run["y/reference"] - noisy).reshape(4, period)
    assert found.error[1, 70] == pytest.approx(errors_of_y[3, 70], abs=1e-15)
    assert found.error[1, 200] == pytest.approx(errors_of_y[1:3, 200].mean(), abs=1e-15)
    kept = np.delete(np.arange(period), [70, 200, 201])
    np.testing.assert_array_equal(found.error[1, kept], whole.error[1, kept])
    np.testing.assert_array_equal(found.error[0], whole.error[0])
    np.testing.assert_allclose(found.variance[1], whole.variance[1], rtol=0.1)
    rows = learn.trial_lines(parameters, [found])
    assert "omitted" not in rows[0] and rows[1].endswith("; 4 samples without a measurement are omitted")
    count = int(0.03 * period) + 1
    text = (
        f"y/measured: {count} of {3 * period} samples after the first {period} .* first at 0.13 s: must be 1 % or less"
    )
    with pytest.raises(RecordingError, match=text):
        without(*range(period + 50, period + 50 + count))
    with pytest.raises(RecordingError, match=r"y/measured: 1 samples .* any of 3 periods, the first 0.007 s after"):
        without(*(70 + place * period for place in (1, 2, 3)))


def test_what_cannot_be_learned_together_is_said(tmp_path):
    parameters = stage(*SPIRAL)
    learning = CoupledLearning.of(parameters, LearningRequest("coupled", bandwidth=200.0))
    assert learning.places[-1] == 25, "200 Hz of 8 Hz"
    short = simulate_stage(parameters, duration=2.5 * parameters.scan.period)
    with pytest.raises(RecordingError, match=r"has 2\.5 periods of the scan: must be 3 or more"):
        trial(parameters, short, np.zeros_like(learning.paths))
    with pytest.raises(ConfigurationError, match="needs corrections of .* give a larger --maximum"):
        learning.chosen(np.full_like(learning.paths, 1e-3), {})
    other = stage("lissajous", ("width=16um", "depth=8um", "lines=5", "frame_rate=16Hz"))
    run = simulate_stage(other, duration=4.0 * other.scan.period)
    with pytest.raises(RecordingError, match="differs from the configured scan"):
        trial(parameters, run, np.zeros_like(learning.paths))
    with pytest.raises(ConfigurationError, match=r"--bandwidth 9000: must be 8 … 5000 Hz"):
        CoupledLearning.of(parameters, LearningRequest("coupled", bandwidth=9000.0))
