# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Designs of a stage: interaction and margins, dynamic decoupling of a scan, learning for the periods of its axes."""

from __future__ import annotations

import functools
import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from plain_stage_support import SAMPLE_TIME, SPIRAL, errors, late_structure, stage

from hysteresis_ros.configuration import load_configuration, parse_configuration
from hysteresis_ros.control.coupling import disk_margins
from hysteresis_ros.control.learning import LearningParameters, shortest_period, write_learned
from hysteresis_ros.designs import controller as designing
from hysteresis_ros.designs.controller import DesignRequest, design_lines
from hysteresis_ros.designs.coupled import (
    calm_bandwidth,
    controllers_file,
    decoupled,
    design_controllers,
    design_stage_learning,
    stage_lines,
)
from hysteresis_ros.designs.learning import LearningRequest
from hysteresis_ros.designs.stage_stability import require_stable
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.stage_parameters import StageParameters, StageScanParameters
from hysteresis_ros.loop.stage_response import scanned_paths, stage_loop, stage_response


@pytest.fixture(scope="module", autouse=True)
def known_gains():
    """Compute each gain once: it depends on the model of the axis, not on what the axis follows."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(designing, "design_gains", functools.cache(designing.design_gains))
        yield


def zeros(model) -> np.ndarray:
    """Return the finite transmission zeros of a square system."""
    count, order = len(model.C), model.order
    pencil = np.block([[model.A, model.B], [model.C, model.D]])
    identity = np.zeros_like(pencil)
    identity[:order, :order] = np.eye(order)
    found = scipy.linalg.eigvals(pencil, identity)
    assert count == model.B.shape[1]
    return found[np.isfinite(found) & (np.abs(found) < 1e6)]


def corrected(parameters: StageParameters, corrections: dict, folder, active=False) -> StageParameters:
    """Return a stage with corrections of its references that are not changed by learning."""
    axes = []
    for name, axis in zip(parameters.names, parameters.axes, strict=True):
        path = folder / f"{name}.yaml"
        write_learned(path, corrections[name])
        given = LearningParameters(
            type="inversion",
            period=corrections[name].period,
            error_filter=(0.0,),
            robustness_filter=(1.0,),
            maximum=1e-4,
            active=active,
            file=str(path),
        )
        axes.append(replace(axis, motion_controller=replace(axis.motion_controller, learning=given)))
    return replace(parameters, axes=tuple(axes))


def learned(parameters: StageParameters, paths, corrections) -> dict:
    from hysteresis_ros.control.learning import Learned

    middle = [axis.generator.initial_setpoint for axis in parameters.axes]
    return {
        name: Learned(paths.shape[1] * SAMPLE_TIME, SAMPLE_TIME, corrections[i], middle[i] + paths[i])
        for i, name in enumerate(parameters.names)
    }


@pytest.mark.slow
@pytest.mark.parametrize("structure", [None, late_structure()], ids=["as it is", "zero outside"])
def test_the_inverse_of_the_coupled_loop_follows_the_path_at_all_samples(structure, tmp_path):
    parameters = stage(*SPIRAL, structure=structure)
    outside = np.abs(zeros(parameters.stage.structure.linear.held())) > 1.05
    assert np.any(outside) == (structure is not None)
    paths = scanned_paths(parameters)
    corrections = decoupled(parameters, paths)
    plain = errors(parameters)
    found = errors(corrected(parameters, learned(parameters, paths, corrections), tmp_path))
    assert np.max(np.abs(plain)) > 1e-6
    assert np.max(np.abs(found)) < 2e-4 * np.max(np.abs(plain))


@pytest.mark.slow
def test_decoupling_each_axis_alone_leaves_the_coupling_between_them(tmp_path):
    """The inverse has cross terms; without them the error equals the cross-talk."""
    crossed = stage(
        "lissajous", ("width=16um", "depth=8um", "lines=5", "frame_rate=40Hz"), structure={"decoupling": []}
    )
    paths = scanned_paths(crossed)
    whole = decoupled(crossed, paths)
    alone = np.array([decoupled(crossed, np.where(np.arange(2)[:, None] == i, paths, 0.0))[i] for i in range(2)])
    both = errors(corrected(crossed, learned(crossed, paths, whole), tmp_path))
    apart = errors(corrected(crossed, learned(crossed, paths, alone), tmp_path))
    assert np.max(np.abs(both)) < 1e-2 * np.max(np.abs(apart))


@pytest.mark.slow
def test_a_wrong_model_is_seen_by_what_its_inverse_leaves(tmp_path):
    parameters = stage(*SPIRAL)
    paths = scanned_paths(parameters)
    wrong = stage(*SPIRAL, structure={"structure__C": tuple(1.1 * np.array(parameters.stage.structure.C))})
    corrections = learned(parameters, paths, decoupled(wrong, paths))
    good = learned(parameters, paths, decoupled(parameters, paths))
    found = [np.max(np.abs(errors(corrected(parameters, some, tmp_path)))) for some in (corrections, good)]
    assert found[0] > 50.0 * found[1]


def test_the_closed_loop_of_a_stage_is_that_of_its_loop_transfer():
    parameters = stage()
    angles = np.array([1e-3, 0.05, 0.3, 1.0])
    closed = stage_response(parameters, angles)
    loop = stage_loop(parameters).response(np.exp(1j * angles))
    # at rest the references are followed, without coupling
    np.testing.assert_allclose(closed[0], np.eye(2), atol=0.05)
    # for a PID without weights on the reference, 1 - T is the sensitivity, except for the damping
    sensitivity = np.linalg.inv(np.eye(2) + loop)
    without = stage(motion_controller={"damping__type": "none", "pid__Ki": 20.0, "pid__Kp": 0.0, "pid__Kd": 0.0})
    closed, loop = stage_response(without, angles), stage_loop(without).response(np.exp(1j * angles))
    np.testing.assert_allclose(np.eye(2) - closed, np.linalg.inv(np.eye(2) + loop), atol=1e-9)
    assert np.all(np.isfinite(sensitivity))


def test_the_period_of_an_axis_is_that_of_its_own_path():
    line = np.tile(np.sin(np.arange(40) * np.pi / 20.0), 6)
    assert shortest_period(line) == 40
    assert shortest_period(np.concatenate([line, line[:40] * 1.001])) == 280
    assert shortest_period(line * 1e-6 + np.repeat([0.0, 1e-12], 120)) == 40, "a difference too small for learning"


@pytest.mark.slow
def test_each_axis_learns_over_the_period_of_its_own_path():
    values = ("width=16um", "depth=8um", "lines=6", "flyback=2", "line_rate=20Hz", "slow=ramped")
    found = design_stage_learning(stage("raster", values), LearningRequest("inversion"), {})
    assert found.designs["x"].parameters.period == pytest.approx(0.05), "period of a line"
    assert found.designs["y"].parameters.period == pytest.approx(0.4), "period of a frame"
    assert len(found.corrections["x"].correction) == 500 and len(found.corrections["y"].correction) == 4000


@pytest.mark.slow
def test_what_cannot_learn_is_said():
    with pytest.raises(ConfigurationError, match="the stage follows no scan: give scan.kind"):
        design_stage_learning(stage(), LearningRequest("inversion"), {})
    with pytest.raises(ConfigurationError, match="x: its model needs corrections of .* give a larger --maximum"):
        design_stage_learning(stage(*SPIRAL), LearningRequest("inversion", maximum=1e-9), {})
    fed = stage(*SPIRAL, motion_controller={"feedforward__type": "static"})
    with pytest.raises(ConfigurationError, match=r"feedforward.type = static: must be none"):
        decoupled(fed, scanned_paths(fed))


@pytest.mark.slow
def test_the_table_of_a_stage_is_what_its_parts_are():
    text = "\n".join(stage_lines(stage()))
    margins = disk_margins(stage_loop(stage()), SAMPLE_TIME)
    gain = np.array([[1.0, 0.04], [0.04, 1.0]])
    share = 1.0 / (1.0 - 0.04**2)
    assert f"relative gains of x         {share:.4g}, {1.0 - share:.4g}" in text, gain
    assert f"disk margin of all jointly  {margins.together.gain_margin:.1f} dB" in text
    assert "% of x in y" in text or "% of y in x" in text
    apart = "\n".join(stage_lines(stage(structure={"decoupling": []})))
    assert "coupling at 10 Hz" in apart and apart != text


@pytest.mark.slow
@pytest.mark.parametrize("moved", [0, 1])
def test_the_coupling_of_a_table_names_the_axis_that_moves_and_the_one_that_is_moved(moved):
    """Cross-talk of 4 % from one axis into the other, and none the other way."""
    given = load_configuration("xy_scanner").node("stage")
    B, C = (np.reshape(given[f"structure.{name}"], shape) for name, shape in (("B", (4, 2)), ("C", (2, 4))))
    own = np.repeat(np.eye(2, dtype=bool), 2, axis=1)
    B, C = np.where(own.T, B, 0.0), np.where(own, C, 0.0)
    C[moved] += 0.04 * C[1 - moved]
    structure = {"structure__B": tuple(B.ravel().tolist()), "structure__C": tuple(C.ravel().tolist())}
    lines = stage_lines(stage(structure=structure | {"decoupling": []}))
    found = [line for line in lines if line.startswith("coupling at ")]
    assert len(found) == 2 and all(line.endswith(f"% of {'xy'[1 - moved]} in {'xy'[moved]}") for line in found), found


@pytest.mark.slow
def test_a_correction_of_a_short_period_is_the_mean_over_the_long_one():
    """x learns over a line and y over a frame: what y does to x in a frame does not repeat in each line."""
    values = ("width=16um", "depth=8um", "lines=6", "flyback=2", "line_rate=20Hz", "slow=ramped")
    passed_on = {"type": "open_loop"}  # no feedback removes the cross-talk
    crossed = stage("raster", values, structure={"decoupling": []}, motion_controller=passed_on)
    found = design_stage_learning(crossed, LearningRequest("inversion"), {})
    # the cross-talk of 4 % of the slow axis is centred over a frame, and up to 0.16 µm within a line
    line = found.corrections["x"].correction
    lone = stage("raster", values, motion_controller=passed_on)
    lone = design_stage_learning(lone, LearningRequest("inversion"), {}).corrections["x"].correction
    assert abs(np.mean(line) - np.mean(lone)) < 2e-8


@pytest.mark.slow
def test_the_steering_mirror_keeps_six_decibels_in_all_loops_at_once():
    parameters = StageParameters.from_configuration(load_configuration("steering_mirror"))
    together = disk_margins(stage_loop(parameters), 1.0 / 6400.0).together
    assert together.gain_margin > 6.0


@pytest.mark.slow
def test_loops_that_are_unstable_together_are_refused_with_a_bandwidth_that_is_stable():
    """The models of the axes of the mirror contain no modes, so its controllers can be designed far too fast."""
    configuration = load_configuration("steering_mirror")
    parameters = StageParameters.from_configuration(configuration)
    require_stable(parameters, "mirror.yaml")

    def designed(bandwidth=None) -> StageParameters:
        designs = design_controllers(parameters, DesignRequest("pid", bandwidth=bandwidth), {})
        text = controllers_file(configuration, designs, "")
        return StageParameters.from_configuration(parse_configuration(text, "designed"))

    with pytest.raises(ConfigurationError, match="s1, s2, s3 together are unstable.* at most 0.046 times") as refused:
        require_stable(designed(), "mirror.yaml")
    bandwidth = float(re.search(r"design mirror.yaml --controller pid --bandwidth (\S+)Hz", str(refused.value))[1])
    slower = designed(bandwidth)
    require_stable(slower, "mirror.yaml")
    assert disk_margins(stage_loop(slower), 1.0 / 6400.0).together.gain_margin == pytest.approx(6.0, abs=1.0)


@pytest.mark.slow
def test_the_slow_axis_of_a_raster_gets_a_slow_law_unless_a_bandwidth_is_requested():
    """50 Hz are ten times its lines per second; the noise of its sensor moves it by a third of what it did."""
    alone = StageParameters.from_configuration(load_configuration("xy_scanner"))
    request, lines = DesignRequest("pid", noise=5e-9), ("lines=8", "flyback=2", "line_rate=5Hz", "slow=ramped")
    first = design_controllers(alone, request, {})
    size = ("width=20um", "depth=20um")
    for axes, slow in ((("x", "y"), "y"), (("y", "x"), "x")):
        raster = alone.following(StageScanParameters("raster", (*size, *lines), axes, periods=3))
        assert calm_bandwidth(raster) == (slow, 50.0)
        found = design_controllers(raster, request, {})
        assert found[slow].margins.bandwidth == pytest.approx(50.0, rel=0.01) and not found[slow].misses()
        assert "needs no more than 50 Hz" in "\n".join(map(str, design_lines(found[slow])))
        assert found[slow].margins.noise_gain < 0.4 * first[slow].margins.noise_gain
        (fast,) = {"x", "y"} - {slow}
        assert found[fast].margins.bandwidth == first[fast].margins.bandwidth and not found[fast].calmed
    asked = design_controllers(raster, replace(request, bandwidth=120.0), {}, slow)
    assert asked[slow].margins.bandwidth == pytest.approx(120.0, rel=0.01)
    steps = alone.following(StageScanParameters("raster", (*size, *lines[:3], "slow=stepped"), periods=3))
    assert calm_bandwidth(steps)[1] > 50.0, "an axis that steps from line to line moves faster"
    spiral = alone.following(StageScanParameters("spiral", ("diameter=20um", "turns=8", "frame_rate=1Hz"), periods=2))
    assert calm_bandwidth(spiral) is None and calm_bandwidth(alone) is None
    assert design_controllers(spiral, request, {}, "y")["y"].margins.bandwidth == first["y"].margins.bandwidth


@pytest.mark.slow
def test_a_file_states_once_what_the_other_loops_changed_in_the_designs():
    configuration = load_configuration("xy_scanner")
    parameters = StageParameters.from_configuration(configuration)
    found = design_controllers(parameters, DesignRequest("pid", bandwidth=50.0, damping="none"), {})
    changed = {name: replace(one, together="no damping: ppf does not suffice") for name, one in found.items()}
    line = "# All loops together: no damping: ppf does not suffice.\n"
    assert controllers_file(configuration, changed, "--controller pid").count(line) == 1
    assert "All loops together" not in controllers_file(configuration, found, "--controller pid")


def test_loops_with_another_gain_at_rest_are_refused_with_the_decoupling_that_they_need():
    require_stable(stage(), "stage.yaml")
    for wrong in ((0.9, 0.3, -0.2, -0.6), (5.0, 0.0, 0.0, 5.0), (0.0, 1.0, 1.0, 0.0)):
        with pytest.raises(ConfigurationError, match=r"gain at rest differs .*: give decoupling: \[1.0016, -0.04"):
            require_stable(stage(structure={"decoupling": wrong}), "turned.yaml")
