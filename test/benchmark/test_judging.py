# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a model of anyone may do in the benchmark, and that its figures are true."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.laboratory.benchmark import models
from hysteresis_ros.laboratory.benchmark.judging import interval, run
from hysteresis_ros.laboratory.benchmark.manifest import Task
from hysteresis_ros.laboratory.benchmark.models import load_model
from hysteresis_ros.laboratory.benchmark.synthetic import synthetic_task

#: Models of a user, one mistake each.
MODELS = '''
import numpy as np

class Exact:
    """Knows the law 2 u + 1; counts what it is given."""
    parameter_count = 2
    def fit(self, data):
        assert sorted(vars(data)) == sorted(type(data).__dataclass_fields__)
        self.seen = len(data)
        return self
    def predict(self, input):
        return 2.0 * input + 1.0

class Off(Exact):
    def predict(self, input):
        return 2.0 * input + 4.0

class Ahead(Exact):
    """Averages over the whole input."""
    def predict(self, input):
        return 2.0 * input + 1.0 + 1e-3 * np.mean(input)

class Broken(Exact):
    def fit(self, data):
        raise RuntimeError("no licence")

class Short(Exact):
    def predict(self, input):
        return input[1:]

class Holes(Exact):
    def predict(self, input):
        found = 2.0 * input
        found[7] = np.nan
        return found

class Writer(Exact):
    """Changes the arrays that it is given."""
    def predict(self, input):
        found = 2.0 * input + 1.0
        input[:] = 0.0
        return found

class Unfit:
    pass
'''


@pytest.fixture(name="task", scope="module")
def _task() -> Task:
    """A linear law with white noise of 0.1, judged from sample 100 on."""
    random = np.random.default_rng(3)
    u = 5.0 * np.sin(np.arange(2000) / 30.0)
    y = 2.0 * u + 1.0 + 0.1 * random.standard_normal(2000)
    time = 1e-3 * np.arange(2000)
    data = IdentificationData(time, u, y)
    return Task("law", data.part(0, 900), IdentificationData(time, u, y), 1000)


@pytest.fixture(name="file", scope="module")
def _file(tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "mine.py"
    path.write_text(MODELS)
    return path


def test_an_exact_model_has_the_error_of_the_noise(task, file):
    """0.1 within its interval, and the figures of the row are those of the samples from ``first`` on."""
    (row,) = run([task], [f"{file}:Exact"], workers=1)
    noise = task.test.output - 2.0 * task.test.input - 1.0
    assert row.error == pytest.approx(np.sqrt(np.mean(noise[1000:] ** 2)), rel=1e-12)
    assert row.maximum == pytest.approx(np.max(np.abs(noise[1000:])), rel=1e-12)
    assert row.low < 0.1 < row.high and row.high - row.low < 0.02
    assert row.stroke == pytest.approx(np.ptp(task.test.output[1000:]))
    assert row.parameters == 2 and not row.problem


def test_a_constant_counts_unless_the_sensor_has_no_zero(task, file):
    """3 beside 0.1 of noise, and nothing of it with ``offset: free``."""
    (kept,) = run([task], [f"{file}:Off"], workers=1)
    free = Task(task.name, task.train, task.test, task.first, "free")
    (without,) = run([free], [f"{file}:Off"], workers=1)
    assert kept.error == pytest.approx(3.0, rel=1e-2) and without.error == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("Ahead", "uses later inputs"),
        ("Broken", "failed: RuntimeError: no licence"),
        ("Short", "predicts an array of shape"),
        ("Holes", "predicts nan at sample 7"),
    ],
)
def test_what_a_model_does_wrong_is_named_in_its_row(task, file, name, told):
    """The other models are not affected, and come first."""
    rows = run([task], [f"{file}:{name}", f"{file}:Exact"], workers=1)
    assert [row.model.rpartition(":")[2] for row in rows] == ["Exact", name]
    assert told in rows[1].problem and not rows[0].problem


def test_a_model_cannot_change_what_it_is_judged_on(task, file):
    """It writes into its arguments; the error remains that of the noise."""
    before = task.test.input.copy()
    (row,) = run([task], [f"{file}:Writer"], workers=1)
    assert row.error == pytest.approx(0.1, rel=0.1) and np.array_equal(task.test.input, before)


@pytest.mark.parametrize("spec", ["Unfit", "Missing"])
def test_a_class_that_is_no_model_is_refused_at_once(task, file, spec):
    """Before anything is fitted."""
    with pytest.raises(HysteresisError, match=f"mine.py:{spec}"):
        run([task], [f"{file}:{spec}"], workers=1)


def test_an_unknown_model_is_refused_with_the_known_ones():
    """And with the nearest name."""
    with pytest.raises(HysteresisError, match="classical_pi.*did you mean narx"):
        load_model("narxx")


@pytest.mark.slow
def test_processes_give_the_rows_of_one_process(task, file):
    """Fits and predictions in worker processes are the same numbers."""
    specs = ["line", f"{file}:Exact"]
    here, there = (run([task], specs, workers=count) for count in (1, 2))
    assert [(row.model, row.error, row.low, row.high) for row in here] == [
        (row.model, row.error, row.low, row.high) for row in there
    ]


@pytest.mark.slow
@pytest.mark.parametrize("memory", [0.0, 0.95])
def test_the_interval_holds_the_true_error(memory):
    """95 % of 200 seeds, also where neighbouring errors resemble each other (by counting: 88 … 99 % pass)."""
    hits = 0
    for seed in range(200):
        random = np.random.default_rng(seed)
        error = scipy.signal.lfilter([1.0], [1.0, -memory], random.standard_normal(4000))
        low, high = interval(error[200:])
        hits += low <= np.sqrt(1.0 / (1.0 - memory**2)) <= high
    assert 176 <= hits <= 198


def test_the_gradient_of_the_recurrent_unit_is_that_of_its_error():
    """By differences of the mean square error after the warm-up, for some weights of each array."""
    random = np.random.default_rng(0)
    unit = models.GatedRecurrentUnit()
    size, units = 3 * models.UNITS, models.UNITS
    shapes = ((2, size), (units, size), (size,), (units,), (2,))
    unit.weights = [0.5 * random.standard_normal(shape) for shape in shapes]
    x, target, warm = random.standard_normal((12, 3, 2)), random.standard_normal((12, 3)), 4

    def error() -> float:
        h, found = np.zeros((3, units)), []
        for k in range(12):
            *_, h = unit._step(x[k], h)
            found.append(h @ unit.weights[3] + unit.weights[4][0] * x[k, :, 0] + unit.weights[4][1] - target[k])
        return float(np.mean(np.array(found)[warm:] ** 2))

    gradients = unit._gradients(x, target, warm)
    for weight, gradient in zip(unit.weights, gradients, strict=True):
        for place in random.choice(weight.size, min(6, weight.size), replace=False):
            at = np.unravel_index(place, weight.shape)
            before, ends = weight[at], []
            for change in (1e-6, -1e-6):
                weight[at] = before + change
                ends.append(error())
            weight[at] = before
            assert gradient[at] == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-4, abs=1e-8)


def hysteretic(samples: int, seed: int) -> IdentificationData:
    """Return loops of three plays with weights 1, 0.5 and 2, and the constant 3, without noise."""
    random = np.random.default_rng(seed)
    corners = np.arange(0, samples + 40, 40)
    u = np.interp(np.arange(samples), corners, 10.0 * random.uniform(-1, 1, len(corners)))
    u[0] = 0.0
    y = models.plays(u, np.array([0.0, 2.0, 4.0])) @ np.array([1.0, 0.5, 2.0]) + 3.0
    return IdentificationData(1e-3 * np.arange(samples), u, y)


@pytest.mark.slow
@pytest.mark.parametrize(("model", "largest"), [("classical_pi", 0.02), ("narx", 0.2), ("gru", 0.12), ("line", 0.5)])
def test_the_simple_models_learn_loops(model, largest):
    """Error on other loops, as a fraction of the standard deviation; play operators are learned to 2 %."""
    train, test = hysteretic(3000, 1), hysteretic(1500, 2)
    (row,) = run([Task("plays", train, test, 100)], [model], workers=1)
    assert not row.problem and row.error < largest * np.std(test.output)


def test_a_play_is_learned_with_either_sign():
    """An output that falls with rising input has the same error as one that rises."""
    train, test = hysteretic(2000, 1), hysteretic(1000, 2)
    fallen = [IdentificationData(one.time, one.input, -one.output) for one in (train, test)]
    rows = [run([Task("t", *pair, 100)], ["classical_pi"], workers=1)[0] for pair in ((train, test), tuple(fallen))]
    assert rows[0].error == pytest.approx(rows[1].error, rel=1e-6)


@pytest.mark.slow
def test_a_synthetic_test_is_without_noise_and_of_another_input():
    """Equal seeds give equal plants; the truth is published; the test has no noise."""
    task, again, quiet = synthetic_task(1), synthetic_task(1), synthetic_task(1, noise=0.0)
    assert np.array_equal(task.train.output, again.train.output)
    assert np.array_equal(task.test.output, quiet.test.output)
    assert np.std(task.train.output - quiet.train.output) == pytest.approx(5e-9, rel=0.1)
    assert task.truth["hysteresis"] and task.truth["seed"] == 1 and len(task.truth["frequencies"]) == 2
    assert np.min(task.test.input) >= 0.0 and np.max(task.test.input) <= 100.0
