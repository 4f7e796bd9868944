# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What filters with frequencies of their own have to keep."""

from __future__ import annotations

from hysteresis_ros.errors import ParameterError, Problem


def require_filters(parameters, most: int, beside: tuple[str, ...]):
    """Yield a Problem for filters that are none, too many, or incomplete.

    Parameters
    ----------
    parameters : Parameters
        With ``frequencies``.
    most : int
        How many there may be.
    beside : tuple of str
        Arrays that have a number for each of them.
    """
    count = len(parameters.frequencies)
    if not 1 <= count <= most:
        yield Problem("frequencies", parameters.frequencies, f"must be 1 … {most} numbers")
        return
    for name in beside:
        values = getattr(parameters, name)
        if len(values) != count:
            yield Problem(name, values, f"must be {count} numbers, as many as frequencies")


def require_below_half_the_rate(frequencies: tuple[float, ...], sample_time: float) -> None:
    """Refuse a filter that samples cannot make.

    Parameters
    ----------
    frequencies : tuple of float
        [Hz]
    sample_time : float
        [s]

    Raises
    ------
    ParameterError
        ``frequencies``: one is not below half the sample rate.
    """
    highest = 0.5 / sample_time
    if not max(frequencies) < highest:
        allowed = f"each must be below half the sample rate, {highest:g} Hz"
        raise ParameterError([Problem("frequencies", frequencies, allowed)])
