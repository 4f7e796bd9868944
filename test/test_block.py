# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The block machinery: kernels with and without Numba, composites, state, and validity of the cache."""

import os
import pathlib
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models import block
from hysteresis_ros.models.block import Block, compiled, composite, interpreted, kernel, nested, run_kernel

if block.COMPILED:
    from numba.core import event

PACKAGE = pathlib.Path(block.__file__).parents[1]


@kernel
def leak(p, x, u):
    """First-order lag x⁺ = a x + (1 - a) u."""
    x[0] = p[0] * x[0] + (1.0 - p[0]) * u
    return x[0]


@dataclass(frozen=True)
class LagParameters(Parameters):
    a: float = parameter(0.5, low=0.0, high=1.0, description="pole")


class Lag(Block):
    kernel = staticmethod(leak)

    def pack(self, parameters):
        return np.array([parameters.a])


def test_simulate_is_step_after_step_and_follows_the_closed_form():
    one, many = Lag(LagParameters(0.8), 1.0), Lag(LagParameters(0.8), 1.0)
    u = np.ones(40)
    y = many.simulate(u)
    np.testing.assert_array_equal([one.step(value) for value in u], y)
    np.testing.assert_allclose(y, 1.0 - 0.8 ** np.arange(1, 41), rtol=1e-13)


def test_state_is_saved_restored_and_reset_exactly():
    lag = Lag(LagParameters(), 1.0)
    lag.simulate(np.arange(5.0))
    kept = lag.state
    expected = lag.simulate(np.arange(3.0))
    lag.state = kept
    np.testing.assert_array_equal(lag.simulate(np.arange(3.0)), expected)
    assert lag.state is not lag.x
    lag.reset()
    np.testing.assert_array_equal(lag.x, [0.0])


def test_retune_takes_all_or_nothing():
    lag = Lag(LagParameters(0.5), 1.0)
    with pytest.raises(ParameterError, match=r"a = 2.0: out of range.*0 … 1"):
        lag.retune(LagParameters(2.0))
    assert lag.p[0] == 0.5
    lag.retune(LagParameters(0.25))
    assert lag.p[0] == 0.25


def test_compiled_and_interpreted_forms_agree_bit_for_bit():
    u = np.random.default_rng(1).normal(size=300)
    results = []
    for form, function in ((compiled, leak), (interpreted, interpreted(leak))):
        y, x = np.empty_like(u), np.zeros(1)
        form(run_kernel)(function, np.array([0.9]), x, u, y)
        results.append(y)
    np.testing.assert_array_equal(*results)


@kernel
def scaled(p, place, u):
    """A kernel that is named in another one, with numbers in the call."""
    return p[place] * u


@kernel
def both(p, x, u):
    """A kernel that names another one twice."""
    return scaled(p, 0, u) + scaled(p, 1, u)


@nested
def lagged(p, x, u):
    """A level between a composite and its kernels."""
    return leak(p, x, both(p, x, u))


@composite("void", "array", "array", "array", "array")
def lag_all(p, x, u, y):
    """The composite."""
    for k in range(u.shape[0]):
        y[k] = lagged(p, x, u[k])


def lag_result(form):
    p, x, u = np.array([0.7, 0.2]), np.zeros(1), np.arange(1.0, 9.0)
    y = np.empty_like(u)
    form(lag_all)(p, x, u, y)
    return y.tolist()


@pytest.mark.slow
@pytest.mark.skipif(not block.COMPILED, reason="Numba is not installed: nothing is compiled")
def test_what_compiled_code_names_is_compiled_once_and_not_for_python(monkeypatch):
    monkeypatch.setitem(block._OPTIONS, "cache", False)
    started = []

    class Listener(event.Listener):
        def on_start(self, happened):
            started.append(happened.data["dispatcher"].py_func.__name__)

        def on_end(self, happened):
            pass

    with event.install_listener("numba:compile", Listener()):
        result = lag_result(compiled)
    # one compiled form for both numbers, none of the level between, none that Python could call
    assert sorted(started) == ["both", "lag_all", "leak", "scaled"]
    assert not scaled.signatures and not both.signatures
    assert result == lag_result(interpreted)
    assert scaled(np.array([2.0, 3.0]), 1, 5.0) == 15.0 and scaled.signatures


@pytest.mark.slow
@pytest.mark.skipif(not block.COMPILED, reason="Numba is not installed: nothing is compiled")
def test_a_numba_that_copies_no_functions_compiles_the_levels_between(monkeypatch):
    expected = lag_result(interpreted)
    monkeypatch.delattr(lagged, "targetoptions")
    monkeypatch.delitem(block._compiled, lag_all, raising=False)
    monkeypatch.setitem(block._OPTIONS, "cache", False)
    assert lag_result(compiled) == expected


def test_a_block_that_packs_nothing_says_so():
    with pytest.raises(TypeError, match="Empty does not define pack"):
        type("Empty", (Block,), {"kernel": staticmethod(leak)})(LagParameters(), 1.0)


def test_every_kernel_stands_in_a_folder_whose_sources_name_the_cache():
    for path in PACKAGE.rglob("*.py"):
        if path.relative_to(PACKAGE).parts[0] in ("laboratory", "identification"):
            continue  # only their own file calls these kernels (Numba checks it); sources of models name the cache
        text = path.read_text(encoding="utf-8")
        if any(f"\n@{mark}" in text for mark in ("kernel", "composite", "called", "nested")):
            folder = next(iter(path.parent.relative_to(PACKAGE).parts), ".")  # sub-folders count with theirs
            assert folder in block.KERNEL_FOLDERS, f"{path}: add its folder to KERNEL_FOLDERS"


def child(code: str, **variables) -> str:
    answer = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **variables}, capture_output=True, text=True, check=True
    )
    return answer.stdout.strip()


#: Modules for which SciPy's linear algebra is imported, and modules for which it is not.
WITH_BLAS = """
import numba, numpy
print("scipy.linalg" in sys.modules)
product = numba.njit(lambda matrix, vector: matrix @ vector)
print(product(numpy.array([[1.0, 2.0], [3.0, 4.0]]), numpy.array([1.0, 2.0])).tolist())
print("scipy.linalg" in sys.modules)
"""


@pytest.mark.slow
def test_everything_runs_without_numba():
    code = """
import sys
sys.modules["numba"] = None
from hysteresis_ros.models import block
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
run = simulate(single_axis(load_configuration("kim2009")), duration=0.02)
print(block.COMPILED, run.time.size, float(run["displacement"][-1]).hex())
"""
    plain = child(code).split()
    fast = child(code.replace('sys.modules["numba"] = None', "") + WITH_BLAS * block.COMPILED).split()
    assert plain[:2] == ["False", "60"]
    if block.COMPILED:
        # none of it is needed to compile and to run an axis; a kernel that multiplies matrices imports it
        assert fast[3:] == ["False", "[5.0,", "11.0]", "True"]
    # if the last bits differ, the converter may output the next step
    assert float.fromhex(plain[2]) == pytest.approx(float.fromhex(fast[2]), abs=1e-9)


@pytest.mark.slow
@pytest.mark.skipif(not block.COMPILED, reason="Numba is not installed: nothing is cached")
def test_old_caches_are_removed_and_recent_ones_kept(tmp_path):
    root = tmp_path / "hysteresis_ros"
    for name, age in (("old", 40), ("recent", 2)):
        (root / name).mkdir(parents=True)
        stamp = (root / name).stat().st_mtime - age * 86400
        os.utime(root / name, (stamp, stamp))
    child("import hysteresis_ros.models.limits", XDG_CACHE_HOME=str(tmp_path), NUMBA_CACHE_DIR="")
    assert not (root / "old").exists() and (root / "recent").exists()


def _double(values):
    for i in range(values.shape[0]):
        values[i] *= 2.0


@pytest.mark.skipif(not block.COMPILED, reason="Numba is not installed: everything is interpreted")
def test_few_samples_are_interpreted_and_many_or_cached_ones_compiled(monkeypatch, tmp_path):
    values = np.ones(3)

    def run(samples: int):
        return block.specialised_for(samples, _double, values)

    for name in ("_compiled", "_interpreted"):
        monkeypatch.setattr(block, name, {})
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert run(block.INTERPRETED - 2) is _double and run(1) is _double
    machine_code = run(1)
    assert machine_code is not _double and machine_code is run(1)
    machine_code(values)
    assert values.tolist() == [2.0, 2.0, 2.0]
    assert machine_code.targetoptions["nogil"], "a loop with a driver in Python would wait for each such call"
    # another process, which finds the kernel in the cache
    for name in ("_compiled", "_interpreted"):
        monkeypatch.setattr(block, name, {})
    assert run(1) is not _double
