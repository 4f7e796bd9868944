# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Duhem hysteresis followed by a second-order linear part (Wang, Alici & Tan 2014; W1, W2, W5).

The linear part is found by least squares from ``y(t) = -a1 y(t-1) - a2 y(t-2) + b0 w(t-1) + b1 w(t-2)``, where w is the
voltage itself (G1, W1) or what the identified hysteresis makes of it (G2, W5).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.identification.branches import checked_signals, split_branches
from hysteresis_ros.identification.duhem import DuhemIdentification, identify_duhem
from hysteresis_ros.identification.duhem_loops import PreparedLoops, prepare_loops
from hysteresis_ros.identification.least_squares import ArxFit, fit_arx
from hysteresis_ros.models.hysteresis.duhem import DuhemHysteresis, DuhemParameters
from hysteresis_ros.models.linear import LinearParameters

#: With ``minimum_phase`` the zero is kept within this radius.
LARGEST_ZERO = 0.98


@dataclass(frozen=True)
class DuhemHammerstein:
    """Result of :func:`identify_duhem_hammerstein`.

    Parameters
    ----------
    hysteresis : DuhemIdentification
        First part: voltage to displacement at the amplitude of the first recording.
    linear : ArxFit
        Second part G2.
    linear_only : ArxFit
        G1, the linear model without hysteresis, for comparison.
    prepared : PreparedLoops
        Lags and gains of the recordings.
    rms : tuple of float
        Simulation error of the whole model for each recording [m].
    linear_only_rms : tuple of float
        The same for G1.
    converged : bool
        Of the hysteresis.
    warnings : tuple of str
        Of both parts.
    """

    hysteresis: DuhemIdentification
    linear: ArxFit
    linear_only: ArxFit
    prepared: PreparedLoops
    rms: tuple[float, ...]
    linear_only_rms: tuple[float, ...]
    converged: bool
    warnings: tuple[str, ...]

    @property
    def parameters(self) -> tuple[DuhemParameters, LinearParameters]:
        """Both parts as an actuator wants them: the hysteresis carries the gain, the linear part has unit DC gain.

        Raises
        ------
        FitError
            The linear part is unstable and cannot run.
        """
        gain = self.linear.model.dc_gain
        hysteresis = self.hysteresis.parameters
        scaled = {name: gain * getattr(hysteresis, name) for name in ("output_low", "output_high", "output_start")}
        return replace(hysteresis, **scaled), self.linear.model.linear_parameters()


def identify_duhem_hammerstein(
    recordings,
    sample_time: float,
    *,
    minor=None,
    minimum_phase: bool = False,
    delays=None,
    **duhem,
) -> DuhemHammerstein:
    """Identify v → Duhem → G2 from sines of one amplitude and several frequencies (W2, W3, W5).

    Parameters
    ----------
    recordings : sequence of (voltage, displacement)
        [V], [m], each several cycles.
    sample_time : float
        [s]
    minor : (voltage, displacement), optional
        Recording with minor loops; its lag is removed like that of the others.
    minimum_phase : bool
        Keep the zero of the linear part inside the unit circle, as an inversion needs (W6).
    delays : sequence of float, optional
        Lags of the recordings [s].
    **duhem
        ``alpha``, ``shape``, ``size`` and ``seed`` of :func:`~hysteresis_ros.identification.duhem.identify_duhem`.

    Raises
    ------
    IdentificationError, DataError, FitError
        Unusable data, or inputs that do not excite a second-order part.
    """
    recordings = [checked_signals(*pair) for pair in recordings]
    prepared = prepare_loops(recordings, sample_time, delays)
    if minor is not None:
        alone = prepare_loops([minor], sample_time)
        # the first reversals of both are the same large ones: their amplitudes stand for the gain of the linear part
        minor = (alone.voltage[0], alone.displacement[0] * (prepared.gains[0] / alone.gains[0]))
    hysteresis = identify_duhem(prepared.voltage, prepared.displacement, minor=minor, **duhem)
    block = DuhemHysteresis(hysteresis.parameters, sample_time)
    inputs, outputs, raw = [], [], []
    for voltage, displacement in recordings:
        block.reset()
        passed = block.simulate(voltage)
        # the first branch comes from rest, where the state of the hysteresis is not known
        settled = split_branches(voltage)[0].stop
        inputs.append(passed[settled:])
        outputs.append(displacement[settled:])
        raw.append(voltage[settled:])
    radius = LARGEST_ZERO if minimum_phase else None
    linear = fit_arx(inputs, outputs, sample_time, zero_radius=radius, units=("m", "m"))
    linear_only = fit_arx(raw, outputs, sample_time, zero_radius=radius)
    return DuhemHammerstein(
        hysteresis=hysteresis,
        linear=linear,
        linear_only=linear_only,
        prepared=prepared,
        rms=_simulation_rms(linear, inputs, outputs),
        linear_only_rms=_simulation_rms(linear_only, raw, outputs),
        converged=hysteresis.converged,
        warnings=hysteresis.warnings + tuple(f"linear part: {warning}" for warning in linear.warnings),
    )


def _simulation_rms(fit: ArxFit, inputs, outputs) -> tuple[float, ...]:
    """Return the rms error of the simulated model for each recording, started from its first two outputs."""
    found = []
    for w, y in zip(inputs, outputs, strict=True):
        start = (y[0], y[1] + fit.denominator[1] * y[0] - fit.numerator[0] * w[0])
        found.append(float(np.sqrt(np.mean((fit.model.simulate(w, start) - y) ** 2))))
    return tuple(found)
