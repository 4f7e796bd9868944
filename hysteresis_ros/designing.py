# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.


"""Designs in Python: ``hr.design``, ``hr.design_learning``, ``hr.frequency_response``, ``hr.mismatched``. SI units.

The commands ``hysteresis design`` and ``hysteresis frf`` do the same.
"""

from __future__ import annotations

import os
import pathlib
import tempfile
from typing import Any

from hysteresis_ros.api import RECORDINGS, Design, DesignedLearning, Response, Source, configuration_of
from hysteresis_ros.arguments import Hertz, Metres, Seconds, Share, checked
from hysteresis_ros.configuration import Configuration, normalised_namespace, parse_configuration
from hysteresis_ros.control.uncertainty import Uncertainty
from hysteresis_ros.designs.controller import (
    DesignRequest,
    design_axis,
    design_file,
    design_lines,
    doubts,
    response_uncertainty,
)
from hysteresis_ros.designs.frequency_response import (
    AxisResponse,
    ResponseRequest,
    axis_response,
    plan_file,
    read_plan,
    recorded_response,
    response_run,
)
from hysteresis_ros.designs.learning import LearningRequest, learning_file, learning_lines, with_known_noise
from hysteresis_ros.designs.learning import design_learning as design_correction
from hysteresis_ros.designs.learning_filters import KINDS
from hysteresis_ros.designs.measured import measured_lines, measured_uncertainty
from hysteresis_ros.designs.setpoint_step import step_lines
from hysteresis_ros.errors import ConfigurationError, did_you_mean
from hysteresis_ros.identification.excitations import Experiment
from hysteresis_ros.identification.frequency_response import load_response
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import mismatched as mismatched_configuration
from hysteresis_ros.loop.simulation import simulate as simulate_axis
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run

__all__ = [
    "Design",
    "DesignedLearning",
    "Experiment",
    "Response",
    "Uncertainty",
    "design",
    "design_learning",
    "frequency_response",
    "mismatched",
]


@checked
def design(
    config: Source,
    controller: str,
    *,
    bandwidth: Hertz | None = None,
    q: float | None = None,
    criterion: str | None = None,
    duration: Seconds | None = None,
    feedforward: bool = False,
    preview: int | None = None,
    noise: Metres | None = None,
    robust: Uncertainty | None = None,
    damping: str | None = None,
    response: str | os.PathLike[str] | Response | None = None,
    namespace: str | None = None,
) -> Design:
    """Design a controller for its own model of the plant (``motion_controller: model.dynamics``).

    Parameters
    ----------
    config : path-like, Configuration, Identified, Design or Recording
        The axis, see :func:`.simulate`.
    controller : str
        ``pid``, ``smc``, ``integral_smc``, ``super_twisting`` or ``offset_free``.
    bandwidth : float or str, optional
        -3 dB bandwidth from reference to displacement [Hz].
    q : float, optional
        Kalman filter: ratio of the process noise variance at the input to the measurement noise variance.
    criterion : str, optional
        For ``pid``: tune the gains on the waveform by ``iae``, ``ise`` or ``itae``.
    duration : float or str, optional
        Length of the run that ``criterion`` evaluates [s].
    feedforward : bool
        Add the inverse of the dynamics as feedforward.
    preview : int, optional
        With ``feedforward``: number of samples by which the reference is known in advance; by default as many as the
        inverse needs.
    noise : float or str, optional
        RMS noise of the sensor [m], which limits the bandwidth; by default 0.01 % of the stroke.
    robust : Uncertainty, optional
        Plants around the model; the design keeps the margins for each of these plants
        (:class:`hysteresis_ros.control.uncertainty.Uncertainty`).
    damping : str, optional
        Damp the resonance of the model first: ``irc``, ``ppf``, ``iff`` or ``notch``; ``none`` removes the damping that
        the file contains.
    response : path-like or Response, optional
        Measured frequency response, see :func:`frequency_response`: the design tolerates the difference between this
        response and the model, and the margins are evaluated on this response.
    namespace : str, optional
        The axis to use, if a configuration contains several.

    Returns
    -------
    Design
        With ``parameters``, ``margins``, ``warnings`` and ``save(path)``; ``print`` shows a table.

    Raises
    ------
    ConfigurationError
        The configuration cannot be read, or two arguments exclude each other.
    ParameterError
        No design exists for the model; the message gives the reason.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> found = hr.design("kim2009", "offset_free", bandwidth=200.0)
    >>> run = hr.simulate(found, duration=0.01)
    """
    if not isinstance(robust, (Uncertainty, type(None))):
        raise ConfigurationError(f"robust is of type {type(robust).__name__}: must be Uncertainty, see hr.Uncertainty")
    configuration = _designed_for(config)
    axis = single_axis(configuration, namespace)
    request = DesignRequest(controller, bandwidth, q, criterion, duration, feedforward, preview, noise, robust, damping)
    measured = None
    if response is not None:
        measured = response.plant if isinstance(response, Response) else load_response(response)
    known = response_uncertainty(configuration) if measured is None else measured_uncertainty(axis, measured)
    found = design_axis(axis, request, known)
    text = design_file(configuration, found, normalised_namespace(axis.namespace))
    lines = [*step_lines(text, axis.namespace or None, feedforward), *design_lines(found)]
    lines += [] if measured is None else measured_lines(axis, found, measured)
    return Design(tuple(lines), text, found.parameters, found.margins, tuple(doubts(found)))


def _designed_for(config: Source) -> Configuration:
    """Return the configuration into which a design is written; the faults of a recorded run belong to this run only."""
    given = configuration_of(config)
    if isinstance(config, Recording) and any(values.get("faults") for _, values in given.entries):
        given = given.override("", faults=[])
    return parse_configuration(given.text, given.source)


@checked
def design_learning(
    config: Source,
    learning: str,
    *,
    period: Seconds | None = None,
    bandwidth: Hertz | None = None,
    maximum: Metres | None = None,
    namespace: str | None = None,
) -> DesignedLearning:
    """Design iterative learning for the periods of a scan, with the controller and the model of a configuration.

    Parameters
    ----------
    config : path-like, Configuration, Identified, Design or Recording
        The axis, see :func:`.simulate`.
    learning : str
        ``inversion``, ``norm_optimal`` or ``repetitive``.
    period : float or str, optional
        Period of the reference [s]; by default the period of the waveform.
    bandwidth : float or str, optional
        Bandwidth of the learning [Hz]; by default the bandwidth with the least error from noise and reference or, if
        the sensor has no noise, the highest bandwidth at which learning converges on all possible plants.
    maximum : float or str, optional
        Largest correction [m]; by default 10 % of the stroke.
    namespace : str, optional
        The axis to use, if a configuration contains several.

    Returns
    -------
    DesignedLearning
        With ``parameters`` and ``save(path)``; ``print`` shows a table.

    Raises
    ------
    ConfigurationError
        The kind of learning does not exist, the period is unknown, or no learning converges.
    ParameterError
        The period is not a whole number of samples.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> axis = hr.design("kim2009", "offset_free", bandwidth=200.0)
    >>> learned = hr.design_learning(axis, "inversion", period=0.1)  # doctest: +SKIP
    """
    if learning not in KINDS:
        there = ", ".join(sorted(KINDS))
        raise ConfigurationError(f"learning = '{learning}': must be one of {there}{did_you_mean(learning, KINDS)}")
    configuration = _designed_for(config)
    axis = single_axis(configuration, namespace)
    request = LearningRequest(learning, period, bandwidth, maximum)
    found = design_correction(with_known_noise(axis, configuration), request, response_uncertainty(configuration))
    text = learning_file(configuration, found, normalised_namespace(axis.namespace))
    return DesignedLearning(tuple(learning_lines(found)), text, found.parameters)


@checked
def frequency_response(
    source: Source,
    experiment: Experiment | None = None,
    *,
    loop: str | None = None,
    at: str | None = None,
    amplitude: str | float | None = None,
    offset: str | float | None = None,
    namespace: str | None = None,
) -> Response:
    """Measure the frequency response of the simulated plant of a configuration, or estimate it from a recording.

    Parameters
    ----------
    source : path-like, Configuration, Identified, Design or Recording
        An axis, see :func:`.simulate`; or a recording (a run, or its file), for which ``experiment``, ``amplitude`` and
        ``offset`` must be left out.
    experiment : Experiment, optional
        Kind, band and length of the excitation: ``hr.Experiment("stepped", low=10.0, high=500.0)``; by default an odd
        random-phase multisine.
    loop : str, optional
        ``open`` or ``closed``; by default ``open`` for a configuration.
    at : str, optional
        Signal to which the excitation is added: ``voltage``, ``command`` or ``reference``.
    amplitude : str or float, optional
        Peak of the excitation: ``"2V"``, ``"500nm"``, or a fraction of the range; by default 0.05.
    offset : str or float, optional
        Operating point: ``"40V"``, ``"30um"``, or a fraction of the range; by default the middle of the range.
    namespace : str, optional
        The axis to use, if there are several.

    Returns
    -------
    Response
        With ``plant``, ``loop``, ``margins``, ``figures`` and ``save(path)``; ``print`` shows a table.

    Raises
    ------
    ConfigurationError
        The request is not possible for the axis.
    HysteresisError
        The excitation is below the noise, or the recording does not contain this response.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> found = hr.frequency_response("kim2009", hr.Experiment(low=20.0, high=800.0, period=0.25, realisations=2))
    >>> found.figures["lines"] > 50
    True
    """
    recorded = isinstance(source, Recording)
    if isinstance(source, (str, os.PathLike)):
        path = pathlib.Path(source)
        recorded = path.suffix.lower() in RECORDINGS or path.is_dir()
    if recorded:
        if (experiment, amplitude, offset) != (None, None, None):
            raise ConfigurationError(
                "the excitation of a recording cannot be changed; leave out experiment, amplitude and offset"
            )
        return _of_recording(source, loop, at, namespace)
    sizes = (None if size is None else str(size) for size in (amplitude, offset))
    asked = ResponseRequest(experiment or Experiment(), loop or "open", at, *sizes)
    configuration = configuration_of(source)
    with tempfile.TemporaryDirectory(prefix="hysteresis_") as folder:
        axis, plan = response_run(configuration, namespace, asked, pathlib.Path(folder) / "excitation.npz")
        run = simulate_axis(axis)
    return _response(axis_response(run, plan, single_axis(configuration, namespace)))


def _of_recording(source: Any, loop: str | None, at: str | None, namespace: str | None) -> Response:
    """Return the response of a recording or of its file; a file next to it may contain the plan of the excitation."""
    if isinstance(source, Recording):
        return _response(recorded_response(source, None, loop, at))
    plan = read_plan(plan_file(source)) if plan_file(source).exists() else None
    return _response(recorded_response(load_run(source, namespace, further=True), plan, loop, at))


def _response(found: AxisResponse) -> Response:
    return Response(**vars(found))


@checked
def mismatched(config: Source, mismatch: Share = 0.05, seed: int = 1, *, namespace: str | None = None) -> Configuration:
    """Return a random plant close to the configured plant: gain, loop width, creep and time constants vary.

    Parameters
    ----------
    config : path-like, Configuration, Identified, Design or Recording
        The axis, see :func:`.simulate`.
    mismatch : float or str
        Largest relative deviation of each factor, 0 … 0.5.
    seed : int
        Equal seeds give equal plants.
    namespace : str, optional
        The axis to use, if a configuration contains several.

    Returns
    -------
    Configuration
        The configuration with this plant, for :func:`.simulate`; the controller keeps its model of the configured
        plant.

    Raises
    ------
    ConfigurationError
        The configuration cannot be read, or contains several axes.
    ParameterError
        The mismatch is out of range.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> run = hr.simulate(hr.mismatched("kim2009", 0.05, seed=2), duration=0.01)
    """
    configuration = configuration_of(config)
    if namespace is not None:
        configuration = parse_configuration(
            single_axis(configuration, namespace).configuration_text(), configuration.source
        )
    return mismatched_configuration(configuration, mismatch, seed)
