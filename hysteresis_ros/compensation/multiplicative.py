"""Inverse multiplicative structure for Bouc-Wen hysteresis (Auwal et al.; B5): V = (ψ + h)/d_e, h the model's own."""

from __future__ import annotations

from hysteresis_ros.block import kernel
from hysteresis_ros.models.bouc_wen import D_E, H, hysteretic_part, slope_of_h
from hysteresis_ros.models.rate_independent import DISPLACEMENT, VOLTAGE

#: Newton's steps; three or four suffice where the loop is monotone.
MOST_STEPS = 50
TOLERANCE = 4.0e-16


@kernel
def multiplicative(hysteresis, p_i, x_i, p_h, x_h, displacement):
    """Voltage [V] that solves V = (ψ + h(V))/d_e, h being the hysteretic part after the step to V itself.

    Solved by Newton's method with the slope of h from the model's own equation. Where the loop is not monotone (see
    the warnings of the parameters) a step V = (ψ + h)/d_e takes its place. ``x_h`` is left as it is.

    Parameters
    ----------
    hysteresis : kernel
        Not used: the model is :func:`hysteresis_ros.models.bouc_wen.bouc_wen`.
    p_i, x_i : ndarray
        Not used.
    p_h, x_h : ndarray
        Parameters and state of the Bouc-Wen model.
    displacement : float
        Wanted output ψ [m]; NaN gives the last voltage.
    """
    start = x_h[VOLTAGE]
    if not abs(displacement - x_h[DISPLACEMENT]) > 0.0:
        return start
    direction = 1.0 if displacement > x_h[DISPLACEMENT] else -1.0
    d_e = p_h[D_E]
    voltage, h = start, x_h[H]
    for _ in range(MOST_STEPS):
        change = (displacement + h) / d_e - voltage
        slope = 1.0 - slope_of_h(p_h, direction * h) / d_e
        if slope > 1e-3:
            change /= slope
        following = voltage + change
        if direction * (following - start) < 0.0:
            following = start  # the solution lies ahead
        moved = abs(following - voltage)
        voltage = following
        if moved <= TOLERANCE * (abs(voltage) + abs(voltage - start)):
            break
        h = hysteretic_part(p_h, x_h, voltage)
    return voltage
