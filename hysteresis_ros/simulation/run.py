"""A whole offline run as a recording: what ``hysteresis simulate`` writes and what ``--verify`` compares with."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.simulation.axis import Axis, AxisParameters, axes

#: Signals that must agree bit for bit between a lockstep run of the nodes and its offline twin.
VERIFIED = ("setpoint", "reference", "command", "voltage", "displacement", "measured", "estimated")


def single_axis(configuration: Configuration, namespace: str | None = None) -> AxisParameters:
    """Return the only axis of a configuration, or the one in ``namespace``.

    Raises
    ------
    ConfigurationError
        There are several and none was chosen.
    ParameterError
        A parameter is wrong.
    """
    found = axes(configuration, namespace)
    if len(found) > 1:
        names = ", ".join(axis.namespace for axis in found)
        raise ConfigurationError(f"{configuration.source}: holds several axes ({names}); choose one with --namespace")
    return found[0]


def simulate(parameters: AxisParameters, *, duration: float | None = None, setpoints=None) -> Recording:
    """Run an axis offline from rest.

    Parameters
    ----------
    parameters : AxisParameters
        The axis.
    duration : float, optional
        Length [s]; by default that of ``setpoints``, the parameter ``samples`` or the waveform.
    setpoints : array_like, shape (N,), optional
        Setpoint in force at each sample [m]; the last one holds. ``initial_setpoint`` by default.

    Raises
    ------
    ConfigurationError
        Neither the configuration nor the arguments say how long the run is.
    """
    if duration is not None:
        parameters = parameters.with_duration(duration)
    axis = Axis(parameters)
    if duration is not None:
        samples = parameters.plant_simulator.samples
    else:
        samples = len(setpoints) if setpoints is not None else axis.default_samples()
    if samples < 1:
        raise ConfigurationError("the configuration has no end (samples: 0, endless waveform): give --duration S")
    if setpoints is None:
        setpoints = np.full(samples, parameters.reference_generator.initial_setpoint)
    else:
        setpoints = np.asarray(setpoints, dtype=float)[:samples]
        setpoints = np.concatenate([setpoints, np.full(samples - len(setpoints), setpoints[-1])])
    signals = axis.run(setpoints)
    metadata = {
        "configuration": parameters.configuration_text(),
        "namespace": parameters.namespace,
        "source": "offline simulation",
        "joint": parameters.plant_simulator.joint,
    }
    return Recording(signals.pop("time"), signals, metadata=metadata)


def differences(recorded: Recording, parameters: AxisParameters) -> dict[str, int]:
    """Compare a recorded lockstep run with its offline twin, bit for bit.

    Returns
    -------
    dict of str to int
        Number of differing samples of each signal that differs; empty when all agree.
    """
    twin = simulate(parameters, setpoints=recorded.signals["setpoint"])
    columns = {"time": (recorded.time, twin.time)}
    columns |= {name: (recorded.signals[name], twin.signals[name]) for name in VERIFIED}
    found = {}
    for name, (ours, theirs) in columns.items():
        count = int(np.count_nonzero(np.asarray(ours).view(np.int64) != np.asarray(theirs).view(np.int64)))
        if count:
            found[name] = count
    return found
