# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An identification computes its linear algebra in one thread, and restores the number of threads."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

CODE = """
from hysteresis_ros import executors

def numbers():
    return [get_number() for get_number, _ in executors._blas_threads()]

for _, set_number in executors._blas_threads():
    set_number(3)
print(numbers())
with executors.one_thread():
    print(numbers())
    with executors.one_thread():
        pass
    print(numbers())
print(numbers())
"""


def printed(**variables: str) -> list[list[int]]:
    """Return the numbers of threads before, within (twice) and after the block, for each BLAS."""
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    command = [sys.executable, "-c", CODE]
    lines = subprocess.run(command, env=environment | variables, check=True, capture_output=True, text=True).stdout
    return [[int(word) for word in line.strip("[]").split(",") if word] for line in lines.splitlines()]


@pytest.mark.slow
def test_one_thread_within_and_the_number_before_after():
    before, within, still, after = printed()
    if not before:
        pytest.skip("this NumPy is not linked with OpenBLAS")
    count = len(before)
    assert (before, within, still, after) == ([3] * count, [1] * count, [1] * count, [3] * count)


@pytest.mark.slow
def test_a_number_of_threads_in_the_environment_is_kept():
    before, within, _, _ = printed(OPENBLAS_NUM_THREADS="2")
    assert within == before == [3] * len(before)
