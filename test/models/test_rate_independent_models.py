"""What every hysteresis model keeps to: no memory of speed, continuity, exact states, equivariance, return points."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hysteresis_ros.block import COMPILED
from hysteresis_ros.errors import ParameterError
from hysteresis_ros.models.bouc_wen import BoucWenHysteresis, BoucWenParameters
from hysteresis_ros.models.duhem import DuhemHysteresis, DuhemParameters
from hysteresis_ros.models.hysteresis import HYSTERESIS_BLOCKS, HysteresisParameters, hysteresis_block
from hysteresis_ros.models.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis, PrandtlIshlinskiiParameters
from hysteresis_ros.models.preisach import PreisachHysteresis, PreisachParameters, everett_of

STROKE = 12e-6
KNOTS = np.linspace(-1.0, 1.0, 9)


def bouc_wen(scale=1.0, exponent=1.0):
    size = (8e-6 * scale) ** (exponent - 1.0)
    return BoucWenParameters(
        d_e=0.16e-6 * scale, alpha=0.05e-6 * scale, beta=6e-3 / size, gamma=4e-3 / size, exponent=exponent
    )


def duhem(scale=1.0, shape="network"):
    weights = (1.5, 1.2, 0.3, -0.4, 0.5, 0.4, 0.02), (1.0, -1.0, 0.9, 0.9, 0.05, 0.05, 0.8)
    splines = tuple(0.95 * KNOTS + 0.03 * KNOTS**3), tuple(0.85 + 0.1 * KNOTS**2)
    return DuhemParameters(
        alpha=0.04,
        input_low=0.0,
        input_high=120.0,
        output_low=0.0,
        output_high=STROKE * scale,
        output_start=0.1e-6 * scale,
        shape=shape,
        f_network=weights[0],
        g_network=weights[1],
        f_spline=splines[0],
        g_spline=splines[1],
    )


def prandtl_ishlinskii(scale=1.0):
    return PrandtlIshlinskiiParameters(
        radii=tuple(6.0 * np.arange(8)),
        weights=tuple(scale * np.array([60e-9, 9e-9, 7e-9, 6e-9, 5e-9, 4e-9, 3e-9, 2e-9])),
        thresholds=tuple(scale * np.array([2e-6, 6e-6, -1e-6])),
        zone_weights=(0.1, -0.3, 0.2),
        offset=0.2e-6 * scale,
    )


def preisach(scale=1.0):
    block = PrandtlIshlinskiiHysteresis(prandtl_ishlinskii(scale), 1e-3)
    return PreisachParameters(
        voltage_low=-40.0, voltage_high=160.0, everett=tuple(everett_of(block, -40.0, 160.0, 21)), offset=-3e-6 * scale
    )


MODELS = {
    "bouc_wen": (BoucWenHysteresis, bouc_wen),
    "bouc_wen_squared": (BoucWenHysteresis, lambda scale=1.0: bouc_wen(scale, exponent=2.0)),
    "duhem_network": (DuhemHysteresis, duhem),
    "duhem_spline": (DuhemHysteresis, lambda scale=1.0: duhem(scale, "spline")),
    "prandtl_ishlinskii": (PrandtlIshlinskiiHysteresis, prandtl_ishlinskii),
    "preisach": (PreisachHysteresis, preisach),
}
WITH_RETURN_POINTS = ("prandtl_ishlinskii", "preisach")
voltages = st.lists(st.floats(-40.0, 160.0), min_size=1, max_size=10)
names = pytest.mark.parametrize("name", MODELS)


def built(name, scale=1.0):
    cls, parameters = MODELS[name]
    return cls(parameters(scale), 1e-3)


def ramps(turns, points):
    turns = [0.0, *turns]
    return np.concatenate([np.linspace(a, b, points + 1)[1:] for a, b in zip(turns, turns[1:], strict=False)])


def walked(name, turns, points=1):
    block = built(name)
    block.simulate(ramps(turns, points))
    return block


@names
@settings(max_examples=30)
@given(turns=voltages, points=st.integers(2, 60))
def test_output_does_not_depend_on_the_number_of_steps(name, turns, points):
    tolerance = 1e-6 if name == "bouc_wen_squared" else 1e-9
    one, many = walked(name, turns), walked(name, turns, points)
    np.testing.assert_allclose(many.x[1], one.x[1], rtol=0.0, atol=tolerance * STROKE)


@names
@settings(max_examples=30)
@given(turns=voltages, side=st.sampled_from([-1e-7, 1e-7]))
def test_output_is_continuous_at_reversals(name, turns, side):
    block = walked(name, turns)
    before = block.x[1]
    assert abs(block.step(turns[-1] + side) - before) < 1e-6 * 0.3e-6


@names
@settings(max_examples=30)
@given(turns=voltages, ahead=voltages)
def test_state_is_restored_exactly(name, turns, ahead):
    block = walked(name, turns)
    kept = block.state
    expected = block.simulate(ahead)
    block.state = kept
    np.testing.assert_array_equal(block.simulate(ahead), expected)
    block.reset()
    np.testing.assert_array_equal(block.simulate(ramps(turns, 1)), built(name).simulate(ramps(turns, 1)))


@names
@settings(max_examples=30)
@given(turns=voltages, scale=st.sampled_from([0.01, 3.0, 1e3]))
def test_outputs_scale_with_the_parameters(name, turns, scale):
    plain, scaled = built(name).simulate(turns), built(name, scale).simulate(turns)
    np.testing.assert_allclose(scaled, scale * plain, rtol=1e-9, atol=1e-9 * scale * STROKE)


@names
@settings(max_examples=30)
@given(turns=voltages, change=st.floats(0.9, 1.1))
def test_new_parameters_do_not_move_the_output(name, turns, change):
    block = walked(name, turns)
    before, voltage = float(block.x[1]), float(block.x[0])
    block.retune(MODELS[name][1](change))
    assert block.step(voltage) == before
    assert block.step(voltage + 1e-7) == pytest.approx(before, abs=1e-6 * 0.3e-6)
    assert block.step(voltage - 1e-7) == pytest.approx(before, abs=1e-6 * 0.3e-6)
    assert np.all(np.isfinite(block.simulate(ramps([150.0, -30.0, 100.0], 20))))


@names
def test_nan_holds(name):
    block = walked(name, [80.0, 30.0])
    kept = block.state
    assert block.step(float("nan")) == kept[1]
    np.testing.assert_array_equal(block.x, kept)


@names
def test_loops_are_open_and_rise(name):
    block = walked(name, [120.0, 0.0])
    up, down = block.simulate(ramps([120.0], 50)), block.simulate(np.linspace(120.0, 0.0, 51)[1:])
    assert np.all(np.diff(up) > 0.0) and np.all(np.diff(down) < 0.0)
    assert 0.03 < (down[24] - up[24]) / (up[-1] - down[-1]) < 0.5


@pytest.mark.parametrize("name", WITH_RETURN_POINTS)
@settings(max_examples=50)
@given(turns=voltages, inner=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=6), ahead=voltages)
def test_minor_loops_close_and_are_forgotten(name, turns, inner, ahead):
    """Coming back to a turning point gives the output there, and the future is that without the loop."""
    last, before = turns[-1], ([0.0, *turns])[-2]
    # excursions between the last two turning points, which must not wipe out anything older
    excursion = [last + share * (before - last) for share in inner]
    straight, around = walked(name, turns), walked(name, turns)
    returned = around.simulate([*excursion, last])[-1] if before != last else straight.x[1]
    assert returned == pytest.approx(straight.x[1], abs=1e-12 * STROKE)
    np.testing.assert_allclose(around.simulate(ahead), straight.simulate(ahead), rtol=0.0, atol=1e-11 * STROKE)


@pytest.mark.parametrize("name", WITH_RETURN_POINTS)
@settings(max_examples=30)
@given(turns=voltages, ahead=voltages)
def test_a_larger_peak_wipes_out_the_past(name, turns, ahead):
    one, other = built(name), built(name)
    for block, past in ((one, turns), (other, [])):
        block.simulate([-40.0, *past, 160.0, -40.0])
    np.testing.assert_allclose(one.simulate(ahead), other.simulate(ahead), rtol=0.0, atol=1e-11 * STROKE)


def test_every_type_is_built_by_name_and_refuses_another_structure():
    groups = {
        "bouc_wen": bouc_wen(),
        "duhem": duhem(),
        "prandtl_ishlinskii": prandtl_ishlinskii(),
        "preisach": preisach(),
    }
    for kind, given_parameters in groups.items():
        parameters = HysteresisParameters(type=kind, **{kind: given_parameters})
        block = hysteresis_block(parameters, 1e-3)
        assert type(block) is HYSTERESIS_BLOCKS[kind]
        again = HysteresisParameters.from_mapping(parameters.to_mapping())
        assert again == parameters
        assert 0.5e-7 < block.gain < 2e-7
    fewer = dataclasses.replace(prandtl_ishlinskii(), radii=(0.0, 5.0), weights=(1e-8, 1e-8))
    block = built("prandtl_ishlinskii")
    with pytest.raises(ParameterError, match=r"radii = 2.*keep 8"):
        block.retune(fewer)


SCRIPT = """
import sys
import numpy as np
sys.path[:0] = {path!r}
from test_rate_independent_models import outputs
np.save(sys.argv[1], outputs())
"""


def outputs():
    rng = np.random.default_rng(5)
    wave = ramps(rng.uniform(-40.0, 160.0, 12), 9)
    return np.array([built(name).simulate(wave) for name in MODELS])


@pytest.mark.skipif(not COMPILED, reason="kernels are interpreted already")
def test_compiled_models_equal_interpreted_ones(tmp_path):
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    script = SCRIPT.format(path=[os.path.dirname(__file__), *sys.path])
    subprocess.run([sys.executable, "-c", script, tmp_path / "y.npy"], check=True, env=environment, timeout=120)
    np.testing.assert_allclose(outputs(), np.load(tmp_path / "y.npy"), rtol=0.0, atol=1e-12 * STROKE)
