# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The frequency response of an axis from a recording: of one that says how it was excited, or of any other."""

from __future__ import annotations

import pathlib
from dataclasses import replace

from hysteresis_ros.archives import read_arrays
from hysteresis_ros.configuration import parse_configuration
from hysteresis_ros.errors import ConfigurationError, HysteresisError, RecordingError
from hysteresis_ros.identification.excitations import PLACES, Plan
from hysteresis_ros.identification.response_analysis import plan_of_recording
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.simulation.axis_response import AxisResponse, axis_response


def plan_file(recording) -> pathlib.Path:
    """Return the file beside a recording that says how it was excited.

    Parameters
    ----------
    recording : path-like
    """
    recording = pathlib.Path(recording)
    return recording.with_name(f"{recording.stem}_excitation.npz")


def read_plan(path) -> Plan:
    """Return the plan of an excitation.

    Parameters
    ----------
    path : path-like
        Of the samples that were played.

    Raises
    ------
    RecordingError
        The file is missing or holds no plan.
    """
    try:
        return Plan.from_text(str(read_arrays(path)["plan"]))
    except (OSError, ValueError, KeyError):
        raise RecordingError(
            f"{path}: holds no plan of an excitation; give the file that hysteresis frf wrote"
        ) from None


def recorded_response(
    recording: Recording,
    plan: Plan | None,
    loop: str | None = None,
    at: str | None = None,
    period: float | None = None,
    kind: str | None = None,
) -> AxisResponse:
    """Return the response of the axis of a recording.

    Parameters
    ----------
    recording : Recording
        Of regular samples.
    plan : Plan, optional
        How it was excited; without one it is taken for periodic where it repeats, and for noise otherwise.
    loop, at : str, optional
        Without a plan: ``open`` or ``closed``, and where it was excited; by default as the configuration in the
        recording says, and in open loop at the voltage.
    period : float, optional
        Without a plan: of a multisine, or of a segment of noise [s].
    kind : str, optional
        Without a plan: ``multisine`` or ``noise``.

    Raises
    ------
    ConfigurationError
        What was asked does not fit.
    HysteresisError
        The recording has no such response.
    """
    axis = _axis(recording)
    if plan is None:
        feedback = axis is not None and axis.motion_controller.law.feedback
        loop = loop or ("closed" if feedback else "open")
        at = at or PLACES[loop][0]
        if at not in PLACES[loop]:
            raise ConfigurationError(f"--at {at}: with --loop {loop} must be {' or '.join(PLACES[loop])}")
        drive = recording["reference" if loop == "closed" else at]
        plan = replace(plan_of_recording(drive, recording.sample_time, period, kind), loop=loop, at=at)
    elif (loop or plan.loop, at or plan.at) != (plan.loop, plan.at):
        raise ConfigurationError(
            f"--loop, --at: the recording was made with --loop {plan.loop} --at {plan.at}; leave them out"
        )
    known = axis if axis is not None and (plan.loop == "open" or axis.motion_controller.law.feedback) else None
    return axis_response(recording, plan, known)


def _axis(recording: Recording) -> AxisParameters | None:
    """Return the axis of a recording; None where it does not say, or what it says is none."""
    if not recording.configuration:
        return None
    try:
        configuration = parse_configuration(recording.configuration, "configuration of the recording")
        axis = AxisParameters.from_configuration(configuration, str(recording.metadata.get("namespace") or ""))
    except HysteresisError:
        return None
    return axis if axis.inchworm_sequencer is None else None
