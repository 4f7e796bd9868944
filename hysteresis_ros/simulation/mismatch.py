"""Plants that are not what their models say: parameters of the plant drawn around those of the configuration.

Each draw multiplies by independent factors 1 + m u, u uniform in ±1: the gain, the opening of the hysteresis (how, and
by which factors besides, each model declares), the time scale of the linear dynamics and the rate of the creep. The
compensator's and the controller's models stay as they are.
"""

from __future__ import annotations

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.linear_algebra import product, rounded, solve
from hysteresis_ros.models.declaration import Deviation
from hysteresis_ros.models.linear import LinearParameters
from hysteresis_ros.simulation.axes import single_axis

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
    model, configured = plant.hysteresis.model, plant.hysteresis.chosen.to_mapping()
    drawn = model.deviated(plant.hysteresis.chosen, Deviation(gain, opening, factor)).to_mapping()
    changed = {
        f"hysteresis.{model.name}.{name}": value for name, value in drawn.items() if value != configured.get(name)
    }
    changed |= {f"dynamics.{name}": value for name, value in slowed(plant.dynamics, slowness).items()}
    if plant.creep.type == "logarithmic":
        changed["creep.logarithmic.rate"] = plant.creep.logarithmic.rate * creeping
    elif plant.creep.type == "operators":
        changed["creep.operators.weights"] = (np.array(plant.creep.operators.weights) * creeping).tolist()
    return configuration.override("plant_simulator", **changed)


def slowed(dynamics: LinearParameters, slowness: float) -> dict:
    """Return what changes of the dynamics with all times longer by a factor: poles z^(1/slowness), and the delay.

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
        ``A`` and ``B`` as lists where there are matrices, ``delay`` where there is one.
    """
    delayed = {"delay": dynamics.delay * slowness} if dynamics.delay else {}
    model = dynamics.matrices
    if not model.order:
        return delayed
    A, B = model.A, model.B[:, 0]
    poles, vectors = np.linalg.eig(A.astype(complex))
    continuous = (poles.imag != 0.0) | (poles.real > 0.0)
    moved = np.where(continuous, np.exp(np.log(np.where(continuous, poles, 1.0)) / slowness), poles)
    exact = np.real(vectors @ np.diag(moved) @ np.linalg.inv(vectors))
    # logarithms and eigenvectors differ in the last digits from processor to processor
    changed = rounded(exact)
    identity = np.eye(len(A))
    rest = solve(identity - A, B)  # the state at rest per unit of input, which is to stay
    return {"A": changed.ravel().tolist(), "B": product(identity - changed, rest).tolist(), **delayed}
