# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""xy_scanner without hysteresis, creep and noise, and its errors during a scan, for tests of the design of stages."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_simulation import simulate_stage, with_scan

SAMPLE_TIME = 1e-4
#: A plant without hysteresis, creep and noise, which therefore equals its linear model.
PROPORTIONAL = {"hysteresis__type": "proportional", "hysteresis__proportional__gain": 0.4e-6, "creep__type": "none"}
EXACT = {"limits__bits": 0, "limits__slew_rate": 0.0}
SPIRAL = "spiral", ("diameter=16um", "turns=4", "frame_rate=16Hz")


def stage(kind="", values=(), structure=None, **overrides) -> StageParameters:
    """Return xy_scanner without hysteresis, creep and noise, which follows a scan."""
    made = load_configuration("xy_scanner")
    quiet = {"sensor__noise": 0.0, "sensor__resolution": 0.0, "overtravel": -1.0}
    nodes = {"plant_simulator": PROPORTIONAL | EXACT | quiet, "hysteresis_compensator": PROPORTIONAL | EXACT}
    for node, given in {**nodes, "stage": {"scan__periods": 0} | (structure or {}), **overrides}.items():
        made = made.override(node, **given)
    if not kind:
        made = made.override("reference_generator", waveform__type="hold")
    return StageParameters.from_configuration(with_scan(made, kind, values) if kind else made)


def late_structure() -> dict:
    """Return a structure whose sensor x initially responds in the wrong direction: a zero outside the unit circle."""
    C = np.reshape(load_configuration("xy_scanner").node("stage")["structure.C"], (2, 4)).copy()
    C[0, 1] = -0.3
    return {"structure__C": tuple(C.ravel())}


def errors(parameters: StageParameters, periods: int = 4) -> np.ndarray:
    """Return the errors of all axes in the last period of a scan, shape (n, N) [m]."""
    period = round(parameters.scan.period / SAMPLE_TIME)
    run = simulate_stage(parameters, duration=periods * parameters.scan.period)
    found = [run[f"{name}/reference"] - run[f"{name}/displacement"] for name in parameters.names]
    return np.array(found)[:, -period:]
