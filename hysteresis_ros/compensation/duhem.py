"""Inverse Duhem equation (Wang, Alici & Tan 2014; W4): the displacement drives, with F, G and α of its own."""

from __future__ import annotations

from hysteresis_ros.block import kernel
from hysteresis_ros.models.duhem import duhem


@kernel
def inverse_duhem(hysteresis, p_i, x_i, p_h, x_h, displacement):
    """Voltage [V] of ``dv = α |dw| [F(w) - v] + G(w) dw`` after w has moved to ``displacement`` [m].

    Unlike the other inverses it follows no model: its own last displacement and voltage are kept in ``x_i`` and go on
    with each call. A call with the same displacement again gives the same voltage.

    Parameters
    ----------
    hysteresis : kernel
        Not used.
    p_i : ndarray
        Parameters of :func:`hysteresis_ros.models.duhem.duhem` with the displacement as input.
    x_i : ndarray, shape (>= 2,)
        Last displacement [m] and last voltage [V].
    p_h, x_h : ndarray
        Not used.
    displacement : float
        Wanted displacement w [m]; NaN gives the last voltage.
    """
    return duhem(p_i, x_i, displacement)
