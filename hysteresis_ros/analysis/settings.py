# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What plots and figures take from the configuration in a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.recordings.configured import configured
from hysteresis_ros.recordings.dataset import Recording


@dataclass(frozen=True)
class AxisSettings:
    """Settings that matter for judging a run.

    Parameters
    ----------
    voltage_minimum, voltage_maximum : float or None
        Limits of the compensator, or of the plant where those are not given [V].
    offset : float
        Preload offset W of the controller's model, which is not part of the reference [m].
    preview : int
        Samples that the recorded reference is ahead of what the controller follows.
    """

    voltage_minimum: float | None = None
    voltage_maximum: float | None = None
    offset: float = 0.0
    preview: int = 0


def axis_settings(recording: Recording) -> AxisSettings:
    """Return the settings of the recording's configuration; whatever it does not say is None or 0."""
    text, namespace = recording.configuration, str(recording.metadata.get("namespace", ""))
    limits = {
        **_group(configured(text, "plant_simulator", namespace), "limits."),
        **_group(configured(text, "hysteresis_compensator", namespace), "limits."),
    }
    controller = configured(text, "motion_controller", namespace)
    preview = controller.get("feedforward.preview", 0)
    return AxisSettings(
        _number(limits.get("minimum")),
        _number(limits.get("maximum")),
        _offset(_group(controller, "model.preload.")),
        preview if isinstance(preview, int) and not isinstance(preview, bool) and preview > 0 else 0,
    )


def judged_reference(recording: Recording, preview: int | None = None) -> np.ndarray:
    """Return the reference that the displacement is judged by, shape (N,) [m].

    With a preview of P samples that is the recorded one P samples later. What came before the recording is taken to
    be its first reference; where the sample to look back to is missing, or left out of an excerpt, NaN.

    Parameters
    ----------
    recording : Recording
        Needs ``reference``.
    preview : int, optional
        What its configuration says, for who knows it already.
    """
    reference, preview = recording["reference"], axis_settings(recording).preview if preview is None else preview
    if not preview or len(reference) < 2:
        return reference
    # by time and not by place: samples may be missing
    numbers = np.rint((recording.time - recording.time[0]) / recording.sample_time).astype(np.int64)
    places = np.minimum(np.searchsorted(numbers, numbers - preview), len(numbers) - 1)
    found = np.where(numbers[places] == numbers - preview, reference[places], np.nan)
    before = np.nan if recording.metadata.get("excerpt") else reference[0]
    return np.where(numbers < preview, before, found)


def delayed(reference, preview: int) -> np.ndarray:
    """Return the reference to be followed at each sample when the one received is ``preview`` samples ahead.

    Parameters
    ----------
    reference : array, shape (N,)
        As received [m], no sample missing; before it, its first value.
    preview : int
        Samples.
    """
    if preview == 0:
        return reference
    return np.concatenate([np.full(preview, reference[0]), reference])[: len(reference)]


def _offset(values: dict) -> float:
    if not values:
        return 0.0
    from hysteresis_ros.models.preload import PreloadParameters

    try:
        return float(PreloadParameters.from_mapping(values).offset)
    except HysteresisError:
        return 0.0


def _group(values: dict, start: str) -> dict:
    return {name[len(start) :]: value for name, value in values.items() if name.startswith(start)}


def _number(value) -> float | None:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None
