"""Feedforward inverse of creep: what the hysteresis must give so that both together give the command."""

from __future__ import annotations

from hysteresis_ros.block import kernel
from hysteresis_ros.models.creep import FEEDTHROUGH, crept


@kernel
def creep_inverse(p, x, y):
    """Input [m] at which the creep model gives ``y`` [m] at this sample; its state ``x`` is left as it is.

    Exact at the samples. The model advances by what is really carried out. Without operators the result is ``y``, bit
    for bit.
    """
    return (y - crept(p, x)) / p[FEEDTHROUGH]
