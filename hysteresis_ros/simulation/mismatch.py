"""Plants that are not what their models say: parameters of the plant drawn around those of the configuration.

Each draw multiplies by independent factors 1 + m u, u uniform in ±1: the gain, the opening of the hysteresis (where the
model has several weights each of them besides), the time scale of the linear dynamics and the rate of the creep. The
compensator's and the controller's models stay as they are.
"""

from __future__ import annotations

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.simulation.run import single_axis

#: Largest mismatch that leaves every drawn parameter its sign with a margin.
LARGEST = 0.5


def mismatched(configuration: Configuration, mismatch: float, seed: int) -> Configuration:
    """Return the configuration with a plant drawn around the configured one.

    Parameters
    ----------
    configuration : Configuration
        One axis.
    mismatch : float
        m, largest relative deviation of each factor, 0 … 0.5.
    seed : int
        Seed of the draw; equal seeds give equal plants.

    Raises
    ------
    ParameterError
        The mismatch is out of range, or the configuration is wrong.
    """
    if not 0.0 <= mismatch <= LARGEST:
        raise ParameterError([Problem("mismatch", mismatch, f"must be within 0 … {LARGEST:g}")])
    plant = single_axis(configuration).plant_simulator
    random = np.random.default_rng(seed)

    def factor(count=None):
        return 1.0 + mismatch * random.uniform(-1.0, 1.0, count)

    # always in this order, so that a seed means the same factors for every model
    gain, opening, slowness, creeping = factor(), factor(), factor(), factor()
    kind = plant.hysteresis.type
    values = _hysteresis(kind, plant.hysteresis.chosen, gain, opening, factor)
    changed = {f"hysteresis.{kind}.{name}": value for name, value in values.items()}
    changed |= {f"dynamics.{name}": value for name, value in slowed(plant.dynamics, slowness).items()}
    if plant.creep.type == "logarithmic":
        changed["creep.logarithmic.rate"] = plant.creep.logarithmic.rate * creeping
    elif plant.creep.type == "operators":
        changed["creep.operators.weights"] = (np.array(plant.creep.operators.weights) * creeping).tolist()
    return configuration.override("plant_simulator", **changed)


def slowed(dynamics: LinearParameters, slowness: float) -> dict:
    """Return the matrices A and B of the dynamics with all times longer by a factor: poles z^(1/slowness).

    The DC gain stays. Dynamics with a pole on the negative real axis or at zero belong to no continuous model; there
    only the other poles move.

    Parameters
    ----------
    dynamics : LinearParameters
        Discrete dynamics.
    slowness : float
        Factor on every time constant and period.

    Returns
    -------
    dict
        ``A`` and ``B`` as lists; empty without dynamics.
    """
    if not dynamics.order:
        return {}
    A, B, _, _ = dynamics.matrices
    poles, vectors = np.linalg.eig(A.astype(complex))
    continuous = (poles.imag != 0.0) | (poles.real > 0.0)
    moved = np.where(continuous, np.exp(np.log(np.where(continuous, poles, 1.0)) / slowness), poles)
    changed = np.real(vectors @ np.diag(moved) @ np.linalg.inv(vectors))
    identity = np.eye(len(A))
    rest = np.linalg.solve(identity - A, B)  # the state at rest per unit of input, which is to stay
    return {"A": changed.ravel().tolist(), "B": ((identity - changed) @ rest).tolist()}


def _hysteresis(kind: str, values, gain: float, opening: float, factor) -> dict:
    """Return the changed parameters of a hysteresis model."""
    if kind == "proportional":
        return {"gain": values.gain * gain}
    if kind == "polynomial":
        return _polynomial(values, gain, opening)
    if kind == "bouc_wen":
        alpha, beta, gamma = np.array([values.alpha, values.beta, values.gamma]) * factor(3)
        return {"d_e": values.d_e * gain, "alpha": alpha * gain * opening, "beta": beta, "gamma": gamma}
    if kind == "bouc_wen_mechanical":
        names = ("mass", "damping", "stiffness", "alpha", "beta", "gamma", "delta")
        return {name: getattr(values, name) * factor() for name in names}
    if kind == "duhem":
        ends = {name: getattr(values, name) * gain for name in ("output_low", "output_high", "output_start")}
        return {**ends, "alpha": values.alpha * opening}
    if kind == "prandtl_ishlinskii":
        weights = np.array(values.weights) * gain
        plays = np.array(values.radii) > 0.0
        weights[plays] *= opening * factor(int(np.sum(plays)))
        return {"weights": weights.tolist(), "thresholds": (np.array(values.thresholds) * gain).tolist()}
    return {"everett": (np.array(values.everett) * gain * opening).tolist(), "slope": values.slope * gain}


def _polynomial(values, gain: float, opening: float) -> dict:
    """Scale all coefficients by the gain and the difference of the branches by the opening; the corners stay joined."""
    changed: dict = {"scale": values.scale * gain}
    for name in ("C1", "C2"):
        rising, falling = (np.array(getattr(values, f"{branch}_{name}")) for branch in ("rising", "falling"))
        middle, half = 0.5 * (rising + falling), 0.5 * (rising - falling)
        changed[f"rising_{name}"] = (middle + opening * half).tolist()
        changed[f"falling_{name}"] = (middle - opening * half).tolist()
    return changed
