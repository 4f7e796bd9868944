# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An axis with a known error: an actuator without hysteresis, in open loop, at a constant setpoint.

Its error is setpoint · (gain − 1) from the first sample on; gain is the plant's gain over the compensator's.
"""

from __future__ import annotations

import numpy as np

from hysteresis_ros.configuration import parse_configuration
from hysteresis_ros.laboratory.sweeps.plan import make_plan, parse_variations
from hysteresis_ros.laboratory.sweeps.study import Study
from hysteresis_ros.loop.reach import single_axis

PLACE = 2e-6
AXIS = f"""
/**:
  ros__parameters: {{sample_rate: 1000.0}}
/**/plant_simulator:
  ros__parameters:
    limits: {{minimum: -200.0, maximum: 200.0}}
    hysteresis: {{type: proportional, proportional: {{gain: 1.0e-7}}}}
    samples: 20
/**/hysteresis_compensator:
  ros__parameters:
    limits: {{minimum: -200.0, maximum: 200.0}}
    hysteresis: {{type: proportional, proportional: {{gain: 1.0e-7}}}}
/**/motion_controller:
  ros__parameters: {{type: open_loop}}
/**/reference_generator:
  ros__parameters: {{minimum: 0.0, maximum: 1.0e-5, initial_setpoint: {PLACE}, waveform: {{type: hold}}}}
"""
#: Errors of 10 to 30 %, at 1 to 2 µm.
PRODUCT = ("plant_simulator.gain=uniform(1.1,1.3)", "reference_generator.initial_setpoint=uniform(1um,2um)")
METRICS = ("rms_error_m", "max_error_m")


def axis():
    return single_axis(parse_configuration(AXIS, "axis.yaml"))


def asked(varied=PRODUCT, runs=40, seed=1, design="random", metrics=METRICS):
    """Return study and plan of a sweep of the axis."""
    variations = parse_variations(varied, axis())
    return Study(axis(), variations, tuple(metrics)), make_plan(variations, runs, seed, design)


def same_bits(one, other) -> bool:
    """Return whether two sweeps have the same results, to the last bit."""
    columns, others = one.columns, other.columns
    return list(columns) == list(others) and all(
        np.array_equal(values, others[name]) if values.dtype.kind != "f" else values.tobytes() == others[name].tobytes()
        for name, values in columns.items()
    )
