"""Sine around the offset."""

from __future__ import annotations

from hysteresis_ros import elementary
from hysteresis_ros.block import kernel
from hysteresis_ros.references.cycle import AMPLITUDE, COUNTER, END, FINAL, OFFSET, TWO_PI, turns
from hysteresis_ros.references.declaration import WaveformShape, cyclic


@kernel
def sine(p, x, u):
    """Sine around the offset."""
    k = x[COUNTER]
    x[COUNTER] = k + 1.0
    if p[END] > 0.0 and k >= p[END]:
        return p[FINAL]
    return p[OFFSET] + p[AMPLITUDE] * elementary.sin(TWO_PI * turns(p, k))


WAVEFORM = WaveformShape(name="sine", pack=cyclic(sine), periodic=True, fundamental=lambda parameters: 1.0)
