# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Measured and benchmark recordings: fitted on their training files, evaluated on held-out files."""

import numpy as np
import pytest
from measured_data import measured_data

from hysteresis_ros.identification.bouc_wen import fit_bouc_wen_mechanical
from hysteresis_ros.identification.prandtl_ishlinskii import fit_prandtl_ishlinskii
from hysteresis_ros.identification.prediction import recover_voltage
from hysteresis_ros.identification.preisach import fit_preisach
from hysteresis_ros.models.block import COMPILED
from hysteresis_ros.models.hysteresis.bouc_wen_mechanical import BoucWenMechanicalParameters

SKIPPED = 400  # samples that the README of both piezo recordings excludes


def table(name):
    return np.loadtxt(measured_data(name), delimiter=",", skiprows=1)


def stack_recording(name):
    columns = table(f"yan9a_dbo/{name}.csv")
    return columns[:, 1], 1e-6 * columns[:, 2]


@pytest.mark.slow
@pytest.mark.parametrize(
    "fitter, train, test", [(fit_preisach, 0.10e-6, 0.22e-6), (fit_prandtl_ishlinskii, 0.14e-6, 0.22e-6)]
)
def test_piezo_stack_major_loops_predict_other_amplitudes(fitter, train, test):
    voltage, displacement = stack_recording("model_1Hz_major")
    fit = fitter(voltage, displacement, 0.005, skip=SKIPPED)
    assert fit.rmse < train
    assert 0.012 < fit.linear_part.lag + fit.linear_part.delay < 0.019  # amplifier and sensor
    assert 0.01 < fit.linear_part.creep_rate < 0.02  # creep per decade, as in data sheets of such stacks
    voltage, displacement = stack_recording("test_1Hz_variable_amplitude")
    error = (displacement - fit.simulate(voltage))[SKIPPED:]
    assert np.std(error) < test
    back = recover_voltage(fit, displacement, voltage, skip=SKIPPED)
    assert back.rmse_percent < 0.6


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="takes minutes without Numba")
def test_bouc_wen_benchmark_from_thirty_percent_off():
    train = table("boucwen_benchmark/train_multisine.csv")
    factors = dict(mass=1.35, damping=0.65, stiffness=0.65, alpha=1.4, beta=0.69, gamma=1.4, delta=1.35)
    truth = dict(mass=2.0, damping=10.0, stiffness=5e4, alpha=5e4, beta=1e3, gamma=0.8, delta=-1.1)
    start = BoucWenMechanicalParameters(**{name: factors[name] * value for name, value in truth.items()})
    sample_time = 1.0 / 750.0
    fit = fit_bouc_wen_mechanical(train[:, 1], train[:, 2], sample_time, start)
    assert not fit.warnings and fit.converged
    for name, initial, limit in (("test_multisine", "periodic", 1e-6), ("test_sinesweep", "zero", 5e-6)):
        test = table(f"boucwen_benchmark/{name}.csv")
        error = fit.simulate(test[:, 1], sample_time, initial) - test[:, 2]
        assert np.sqrt(np.mean(error**2)) < limit
