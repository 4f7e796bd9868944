# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Inverse validation: the measured displacement goes in, the voltage that caused it should come back.

The lag is undone with a smoothed derivative (which may look ahead, unlike on a running axis), creep and hysteresis by
the compensator of the nodes. Errors of a model are felt here divided by its local slope.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from hysteresis_ros.compensation.compensator import Compensator, CompensatorParameters
from hysteresis_ros.compensation.inverses import InverseParameters
from hysteresis_ros.identification.hammerstein import HammersteinFit
from hysteresis_ros.identification.linear_part import LinearPart
from hysteresis_ros.models.limits import LimitsParameters

#: The window of the smoothed derivative covers this many lags, and at least so many samples.
WINDOW = 3.0
FEWEST = 5
#: Where dynamics with modes answer less than this they are not undone.
SMALLEST_RESPONSE = 0.1
#: The voltage may leave the range of the identification by this part of it on each side.
BEYOND = 0.1


@dataclass(frozen=True, eq=False)
class InverseValidation:
    """Result of :func:`recover_voltage`.

    Parameters
    ----------
    voltage : ndarray, shape (N,)
        Recovered voltage [V].
    error : ndarray, shape (N - skip,)
        Recovered less applied voltage [V].
    rmse : float
        [V]
    rmse_displacement : float
        The same in displacement [m], through the model's nominal gain.
    rmse_percent : float
        Of the range of the applied voltage.
    """

    voltage: np.ndarray
    error: np.ndarray
    rmse: float
    rmse_displacement: float
    rmse_percent: float


def recover_voltage(
    fit: HammersteinFit, displacement, voltage, skip: int = 0, free_offset: bool = True
) -> InverseValidation:
    """Invert the model along a measured displacement and compare with the voltage that was applied.

    Parameters
    ----------
    fit : HammersteinFit
        Model; the data must have its sample time.
    displacement, voltage : array_like, shape (N,)
        [m] and [V].
    skip : int
        Samples left out of the comparison at the start.
    free_offset : bool
        Take the constant between measurement and model out of the displacement first.
    """
    y, v = (np.ascontiguousarray(values, dtype=np.float64) for values in (displacement, voltage))
    if free_offset:
        y = y - np.mean((y - fit.simulate(v))[skip:])
    wanted = undo(y, fit.linear_part, fit.sample_time)
    margin = BEYOND * (fit.voltage_high - fit.voltage_low)
    parameters = CompensatorParameters(
        inverse=InverseParameters(type="general"),
        hysteresis=fit.hysteresis,
        creep=fit.creep,
        limits=LimitsParameters(
            minimum=min(fit.voltage_low, 0.0) - margin, maximum=max(fit.voltage_high, 0.0) + margin
        ),
    )
    compensator = Compensator(parameters, fit.sample_time)
    found = compensator.simulate(wanted)
    error = (found - v)[skip:]
    rmse = float(np.sqrt(np.mean(error**2)))
    gain = compensator.hysteresis.gain
    return InverseValidation(found, error, rmse, rmse * gain, 100.0 * rmse / float(np.ptp(v[skip:])))


def undo(y, part: LinearPart, sample_time: float) -> np.ndarray:
    """Return the input, shape (N,), of lag, delay and modes whose output is ``y``, smoothed no more than needed.

    Parameters
    ----------
    y : array_like, shape (N,)
        [m]
    part : LinearPart
        Its creep is left aside.
    sample_time : float
        [s]
    """
    if not part.modes:
        return undo_lag(y, part.lag, part.delay, sample_time)
    y = np.asarray(y, dtype=float)
    # mirrored about the ends, so that level and slope go on
    longer = np.concatenate([2.0 * y[0] - y[:0:-1], y, 2.0 * y[-1] - y[-2::-1]])
    response = np.fft.rfft(replace(part, creep_rate=0.0).impulse(longer.size, sample_time))
    spectrum = np.fft.rfft(longer - y[0]) * response.conj() / (np.abs(response) ** 2 + SMALLEST_RESPONSE**2)
    found = np.fft.irfft(spectrum, longer.size) * (1.0 + SMALLEST_RESPONSE**2)
    return found[y.size - 1 : 2 * y.size - 1] + y[0]


def undo_lag(y, lag: float, delay: float, sample_time: float) -> np.ndarray:
    """Return the input, shape (N,), of a lag and a delay whose output is ``y``, smoothed no more than needed.

    Parameters
    ----------
    y : array_like, shape (N,)
    lag, delay : float
        [s]
    sample_time : float
        [s]
    """
    y = np.asarray(y, dtype=float)
    if lag + delay < 0.1 * sample_time:
        return y.copy()
    samples = max(FEWEST, 2 * int(0.5 * WINDOW * lag / sample_time) + 1)
    samples = min(samples, y.size - 1 + y.size % 2)
    smooth = scipy.signal.savgol_filter(y, samples, 2)
    slope = scipy.signal.savgol_filter(y, samples, 2, deriv=1, delta=sample_time)
    early = smooth + lag * slope
    place = np.arange(y.size) + delay / sample_time
    return np.interp(place, np.arange(y.size), early)
