# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Designs and simulations give the same bits on every processor: other processors are simulated in processes."""

from __future__ import annotations

import ast
import hashlib
import json
import pathlib
import re

import pytest
from processors_support import PROCESSORS, on_processor

import hysteresis_ros

#: Simulated time of every shipped configuration [s]: a few thousand samples.
DURATIONS = {
    "kim2009": 0.5,
    "auwal2017": 5.0,
    "wang2014": 1.0,
    "wang2014_duhem": 1.0,
    "wang2014_duhem80": 1.0,
    "wang2014_linear": 1.0,
    "picma_stage": 1.0,
    "stage700": 0.05,
    "fleming2010": 0.01,
    "inchworm_travel": 2.0,
}
SIMULATE = """
import hashlib, json, sys, warnings
warnings.filterwarnings("ignore")
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate

found = {}
for name, duration in json.loads(sys.argv[1]).items():
    signals = simulate(single_axis(load_configuration(name)), duration=duration, describe=False).signals
    found[name] = {signal: hashlib.sha256(values.tobytes()).hexdigest() for signal, values in signals.items()}
print(json.dumps(found))
"""
#: Designs of all objects with a design, with all digits of their numbers.
DESIGN = """
import json, warnings
warnings.filterwarnings("ignore")
import numpy as np
from dataclasses import asdict, replace
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.designs.gains import design_gains
from hysteresis_ros.control.feedforward import inverse_filter, sufficient_preview
from hysteresis_ros.control.kalman import KalmanParameters, filter_gain
from hysteresis_ros.control.controller import DESIGNS
from hysteresis_ros.models.linear import LinearParameters, zero_order_hold
from hysteresis_ros.references import Waveform, WaveformParameters
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import mismatched

axis = single_axis(load_configuration("kim2009"))
time, given = 1.0 / axis.plant_simulator.sample_rate, axis.motion_controller
dynamics = given.model.dynamics
# a bandwidth is a search; these two search with what others do not use, poles of the model and of the sliding motion
wanted = {"pid": 30.0, "super_twisting": 30.0}
found = {name: asdict(design_gains(given, name, time, wanted.get(name)).parameters) for name in DESIGNS}
for kind in ("constant", "ramp", "periodic"):
    wanted = KalmanParameters(disturbance=kind, disturbance_frequency=7.3, disturbance_harmonics=3)
    found[kind] = filter_gain(wanted, dynamics.state_space, time).tolist()
# two zeros outside the unit circle, one inside, in no particular coordinates
A = np.array([[0.5, 0.1, 0.0, 0.2], [0.3, 0.4, 0.1, 0.0], [0.0, 0.2, 0.6, 0.1], [0.1, 0.0, 0.3, 0.3]])
outside = LinearParameters(A=tuple(A.ravel()), B=(0.3, 1.1, 0.7, 0.2), C=(0.9, -1.3, 0.4, 0.6))
filtered = inverse_filter(outside, sufficient_preview(outside))
found["inverse"] = [np.asarray(part).tolist() for part in (filtered.weights, filtered.A, filtered.B, filtered.C)]
found["sampled"] = [part.tolist() for part in zero_order_hold([[0.0, 1.0], [-1e6, -70.0]], [0.0, 1e6], time)]
multisine = WaveformParameters(type="multisine", frequency=1.0, amplitude=1e-6)
found["multisine"] = Waveform(multisine, 1e-3).p.tolist()
drawn = single_axis(mismatched(load_configuration("kim2009"), 0.1, 5)).plant_simulator.dynamics
found["drawn"] = [*drawn.A, *drawn.B]
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def made() -> dict[str, list[str]]:
    """What each processor prints: its simulations and its designs, in one process."""
    script = SIMULATE + DESIGN
    return {name: on_processor(name, script, json.dumps(DURATIONS)).splitlines() for name in PROCESSORS}


@pytest.mark.slow
@pytest.mark.parametrize("processor", [name for name in PROCESSORS if name != "Haswell"])
def test_every_shipped_configuration_is_the_same_bits_on_every_processor(processor, made):
    found, expected = (json.loads(made[name][0]) for name in (processor, "Haswell"))
    assert found == expected and found.keys() == DURATIONS.keys()


@pytest.mark.slow
def test_compiled_for_another_processor_functions_are_the_same_bits(tmp_path):
    # Numba compiles for the current processor; a generic one has no vector extensions and no fused multiply-add
    script = """
import numpy as np
from hysteresis_ros.models import elementary
x = np.linspace(-6.0, 6.0, 2001)
for name in ("sin", "cos", "exp", "expm1", "log", "log1p", "tanh"):
    print([getattr(elementary, name)(value) for value in x.tolist()])
"""
    generic = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)}
    assert on_processor("Prescott, nothing fused", script, **generic) == on_processor("Haswell", script)


@pytest.mark.slow
def test_designs_are_the_same_bits_on_every_processor(made):
    digests = {name: hashlib.sha256(made[name][1].encode()).hexdigest() for name in PROCESSORS}
    assert len(set(digests.values())) == 1, digests


#: Functions with processor-dependent results; in folders of blocks they may only refuse a design or be printed.
UNORDERED = re.compile(
    r"\bnp\.(linalg|dot|einsum|inner|vdot|poly|convolve|exp|expm1|log|log10|log1p|sin|cos|tan|tanh|cosh|sinh|power)\b"
    r"|\bmath\.(exp|expm1|log|log1p|log10|pow|sin|cos|tan|tanh|sinh|cosh|hypot)\b|\bscipy\b|\bcmath\b"
)
#: Files with such results for refusals or prints, and the functions that they may use.
JUDGES = {
    # the error of a singular matrix has NumPy's name; the highest speed of a reference is printed or leads to a refusal
    "models/linear_algebra.py": {"np.linalg"},
    "loop/reach.py": {"cmath", "import cmath"},
    "loop/inchworm_checks.py": {"cmath", "import cmath"},  # the mode of a warning
    # displacements between the samples of a finished run
    "loop/stage_simulation.py": {"np.linalg", "@", "scipy", "import scipy.signal"},
    # noise, predicted times and predicted creep: published, or a reason to refuse
    "references/moves.py": {"@"},
    "loop/ready.py": {"np.linalg", "@"},
    "loop/quiet.py": {"@"},
    "control/state_feedback.py": {"np.linalg", "@"},
    # a search whose result is written with four digits; margins and printed modes
    "designs/damping.py": {"np.linalg", "np.exp", "np.sinh"},
    "control/damping/inner_loop.py": {"np.log", "@"},
    # taps are rounded before they are checked and written
    "designs/learning_filters.py": {"np.cos", "np.exp", "@"},
    "control/margins.py": {"@", "np.linalg", "np.exp", "np.log", "np.log10", "np.sinh"},
    "control/laws/pid.py": {"np.log", "@"},
    "control/linearisation.py": {"@"},
    "control/sliding_surface.py": {"np.linalg", "@"},
    "control/feedforward.py": {"math.log10"},
    # scores, and the plants on which gains are tested
    "control/sliding_gains.py": {"math.log", "np.log"},
    "control/uncertainty.py": {"np.linalg", "np.exp", "np.log", "@"},
    "models/creep.py": {"math.log10"},
    "models/linear.py": {"np.linalg", "@"},
    # margins and gains of several loops, which are printed
    "control/coupling.py": {
        "np.linalg",
        "@",
        "from scipy.optimize import minimize",
        "math.log10",
        "np.log",
        "np.exp",
    },
    # paths of scans; a product in a fixed order rotates those that the loop follows (test_recorded_runs.py)
    "references/pieces.py": {"@"},
    "references/scan.py": {"np.linalg", "@", "math.log10", "math.sin", "math.cos"},
    "references/scans/cycloid.py": {"np.exp"},
    "references/scans/file.py": {"from scipy.interpolate import CubicSpline"},
    "references/scans/lissajous.py": {"np.sin", "math.hypot", "@", "np.cos"},
    "references/scans/rosette.py": {"math.sin", "@", "np.exp"},
    "references/scans/spiral.py": {"np.exp"},
    # printed figures of a stage, and limits for refusals or warnings about its scans
    "loop/stage_response.py": {"np.linalg", "np.exp", "@"},
    # samples that are written into files; a refused contraction
    "references/recipes.py": {"np.exp", "np.cos"},
    "references/inchworm_parameters.py": {"np.linalg"},
}
PACKAGE = pathlib.Path(hysteresis_ros.__file__).parent


def unordered(path: pathlib.Path) -> set[str]:
    """Return functions in a source whose last digit depends on the processor."""
    used = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Attribute):
            used |= {match.group() for match in [UNORDERED.search(ast.unparse(node))] if match}
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            used.add("@")
        elif isinstance(node, ast.Import | ast.ImportFrom) and re.search(r"\b(scipy|cmath)\b", ast.unparse(node)):
            used.add(ast.unparse(node))
    return used


@pytest.mark.slow
def test_blocks_compute_in_a_fixed_order():
    found = {}
    for folder in ("models", "compensation", "control", "references", "loop"):
        for path in sorted((PACKAGE / folder).rglob("*.py")):
            name = path.relative_to(PACKAGE).as_posix()
            if used := unordered(path) - JUDGES.get(name, set()):
                found[name] = used
    assert not found, f"use hysteresis_ros.models.linear_algebra and hysteresis_ros.models.elementary there: {found}"
