"""What tests of the loop share: axes of the shipped configurations with some parameters changed, and their steps."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.simulation.axes import single_axis

#: A reference that stays where the setpoint is, for kim2009.
HOLD = {"reference_generator": {"waveform__type": "hold"}}


def parameters(name="kim2009", **overrides):
    """Return the parameters of an axis; ``overrides`` by node, with double underscores for dots."""
    configuration = load_configuration(name)
    for node, values in overrides.items():
        configuration = configuration.override("" if node == "every" else node, **values)
    return single_axis(configuration)


def axis(name="kim2009", **overrides):
    """Return an axis at rest; arguments as :func:`parameters`."""
    return Axis(parameters(name, **overrides))


def steps(values) -> np.ndarray:
    """Return how far a signal moves from each sample to the next."""
    return np.abs(np.diff(values))


def assert_same_bits(one, other, first=0):
    """Refuse two runs of the same length (from sample ``first`` of the second) that differ in any bit."""
    for name, values in one.items():
        there = other[name][first : first + len(values)]
        np.testing.assert_array_equal(np.asarray(values).view(np.int64), there.view(np.int64), err_msg=name)
