# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An axis that is driven in open loop without inverse: its reference, divided by a gain, is the voltage."""

from __future__ import annotations

import pathlib

import numpy as np

from hysteresis_ros.configuration import Configuration
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.models.limits import LimitsParameters

#: Parameters of a controller that is given nothing but the reference; of one whose reference is what was played; and of
#: one that hands it on as it is.
UNFED, PLAYED = {"feedforward__type": "none", "feedforward__preview": 0}, {"learning__type": "none"}
OPEN = {"type": "open_loop", "damping__type": "none", **UNFED, **PLAYED}


def write_samples(path, reference, sample_rate: float, **further) -> str:
    """Write a reference for a waveform of type ``file``, and return its whole path.

    Parameters
    ----------
    path : path-like
        ``.npz``; its folder is made.
    reference : ndarray, shape (N,)
        [m]
    sample_rate : float
        [Hz]
    **further
        Further arrays of the file.

    Raises
    ------
    ConfigurationError
        It cannot be written.
    """
    path = pathlib.Path(path).resolve()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, time=np.arange(reference.size) / sample_rate, reference=reference, **further)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}; choose another place") from None
    return str(path)


def driven(configuration: Configuration, limits: LimitsParameters, gain: float, waveform: dict) -> Configuration:
    """Return the configuration in open loop without inverse, with this waveform.

    Parameters
    ----------
    configuration : Configuration
    limits : LimitsParameters
        Of the compensator.
    gain : float
        Of the compensator without inverse [m/V].
    waveform : dict
        Parameters of the waveform, flat [m]; what the configuration's own says besides does not count.
    """
    plain = {
        "cycles": 0,
        "phase": 0.0,
        "steps.period": 0.0,
        "multisine.first_harmonic": 1,
        "multisine.harmonic_step": 1,
    }
    low, high = (gain * end for end in (limits.minimum, limits.maximum))
    configuration = configuration.override("", exit_at_end=True, autostart=True)
    configuration = configuration.override("motion_controller", **OPEN)
    configuration = configuration.override("hysteresis_compensator", inverse__type="none")
    return configuration.override(
        "reference_generator",
        minimum=low,
        maximum=high,
        initial_setpoint=min(max(0.0, low), high),
        approach__maximum_velocity=0.0,
        approach__maximum_acceleration=0.0,
        approach__maximum_jerk=0.0,
        **{f"waveform.{name}": value for name, value in {**plain, **waveform}.items()},
    )


def following(configuration: Configuration, path: str, rest: float = 0.0) -> Configuration:
    """Return the configuration whose axis follows samples once, from where they begin, and then leaves.

    Parameters
    ----------
    configuration : Configuration
    path : str
        Of :func:`write_samples`.
    rest : float
        Setpoint from which the axis begins [m]; the samples are absolute all the same.
    """
    values = {"type": "file", "cycles": 1, "phase": 0.0, "offset": -rest, "file.path": path, "file.column": "reference"}
    configuration = configuration.override(
        "reference_generator",
        initial_setpoint=rest,
        **{f"approach.maximum_{name}": 0.0 for name in ("velocity", "acceleration", "jerk")},
        **{f"waveform.{name}": value for name, value in values.items()},
    )
    return configuration.override("", exit_at_end=True, autostart=True)
