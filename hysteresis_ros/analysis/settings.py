"""What plots and figures take from the configuration in a recording."""

from __future__ import annotations

from dataclasses import dataclass

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
    """

    voltage_minimum: float | None = None
    voltage_maximum: float | None = None
    offset: float = 0.0


def axis_settings(recording: Recording) -> AxisSettings:
    """Return the settings of the recording's configuration; whatever it does not say is None or 0."""
    text, namespace = recording.configuration, str(recording.metadata.get("namespace", ""))
    limits = {
        **_group(configured(text, "plant_simulator", namespace), "limits."),
        **_group(configured(text, "hysteresis_compensator", namespace), "limits."),
    }
    preload = _group(configured(text, "motion_controller", namespace), "model.preload.")
    return AxisSettings(_number(limits.get("minimum")), _number(limits.get("maximum")), _offset(preload))


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
