"""A whole offline run as a recording: what ``hysteresis simulate`` writes and what ``--verify`` compares with."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.recordings.dataset import INCHWORM_UNITS, Recording
from hysteresis_ros.recordings.replay import requests_per_sample
from hysteresis_ros.simulation.axis import Axis, AxisParameters, axes
from hysteresis_ros.simulation.inchworm_axis import InchwormAxis

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


def build_axis(parameters: AxisParameters) -> Axis | InchwormAxis:
    """Return the blocks of an axis: those of an inchworm where it has a sequencer."""
    return Axis(parameters) if parameters.inchworm_sequencer is None else InchwormAxis(parameters)


def simulate(
    parameters: AxisParameters,
    *,
    duration: float | None = None,
    setpoints=None,
    requests=None,
    speeds=None,
    describe: bool = True,
) -> Recording:
    """Run an axis offline from rest.

    Parameters
    ----------
    parameters : AxisParameters
        The axis.
    duration : float, optional
        Length [s]; by default that of ``setpoints``, the parameter ``samples`` or the waveform.
    setpoints : array_like, shape (N,), optional
        Setpoint in force at each sample [m]; the last one holds. ``initial_setpoint`` by default.
    requests, speeds : array_like, shape (N,), optional
        What was asked of an inchworm at each sample, see :meth:`InchwormAxis.run`; nothing after the last one.
    describe : bool
        Put the text of the configuration into the metadata; writing it takes longer than a short run.

    Raises
    ------
    ConfigurationError
        Neither the configuration nor the arguments say how long the run is.
    """
    if duration is not None:
        parameters = parameters.with_duration(duration)
    axis = build_axis(parameters)
    if duration is not None:
        samples = parameters.plant_simulator.samples
    else:
        samples = len(setpoints) if setpoints is not None else axis.default_samples()
    if samples < 1:
        raise ConfigurationError("the configuration has no end (samples: 0, endless waveform): give --duration S")
    setpoints = axis.default_setpoints(samples) if setpoints is None else _padded(setpoints, samples, setpoints[-1])
    asked = {"requests": (requests, 0.0), "speeds": (speeds, np.nan)}
    given = {name: _padded(values, samples, rest) for name, (values, rest) in asked.items() if values is not None}
    signals = axis.run(setpoints, **given)
    metadata = {
        "configuration": parameters.configuration_text() if describe else "",
        "namespace": parameters.namespace,
        "source": "offline simulation",
        "joint": parameters.plant_simulator.joint,
    }
    units = {name: unit for name, unit in INCHWORM_UNITS.items() if name in signals}
    return Recording(signals.pop("time"), signals, units, metadata)


def _padded(values, samples: int, rest: float) -> np.ndarray:
    """Return the first values, followed by ``rest`` up to the number of samples."""
    values = np.asarray(values, dtype=float)[:samples]
    return np.concatenate([values, np.full(samples - len(values), rest)])


def differences(recorded: Recording, parameters: AxisParameters) -> dict[str, int]:
    """Compare a recorded lockstep run with its offline twin, bit for bit.

    Returns
    -------
    dict of str to int
        Number of differing samples of each signal that differs; empty when all agree.
    """
    twin = simulate(parameters, setpoints=recorded.signals["setpoint"], **requests_per_sample(recorded))
    columns = {"time": (recorded.time, twin.time)}
    names = VERIFIED if parameters.inchworm_sequencer is None else (*VERIFIED, *INCHWORM_UNITS)
    columns |= {name: (recorded.signals[name], twin.signals[name]) for name in names}
    found = {}
    for name, (ours, theirs) in columns.items():
        count = int(np.count_nonzero(np.asarray(ours).view(np.int64) != np.asarray(theirs).view(np.int64)))
        if count:
            found[name] = count
    return found
