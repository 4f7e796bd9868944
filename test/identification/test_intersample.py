# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

import numpy as np
import pytest

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.linear_systems import find_period, upsample


@pytest.mark.parametrize("method", ["zoh", "linear", "bandlimited"])
@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("count", [100, 101])
def test_the_samples_themselves_are_kept(method, periodic, count):
    u = np.random.default_rng(0).normal(size=count)
    finer = upsample(u, 4, method, periodic)
    assert finer.shape == (4 * count,)
    tolerance = 1e-12 if method != "bandlimited" or periodic else 2e-2
    np.testing.assert_allclose(finer[::4], u, atol=tolerance)


def test_a_multisine_is_interpolated_exactly_when_periodic_and_closely_when_not():
    def multisine(place):
        return sum(np.cos(2.0 * np.pi * k * place / 128 + k * k) for k in range(1, 25))

    fine = np.arange(128 * 8) / 8.0
    np.testing.assert_allclose(upsample(multisine(np.arange(128)), 8, "bandlimited", True), multisine(fine), atol=1e-11)
    long = np.arange(1024)
    finer = upsample(multisine(long), 8, "bandlimited")
    middle = slice(300 * 8, 700 * 8)
    np.testing.assert_allclose(finer[middle], multisine(np.arange(8192) / 8.0)[middle], atol=1e-4)


def test_periods_are_found_only_where_the_input_repeats():
    period = np.random.default_rng(0).normal(size=100)
    assert find_period(np.tile(period, 3)) == 100
    assert find_period(np.random.default_rng(0).normal(size=300)) is None
    assert find_period(np.ones(50)) is None


def test_unknown_methods_are_refused():
    with pytest.raises(IdentificationError, match="bandlimited"):
        upsample(np.ones(5), 2, "cubic")
