# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What every stage knows: the axis, what may be moved, and what earlier stages found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from hysteresis_ros.commissioning.folder import Folder
from hysteresis_ros.commissioning.outcome import CommissioningError, Outcome
from hysteresis_ros.commissioning.plan import Plan
from hysteresis_ros.configuration import Configuration
from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.models.hysteresis import hysteresis_block
from hysteresis_ros.simulation.axes import single_axis
from hysteresis_ros.simulation.driven_axis import driven, write_samples

#: Part of the stroke by which the sensor may read beyond what the voltages of a stage should give.
OVERTRAVEL = 0.5
#: Part of the range that a stage without movement may use: limits are never empty.
NOTHING = 1e-4


@dataclass
class Situation:
    """What every stage knows.

    Parameters
    ----------
    configuration : Configuration
        The parameter file, with what the command line says of the plant.
    axis : AxisParameters
    plan : Plan
    folder : Folder
    model, controller : str
        What to identify and to design, or ``auto``.
    against : tuple of str, optional
        Other models that a controller has to bear as well; by default what is nearly as good.
    progress : callable
        Called as ``progress(number, text)`` by what takes long.
    found : dict of str to Outcome
        What earlier stages found.
    """

    configuration: Configuration
    axis: AxisParameters
    plan: Plan
    folder: Folder
    model: str = "auto"
    controller: str = "auto"
    against: tuple[str, ...] | None = None
    progress: Callable[[int, str], None] = lambda number, text: None
    found: dict[str, Outcome] = field(default_factory=dict)

    @property
    def rate(self) -> float:
        """Samples per second [Hz]."""
        return self.axis.plant_simulator.sample_rate

    @property
    def safe(self) -> float:
        """The safe voltage [V], at which every stage begins and ends."""
        return self.axis.hysteresis_compensator.safe_voltage

    def figure(self, stage: str, name: str) -> float:
        """Return a figure of an earlier stage.

        Parameters
        ----------
        stage, name : str

        Raises
        ------
        CommissioningError
            The stage is not done.
        """
        if stage not in self.found:
            raise CommissioningError(f"the stage {stage} is not done yet: do it first (--stage {stage})")
        return self.found[stage].figures[name]

    def driven_axis(self, stage: str, voltages: np.ndarray) -> AxisParameters:
        """Return the axis that puts out voltages in open loop, within limits that hold nothing else.

        Parameters
        ----------
        stage : str
        voltages : ndarray, shape (N,)
            [V]
        """
        room = NOTHING * self.plan.span
        low = max(float(voltages.min()) - room, self.plan.minimum)
        high = min(float(voltages.max()) + room, self.plan.maximum)
        configuration = self.within(self.configuration, low, high)
        if "noise" not in self.found:
            # nothing moves yet: a device whose own range is narrower is refused now
            whole = {"limits.minimum": self.plan.minimum, "limits.maximum": self.plan.maximum}
            configuration = configuration.override("plant_simulator", **whole)
        if self.has_device:
            configuration = configuration.override("plant_simulator", **self._watched())
        limits = single_axis(configuration, self.axis.namespace).hysteresis_compensator.limits
        block = hysteresis_block(self.axis.hysteresis_compensator.hysteresis, 1.0 / self.rate)
        path = write_samples(self.folder.path / "waveforms" / f"{stage}.npz", voltages * block.gain, self.rate)
        waveform = {"type": "file", "cycles": 1, "file.path": path, "file.column": "reference", "offset": 0.0}
        found = single_axis(driven(configuration, limits, block.gain, waveform), self.axis.namespace)
        return found.with_duration(voltages.size / self.rate)

    def _watched(self) -> dict:
        """Return parameters by which the watch over a device's movement is right, whatever model stands in the file."""
        # the gain that is expected: what the axis may measure follows from it
        values = {"hysteresis.type": "proportional", "hysteresis.proportional.gain": self.plan.gain, "overtravel": -1.0}
        values |= {name: () for name in ("dynamics.A", "dynamics.B", "dynamics.C")}
        if "noise" in self.found:  # before, nobody knows where the sensor's zero is
            values |= {"preload.A1": self.figure("noise", "sensor_zero_m"), "overtravel": OVERTRAVEL * self.plan.stroke}
        return values

    @property
    def has_device(self) -> bool:
        """Whether something else than the simulated plant of the file moves."""
        plant = self.axis.plant_simulator
        return bool(plant.driver) or plant.external_plant

    def within(self, configuration: Configuration, low: float, high: float) -> Configuration:
        """Return a configuration whose plant and compensator put out nothing else than ``low`` … ``high`` [V].

        Parameters
        ----------
        configuration : Configuration
        low, high : float
        """
        limits = {"limits.minimum": low, "limits.maximum": high, "limits.slew_rate": self.plan.amplifier}
        for node in ("plant_simulator", "hysteresis_compensator"):
            configuration = configuration.override(node, **limits)
        return configuration
