"""What tests of the fused loop share: what it made, and its offline twin."""

from __future__ import annotations

import time

import numpy as np
from loop_support import assert_same_bits

from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.fused import FusedLoop
from hysteresis_ros.signals import row_signals

#: Longer than any wait for a condition takes.
PATIENCE = 60.0


def wait_for(condition) -> None:
    """Wait until ``condition()`` is true."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "it never came true"
        time.sleep(0.002)


def named(loop: FusedLoop, table) -> dict[str, np.ndarray]:
    """Return the signals of a table by their names."""
    names = (signal.name for signal in row_signals(loop.axis.motor))
    return {name: np.ascontiguousarray(values) for name, values in zip(names, table, strict=True)}


def whole(loop: FusedLoop, *taken) -> dict[str, np.ndarray]:
    """Return everything that a loop has made, from pieces of it that follow one another."""
    taken = [*taken, loop.take()]
    assert not loop.failure and not any(piece.lost for piece in taken)
    first = taken[0].first
    for piece in taken:
        assert piece.first == first or not len(piece.times)
        first += len(piece.times)
    assert first == loop.sample
    return named(loop, np.concatenate([piece.table for piece in taken], axis=1))


def assert_twin(loop: FusedLoop, made: dict[str, np.ndarray], parameters) -> dict[str, np.ndarray]:
    """Refuse a run that is not, bit for bit, that of its offline twin; return the twin's."""
    asked = {"requests": made["request"], "speeds": made["speed"]} if loop.axis.motor else {}
    twin = Axis(parameters).run(made["setpoint"], changes=loop.changes, skipped=made["skipped"], **asked)
    assert_same_bits(made, twin)
    return twin
