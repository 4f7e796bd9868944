# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Conversion of linear dynamics to and from python-control and SciPy: ``hr.to_control``, ``hr.from_control``.

A plant is measured at the beginning of a sample, before its input changes. The systems therefore map the input u_k,
held over sample k, to the output y_k at the beginning of sample k. Both are displacements [m], because the gain in m/V
belongs to the hysteresis in front of the dynamics.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from hysteresis_ros.api import Source, configuration_of
from hysteresis_ros.arguments import Seconds, checked
from hysteresis_ros.configuration import Configuration
from hysteresis_ros.errors import ConfigurationError, MissingExtraError, did_you_mean
from hysteresis_ros.identification.workflow import Compared
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.models.linear import SAMPLE_TIME_TOLERANCE, LinearParameters, StateSpace, zero_order_hold

if TYPE_CHECKING:
    import control
    import scipy.signal

__all__ = ["from_control", "to_control", "to_scipy", "with_dynamics"]

#: Parameter group of the linear dynamics: those of the plant, and those of the controller's plant model.
NODES = {"plant_simulator": "dynamics", "motion_controller": "model.dynamics"}
#: A feedthrough below this fraction of the gain counts as a rounding error.
ROUNDING = 1e-9


@checked
def to_control(
    source: Source | Compared, *, node: str = "plant_simulator", namespace: str | None = None
) -> control.StateSpace:
    """Return linear dynamics as a discrete state space of python-control.

    Parameters
    ----------
    source : Identified, Compared, path-like, Configuration, Design or Recording
        An identified model, or an axis, see :func:`.simulate`.
    node : str
        For an axis: ``plant_simulator`` (the plant) or ``motion_controller`` (the controller's model of it).
    namespace : str, optional
        The axis to use, if a configuration contains several.

    Returns
    -------
    control.StateSpace
        From the input of the dynamics [m], held over each sample, to the displacement [m] at the beginning of the
        sample, with the sample time ``dt`` [s]. Hysteresis and creep are not included; a delay is included as states.

    Raises
    ------
    MissingExtraError
        The package python-control is not installed; the message gives the command that installs it.
    ConfigurationError
        The node does not exist, or its dynamics are not linear.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> system = hr.to_control("kim2009")  # doctest: +SKIP
    >>> system.damp()  # doctest: +SKIP
    """
    try:
        import control
    except ImportError:
        raise MissingExtraError("python-control", "control", "to_control needs it") from None
    model, sample_time = sampled_dynamics(source, node, namespace)
    return control.StateSpace(model.A, model.B, model.C, model.D, sample_time, remove_useless_states=False)


@checked
def to_scipy(
    source: Source | Compared, *, node: str = "plant_simulator", namespace: str | None = None
) -> scipy.signal.StateSpace:
    """Return linear dynamics as a discrete state space of SciPy; the same system as :func:`to_control`.

    Parameters
    ----------
    source : Identified, Compared, path-like, Configuration, Design or Recording
        An identified model, or an axis, see :func:`.simulate`.
    node : str
        For an axis: ``plant_simulator`` (the plant) or ``motion_controller`` (the controller's model of it).
    namespace : str, optional
        The axis to use, if a configuration contains several.

    Returns
    -------
    scipy.signal.StateSpace
        With the sample time ``dt`` [s].

    Raises
    ------
    ConfigurationError
        The node does not exist, or its dynamics are not linear.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> system = hr.to_scipy("kim2009")
    >>> round(1.0 / system.dt)
    3000
    """
    model, sample_time = sampled_dynamics(source, node, namespace)
    return scipy.signal.StateSpace(model.A, model.B, model.C, model.D, dt=sample_time)


@checked
def from_control(system: Any, sample_time: Seconds | None = None, *, keep_gain: bool = False) -> LinearParameters:
    """Return a linear system of python-control or SciPy as dynamics of this package.

    Parameters
    ----------
    system : control.StateSpace, control.TransferFunction or a system of scipy.signal
        System with one input and one output, discrete or continuous. A continuous system is sampled with a zero-order
        hold.
    sample_time : float or str, optional
        Sample time [s], or a text with its unit such as ``"1ms"``; required if the system does not state it.
    keep_gain : bool
        Keep the DC gain. By default it is set to 1, because the hysteresis in front of the dynamics contains the
        gain.

    Returns
    -------
    LinearParameters
        ``A``, ``B``, ``C``, ``D`` and ``sample_time`` as in parameter files, for :func:`with_dynamics`.

    Raises
    ------
    ConfigurationError
        The object is not such a system, the sample time is missing or differs, or a discrete system has a feedthrough.
    ParameterError
        The system is unstable, or its DC gain is zero or infinite.

    Examples
    --------
    >>> import hysteresis_ros as hr, scipy.signal
    >>> lag = scipy.signal.lti([1.0], [0.01, 1.0])
    >>> found = hr.from_control(lag, sample_time=0.001)
    >>> round(found.A[0], 6)
    0.904837
    """
    A, B, C, D, stated = _matrices(system)
    if D.shape != (1, 1):
        raise ConfigurationError(f"the system has {D.shape[1]} inputs and {D.shape[0]} outputs: must have one of each")
    given = sample_time if stated in (None, True) else stated
    if given is None:
        raise ConfigurationError("the system states no sample time: give sample_time in seconds")
    if not (np.isfinite(given) and given > 0.0):
        raise ConfigurationError(f"sample_time = {given}: must be above 0 s")
    if sample_time is not None and abs(sample_time - given) > SAMPLE_TIME_TOLERANCE * given:
        raise ConfigurationError(
            f"sample_time = {sample_time:.9g} s: the system is for {given:.9g} s; convert it, or leave sample_time out"
        )
    if stated is None:
        # the plant is measured before its input changes, so the feedthrough acts on the previous input
        A, B = zero_order_hold(A, B, given) if len(A) else (A, B)
    else:
        model = StateSpace(A, B, C, D)
        if abs(D.item()) > ROUNDING * abs(model.dc_gain):
            raise ConfigurationError(
                f"the discrete system has a feedthrough D = {D.item():.6g}: a plant is measured before its input "
                "changes; delay the system by one sample, or give the continuous system and sample_time"
            )
        D = np.zeros((1, 1))
    return LinearParameters(
        A=tuple(map(float, A.ravel())),
        B=tuple(map(float, B.ravel())),
        C=tuple(map(float, C.ravel())),
        D=(float(D.item()),) if D.item() else (),
        input_scale=1.0 if keep_gain else 0.0,
        sample_time=float(given),
    ).validated()


@checked
def with_dynamics(config: Source, dynamics: Any, *, node: str = "plant_simulator") -> Configuration:
    """Return a configuration with other linear dynamics.

    Parameters
    ----------
    config : path-like, Configuration, Identified, Design or Recording
        The axis, see :func:`.simulate`.
    dynamics : LinearParameters, or a system of python-control or scipy.signal
        Result of :func:`from_control`, or a system that it accepts. Such a system is converted with a DC gain of 1, a
        continuous one at the sample rate of the axis.
    node : str
        ``plant_simulator`` (the plant), or ``motion_controller`` (the model that the controller assumes).

    Returns
    -------
    Configuration
        For :func:`.simulate` and :func:`.design`.

    Raises
    ------
    ConfigurationError
        The node does not exist, or ``dynamics`` is not such a system.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> lag = hr.from_control(hr.to_scipy("kim2009"))
    >>> run = hr.simulate(hr.with_dynamics("kim2009", lag), duration=0.01)
    """
    group, configuration = _group(node), configuration_of(config)
    if not isinstance(dynamics, LinearParameters):
        dynamics = from_control(dynamics, 1.0 / single_axis(configuration).plant_simulator.sample_rate)
    values = {f"{group}.{name}": value for name, value in dynamics.to_mapping().items()}
    return configuration.override(node, **values)


def _group(node: str) -> str:
    """Return the parameter group with the linear dynamics of a node."""
    if node not in NODES:
        there = ", ".join(NODES)
        raise ConfigurationError(f"node = {node!r}: must be one of {there}{did_you_mean(node, NODES)}")
    return NODES[node]


def sampled_dynamics(source: Any, node: str, namespace: str | None) -> tuple[StateSpace, float]:
    """Return linear dynamics in SI units, from held input to output, and the sample time [s]."""
    group = _group(node)
    if isinstance(source, Compared):
        if not source.plant.invertible:
            kind = source.plant.hysteresis.type
            raise ConfigurationError(f"{kind}: its dynamics are part of the hysteresis and not linear")
        if node != "plant_simulator":
            raise ConfigurationError(f"node = {node!r}: an identification gives the plant; leave node out")
        dynamics, sample_time = source.plant.dynamics, source.plant.sample_time
    else:
        axis = single_axis(configuration_of(source), namespace)
        value: Any = getattr(axis, node)
        for part in group.split("."):
            value = getattr(value, part)
        hysteresis = getattr(getattr(axis, node), "hysteresis", None)
        if hysteresis is not None and hysteresis.type != "none" and not hysteresis.model.block.invertible:
            raise ConfigurationError(f"{hysteresis.type}: its dynamics are part of the hysteresis and not linear")
        dynamics, sample_time = value, 1.0 / axis.plant_simulator.sample_rate
    model = dynamics.state_space.scaled(dynamics.output_scale / dynamics.resolved_input_scale)
    return (model.held() if np.any(model.D) else model), sample_time


def _matrices(system: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Any]:
    """Return A, B, C, D and the sample time: None for a continuous system, True for a discrete one without a time."""
    home = type(system).__module__.partition(".")[0]
    if home == "control":
        import control

        if not isinstance(system, (control.StateSpace, control.TransferFunction)):
            raise ConfigurationError(f"system is a {type(system).__name__}: must be a StateSpace or a TransferFunction")
        found = control.ss(system)
        stated = None if found.isctime() else found.dt
    elif home == "scipy" and hasattr(system, "to_ss"):
        found = system.to_ss()
        stated = found.dt
    else:
        raise ConfigurationError(
            f"system is a {type(system).__name__}: must be a StateSpace or TransferFunction of python-control, or of "
            "scipy.signal"
        )
    A, B, C, D = (np.atleast_2d(np.asarray(part, dtype=float)) for part in (found.A, found.B, found.C, found.D))
    for name, part in zip("ABCD", (A, B, C, D), strict=True):
        if not np.all(np.isfinite(part)):
            raise ConfigurationError(f"the system's {name} = {part.tolist()}: must be finite numbers")
    n = A.shape[0] if A.size else 0
    return A.reshape(n, n), B.reshape(n, -1) if n else np.zeros((0, D.shape[1])), C[:, :n], D, stated
