# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Who runs the axes of an experiment: the offline simulation, or whatever a caller puts in its place."""

from __future__ import annotations

import contextlib
import contextvars
from collections.abc import Callable

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.simulation.axes import single_axis
from hysteresis_ros.simulation.run import simulate

#: Runs an axis, whose parameters say how long, from rest to a recording.
Runner = Callable[[AxisParameters], Recording]

_runner: contextvars.ContextVar[Runner] = contextvars.ContextVar("runner", default=simulate)


@contextlib.contextmanager
def through(runner: Runner):
    """Let ``runner`` run every axis of the experiments called inside."""
    token = _runner.set(runner)
    try:
        yield
    finally:
        _runner.reset(token)


class Noting:
    """A runner that simulates, and notes the axes it was asked for in :attr:`axes`."""

    def __init__(self):
        self.axes: list[AxisParameters] = []

    def __call__(self, axis: AxisParameters) -> Recording:
        """Simulate an axis."""
        self.axes.append(axis)
        return simulate(axis)


def run(configuration: Configuration, duration: float) -> Recording:
    """Return the run of the only axis of ``configuration``, ``duration`` seconds from rest.

    Raises
    ------
    ConfigurationError
        The configuration holds several axes, or the duration is not positive.
    ParameterError
        A parameter is wrong.
    """
    return _runner.get()(single_axis(configuration).with_duration(duration))
