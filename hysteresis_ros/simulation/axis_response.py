# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a run, or a recording, says of the frequency response of an axis: plant, loop, margins, and the model's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.control.closed_loop import loop_transfer
from hysteresis_ros.control.margins import Margins, margins_of
from hysteresis_ros.control.measured_loop import MeasuredLoop, loop_of
from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.excitations import Plan
from hysteresis_ros.identification.response_analysis import Analysis, analyse
from hysteresis_ros.identification.response_file import PROBABILITY
from hysteresis_ros.identification.response_model import LOWEST, measured_plant
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.simulation.response_run import measured_loop_parts
from hysteresis_ros.units import readable

#: Levels that are said in dB of the response.
LEVELS = {"noise": "noise", "odd": "odd distortion", "even": "even distortion"}


@dataclass(frozen=True, eq=False)
class AxisResponse:
    """The measured response of an axis.

    Parameters
    ----------
    plan : Plan
    plant : Analysis
        From voltage or command to the measured displacement; of a closed loop whose controller nobody knows from
        reference − measured.
    loop : MeasuredLoop, optional
        Of a closed loop.
    model : ndarray of complex, shape (F,), optional
        What the controller's model has for the plant, at the lines.
    model_loop : ndarray of complex, shape (F,), optional
    margins : Margins, optional
        Of the model's loop.
    """

    plan: Plan
    plant: Analysis
    loop: MeasuredLoop | None = None
    model: np.ndarray | None = None
    model_loop: np.ndarray | None = None
    margins: Margins | None = None

    @property
    def figures(self) -> dict:
        """Figures by names with units; what has no value is left out."""
        response = self.plant.response
        found: dict = {
            "excitation": self.plan.kind,
            "loop": self.plan.loop,
            "at": self.plan.at,
            "lines": int(response.frequency.size),
            "lowest_hz": float(response.frequency[0]),
            "highest_hz": float(response.frequency[-1]),
            "signal_to_noise_db": self.plant.ratio,
        }
        for name, level in self._levels().items():
            found[f"{name}_db"] = level
        if self.loop is not None:
            intervals = {
                "gain_margin_db": self.loop.gain_margin,
                "phase_margin_deg": self.loop.phase_margin,
                "delay_margin_samples": self.loop.delay_margin,
                "sensitivity_peak": self.loop.sensitivity_peak,
            }
            for name, one in intervals.items():
                found |= {name: one.value, f"{name}_low": one.low, f"{name}_high": one.high}
        if self.margins is not None:
            found |= {
                "model_gain_margin_db": self.margins.gain_margin,
                "model_phase_margin_deg": self.margins.phase_margin,
                "model_delay_margin_samples": self.margins.delay_margin_samples,
                "model_sensitivity_peak": self.margins.sensitivity_peak,
            }
        return {name: value for name, value in found.items() if not isinstance(value, float) or np.isfinite(value)}

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """What is known at the lines besides the plant's response, by names with units."""
        found = {}
        if self.loop is not None:
            responses = {"loop": self.loop.loop, "sensitivity": self.loop.sensitivity}
            responses["complementary"] = self.loop.complementary
            for name, values in responses.items():
                found[f"{name}_real [1]"], found[f"{name}_imag [1]"] = values.real, values.imag
            found["loop_radius [1]"] = self.loop.radius
            found["sensitivity_radius [1]"] = self.loop.sensitivity_radius
        return found

    def lines(self) -> list[str]:
        """Return the table that is printed."""
        response, unit = self.plant.response, self.plant.response.input_unit
        kind = {"open": f"{self.plan.at} → displacement", "closed": f"closed loop, excited at the {self.plan.at}"}
        rows = [
            ("response", f"{kind[self.plan.loop]}, {self.plan.kind}"),
            (
                "lines",
                f"{response.frequency.size}, {response.frequency[0]:.4g} … {response.frequency[-1]:.4g} Hz",
            ),
            ("signal-to-noise ratio", f"{self.plant.ratio:.1f} dB (median of the lines)"),
        ]
        low = float(np.median(np.abs(response.single[:LOWEST])))
        if unit == "V":
            rows.append(("gain of the lowest lines", f"{readable(low, 'm')}/V"))
        if self._levels():
            levels = ", ".join(
                f"{LEVELS[name]} {f'{level:.1f} dB' if np.isfinite(level) else 'not above the noise'}"
                for name, level in self._levels().items()
            )
            rows.append(("of the response", levels))
        if self.loop is not None:
            rows += self.loop.rows(self.margins)
        width = max(len(name) for name, _ in rows)
        return [f"{name:<{width}}  {text}" for name, text in rows] + [f"note: {text}" for text in response.warnings]

    def _levels(self) -> dict[str, float]:
        """Return noise and distortion over the response [dB], median of the lines."""
        levels, size = self.plant.distortion, np.abs(self.plant.response.single)
        if levels is None:
            return {}
        with np.errstate(divide="ignore"):
            return {
                name: float(np.median(20.0 * np.log10(getattr(levels, name) / size)))
                for name in LEVELS
                if np.isfinite(getattr(levels, name)).all()
            }


def axis_response(recording: Recording, plan: Plan, axis: AxisParameters | None = None) -> AxisResponse:
    """Return the response of an axis from a recording of its excitation.

    Parameters
    ----------
    recording : Recording
        Of regular samples.
    plan : Plan
    axis : AxisParameters, optional
        Whose controller closed the loop, and whose model is compared; without it a loop is taken to be that of a
        controller of reference − measured alone.

    Raises
    ------
    IdentificationError
        It drowns in noise, or the recording is too short.
    RecordingError
        A signal is missing.
    """
    sample_time, y = recording.sample_time, recording["measured"]
    if plan.loop == "open":
        u = recording[plan.at]
        plant = analyse(plan, sample_time, u, y, input_unit="V" if plan.at == "voltage" else "m")
    else:
        reference = recording["reference"]
        if recording.has("seen"):
            # the loop is closed over what the controller took, which may come later than it was measured
            y = np.where(np.isfinite(recording["seen"]), recording["seen"], y)
        u = recording["command"] if axis is not None else reference - y
        plant = analyse(plan, sample_time, u, y, reference, "m")
    _require_finite(plant)
    plant.require_excited()
    response = plant.response
    loop = None
    if plan.loop == "closed":
        radius = response.radius(PROBABILITY)[:, 0, 0]
        if axis is None:
            loop = MeasuredLoop(response.frequency, response.single, radius, sample_time)
        else:
            controller, model = measured_loop_parts(axis)
            loop = loop_of(controller, response.frequency, response.single, radius, sample_time, model)
    found = AxisResponse(plan, plant, loop)
    return found if axis is None else _with_model(found, axis)


def _require_finite(plant: Analysis) -> None:
    if not np.all(np.isfinite(plant.response.single)):
        raise IdentificationError(
            "the recording has samples that are no numbers within the excitation; record it again"
        )


def _with_model(found: AxisResponse, axis: AxisParameters) -> AxisResponse:
    """Return the response with what the axis' own model has for it."""
    controller, plant = measured_loop_parts(axis)
    response, sample_time = found.plant.response, 1.0 / axis.motion_controller.sample_rate
    z = np.exp(2j * np.pi * response.frequency * sample_time)
    model = plant.response(z)[:, 0, 0]
    # the other way round: the model with the gain that was measured
    shown = measured_plant(found.plant, model)
    model = model * abs(response.single[0] / shown.response[0])
    if found.loop is None:
        return replace(found, model=model)
    margins = margins_of(controller, plant, sample_time)
    return replace(found, model=model, model_loop=loop_transfer(controller, plant, z), margins=margins)
