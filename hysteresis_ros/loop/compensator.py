# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The hysteresis compensator in the loop: it computes the voltage and the achieved command from the command."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hysteresis_ros import signals as at
from hysteresis_ros.configuration import dump_configuration
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.loop import faults as faulty
from hysteresis_ros.loop.parameters import CompensatorNodeParameters, part
from hysteresis_ros.loop.watch import (
    GUARD_STATES,
    HOLDING,
    RUNNING,
    STALE,
    STAMP,
    STOPPED,
    TRIPPED,
    WatchArrays,
    guard_parameters,
    is_stale,
    receive,
    towards,
)
from hysteresis_ros.models import adaptation as adapting
from hysteresis_ros.models import compensator as compensating
from hysteresis_ros.models import limits as limiting
from hysteresis_ros.models.adaptation import Adaptation, AdaptationSettings, AdaptationStates, adapt, drive
from hysteresis_ros.models.block import by_part, kernel, nested
from hysteresis_ros.models.compensator import (
    Compensator,
    CompensatorArrays,
    CompensatorParameters,
    compensator_hold,
    compensator_resume,
    compensator_step,
)
from hysteresis_ros.models.hysteresis import HysteresisParameters


class CompensationArrays(NamedTuple):
    """All arrays of a compensator in the loop."""

    p: CompensatorArrays
    x: CompensatorArrays
    watch_p: WatchArrays
    watch_x: WatchArrays


class AdaptiveArrays(NamedTuple):
    """All arrays of a compensator whose inverse adapts to the actuator."""

    p: CompensatorArrays
    x: CompensatorArrays
    watch_p: WatchArrays
    watch_x: WatchArrays
    settings: AdaptationSettings
    adaptation: AdaptationStates


_ADAPTED_HEADER = """\
# The adapted model of a hysteresis_compensator, written by ~/save. SI units. Give it in addition to the parameter file
# of the axis: hysteresis up CONFIG --params-file THIS (and simulate), or a second --params-file of ros2 run. The
# weights include adaptation.factors: identified weight = weight / factor.
"""

# Own parameters.
SAFE_VOLTAGE = 0  # [V]
SAFE_STEP = 1  # [V] a sample
TOLERANCE = 2  # differences between plant output and sent voltage up to this are ignored [V]; infinite: output unknown
OWN_PARAMETERS = 3

# Own state.
STOP = 0  # 1 while stopped
RETURNING = 1  # 1: the next voltage continues from the present voltage
COMMAND = 2  # last finite command [m]
OWN_STATES = 3


@by_part
def compensate(laws, part, row):
    """Read the command of a sample from its row; write the voltage and the achieved command."""


@nested
def compensate_fixed(laws, arrays, row):
    """Compute the voltage by the fixed inverse.

    When the plant's output differs from the sent voltage, the model follows the output, and the next voltage continues
    from the output: the reported achieved command stays correct, and the voltage does not jump. In a skipped sample the
    voltage is held, and the model follows it.
    """
    p, x = arrays.p, arrays.x
    own_p, own = arrays.watch_p.own, arrays.watch_x.own
    guard_p, guard = arrays.watch_p.guard, arrays.watch_x.guard
    faults_p, faults = arrays.watch_p.faults, arrays.watch_x.faults
    command = receive(guard_p, guard, faults_p, faults, faulty.COMMAND, row[at.COMMAND], 0.0)
    if abs(row[at.PLANT_VOLTAGE] - x.limits[limiting.OUTPUT]) > own_p[TOLERANCE]:
        x.limits[limiting.UNQUANTISED] = row[at.PLANT_VOLTAGE]
        compensator_hold(laws.model, p, x, row[at.PLANT_VOLTAGE])
        own[RETURNING] = 1.0
    mode = RUNNING
    if row[at.TRIPPED] != 0.0:
        mode = TRIPPED
    elif own[STOP] != 0.0:
        mode = STOPPED
    elif is_stale(guard_p, guard):
        mode = STALE
    elif command != command:
        mode = HOLDING
    else:
        own[COMMAND] = command
    skipped = row[at.SKIPPED] != 0.0
    if mode == RUNNING and skipped:
        mode = HOLDING
    if mode in (RUNNING, HOLDING) and not skipped:
        if own[RETURNING] != 0.0:
            own[RETURNING] = 0.0
            compensator_resume(laws.model, laws.inverse, p, x, own[COMMAND])
        difference = x.out[compensating.BIAS]
        voltage = compensator_step(laws.model, laws.inverse, p, x, own[COMMAND])
        # the output returns to the voltage of the inverse; their difference changes at most at the slew rate for the
        # safe voltage
        x.out[compensating.BIAS] = towards(difference, x.out[compensating.BIAS], own_p[SAFE_STEP])
    else:
        if mode not in (RUNNING, HOLDING):
            own[RETURNING] = 1.0
        step = 0.0 if skipped else own_p[SAFE_STEP]
        safe = towards(x.limits[limiting.UNQUANTISED], own_p[SAFE_VOLTAGE], step)
        voltage = compensator_hold(laws.model, p, x, safe)
    row[at.VOLTAGE] = voltage
    row[at.APPLIED] = x.out[compensating.APPLIED]
    row[at.SATURATED] = limiting.is_limited(x.limits)
    row[at.COMPENSATOR_MODE] = mode
    row[at.ADAPTATION] = adapting.OFF
    row[at.ADAPTED_GAIN] = 1.0


@kernel
def note_output(own_p, row):
    """Write the voltage at the actuator into the row if it differs from the sent voltage."""
    if abs(row[at.PLANT_VOLTAGE] - row[at.VOLTAGE]) > own_p[TOLERANCE]:
        row[at.VOLTAGE] = row[at.PLANT_VOLTAGE]
        row[at.SATURATED] = 1.0


@nested
def compensate_adaptive(laws, arrays, row):
    """Adapt the inverse with this sample's measurement, compute the voltage by the inverse, and store the voltage."""
    p, x, settings, states = arrays.p, arrays.x, arrays.settings, arrays.adaptation
    voltage = x.limits[limiting.OUTPUT]
    measured = math.nan if row[at.SKIPPED] != 0.0 else row[at.MEASURED]
    usable = may_learn(settings.own, states.own, x.limits)
    adapt(settings, states, p.hysteresis, x.hysteresis, voltage, measured, usable)
    compensate_fixed(laws, arrays, row)
    mode = row[at.COMPENSATOR_MODE]
    if mode not in (RUNNING, HOLDING):
        states.own[adapting.WAIT] = settings.own[adapting.SETTLING_SAMPLES]
    drive(settings, states, p.creep, p.hysteresis, x.hysteresis, x.limits[limiting.OUTPUT])
    row[at.ADAPTATION] = states.own[adapting.STATE]
    row[at.ADAPTED_GAIN] = states.own[adapting.GAIN]


@kernel
def may_learn(own_p, own, limited):
    """Return 1 if the present sample may be used for adaptation; otherwise store the reason and return 0."""
    if own[adapting.WAIT] > 0.0:
        own[adapting.WAIT] -= 1.0
        own[adapting.STATE] = adapting.WAITING
    elif own[adapting.TOLD] != 0.0:
        own[adapting.STATE] = adapting.FROZEN
    elif limiting.is_limited(limited) != 0.0:
        own[adapting.STATE] = adapting.SATURATED
    else:
        return 1.0
    return 0.0


compensate.kinds[CompensationArrays], compensate.kinds[AdaptiveArrays] = compensate_fixed, compensate_adaptive


def adapted_text(name: str, part: CompensatorPart) -> str:
    """Return a parameter file with the adapted model of a compensator."""
    return _ADAPTED_HEADER + dump_configuration({name: part.saved()})


class CompensatorPart:
    """The compensator of an axis, with the monitoring of its command."""

    def __init__(self, parameters: CompensatorNodeParameters):
        self.parameters = parameters
        self.compensator = Compensator(part(parameters, CompensatorParameters), 1.0 / parameters.sample_rate)
        faults = faulty.fault_parameters(parameters.faults, (faulty.COMMAND,), parameters.sample_rate)
        guard = guard_parameters(parameters.command_timeout, parameters.sample_rate)
        watch_p = WatchArrays(guard, faults, np.zeros(OWN_PARAMETERS))
        watch_x = WatchArrays(np.zeros(GUARD_STATES), faulty.fault_state(faults), np.zeros(OWN_STATES))
        arrays = self.compensator.ps, self.compensator.xs, watch_p, watch_x
        self.arrays: CompensationArrays | AdaptiveArrays = CompensationArrays(*arrays)
        self.adaptation: Adaptation | None = None
        if parameters.adaptation.type != "none":
            self.adaptation = Adaptation(parameters.adaptation, self.compensator)
            self.arrays = AdaptiveArrays(*arrays, self.adaptation.settings, self.adaptation.xs)
        self._pack_own(parameters)
        self.arrays.watch_p.own[TOLERANCE] = math.inf
        self._begins_safe = False

    def follow_plant(self, rounding: float, begins_safe: bool) -> None:
        """Follow the plant's output when it differs from the voltage sent.

        Only a loop that computes all parts of a sample calls this method; separate nodes receive the output too late.
        """
        rounding += self.arrays.p.limits[limiting.STEP]
        self.arrays.watch_p.own[TOLERANCE] = rounding + at.LEAST_DIFFERENCE
        self._begins_safe = begins_safe
        self.arrays.watch_x.own[RETURNING] = float(begins_safe)

    def _pack_own(self, parameters) -> None:
        own = self.arrays.watch_p.own
        own[SAFE_VOLTAGE] = parameters.safe_voltage
        own[SAFE_STEP] = parameters.safe_slew_rate / parameters.sample_rate

    @property
    def voltage(self) -> float:
        """Last output voltage [V]."""
        return self.compensator.voltage

    def inject(self, faults: tuple[str, ...]) -> None:
        """Replace the scheduled faults; their times are counted from now."""
        p = faulty.fault_parameters(faults, (faulty.COMMAND,), self.parameters.sample_rate)
        # the sample numbers of the commands are also counted from now
        self.arrays.watch_x.guard[STAMP] = -1.0
        watch_p = self.arrays.watch_p._replace(faults=p)
        self.arrays = self.arrays._replace(
            watch_p=watch_p, watch_x=self.arrays.watch_x._replace(faults=faulty.fault_state(p))
        )

    def stop(self) -> None:
        """Slew to the safe voltage, beginning with the next sample."""
        self.arrays.watch_x.own[STOP] = 1.0

    def start(self) -> None:
        """Continue without a jump: the difference of the present voltage from that for the command decays to zero."""
        self.arrays.watch_x.own[STOP] = 0.0
        self.arrays.watch_x.own[RETURNING] = 1.0

    def _adapted(self) -> Adaptation:
        if self.adaptation is None:
            remedy = "adaptation is off: start the node with adaptation.type: recursive"
            raise ParameterError([Problem("adaptation.type", "none", remedy)])
        return self.adaptation

    def freeze(self) -> None:
        """Stop adapting the weights of the inverse."""
        self._adapted().freeze()

    def resume(self) -> None:
        """Resume adapting the weights."""
        self._adapted().resume()

    def forget(self) -> None:
        """Return to the identified weights; the voltage does not jump."""
        adaptation = self._adapted()
        adaptation.forget()
        self._take(self.parameters, adaptation.identified)

    def saved(self) -> dict:
        """Return the parameters of the node with the adapted model; another axis can start with them."""
        adaptation = self._adapted()
        model = {f"hysteresis.{name}": value for name, value in adaptation.weighted.to_mapping().items()}
        chosen = f"hysteresis.{self.parameters.hysteresis.type}."
        kept = {name: value for name, value in model.items() if name.startswith(chosen) and value != ()}
        kind = {"hysteresis.type": self.parameters.hysteresis.type}
        return {**kind, **kept, "adaptation.factors": adaptation.factors}

    def resting_displacement(self, voltage: float) -> float:
        """Return the displacement [m] of the model after a reset, at a voltage [V]."""
        model = Compensator(part(self.parameters, CompensatorParameters), 1.0 / self.parameters.sample_rate)
        model.xs.limits[limiting.UNQUANTISED] = voltage
        model.hold(voltage)
        return model.applied

    def reset(self) -> None:
        """Return to the state of rest."""
        if self.adaptation is not None:
            self._take(self.parameters, self.parameters.hysteresis)
        self.compensator.reset()
        if self.adaptation is not None:
            self.adaptation.reset()
        watch_p, watch_x = self.arrays.watch_p, self.arrays.watch_x
        watch_x.guard[:] = 0.0
        watch_x.faults[:] = faulty.fault_state(watch_p.faults)
        stopped = watch_x.own[STOP]
        watch_x.own[:] = 0.0
        watch_x.own[STOP] = stopped
        watch_x.own[RETURNING] = float(self._begins_safe)

    def retune(self, parameters: CompensatorNodeParameters) -> None:
        """Apply new model parameters and limits; the voltage does not jump."""
        if self.adaptation is None:
            self._take(parameters, parameters.hysteresis)
        else:
            self._retune_adaptive(self.adaptation, parameters)
        self.arrays.watch_p.guard[:] = guard_parameters(parameters.command_timeout, parameters.sample_rate)
        self._pack_own(parameters)
        self.parameters = parameters

    def _take(self, parameters: CompensatorNodeParameters, hysteresis: HysteresisParameters) -> None:
        self.compensator.retune(replace(part(parameters, CompensatorParameters), hysteresis=hysteresis))

    def _retune_adaptive(self, adaptation: Adaptation, parameters: CompensatorNodeParameters) -> None:
        """Keep the adapted weights, unless another model is given."""
        before, given = self.parameters, parameters.hysteresis
        adaptation.dynamics.retune(parameters.adaptation.dynamics)
        try:
            self._take(parameters, adaptation.hysteresis if given == before.hysteresis else given)
        except ParameterError:
            adaptation.dynamics.retune(before.adaptation.dynamics)
            raise
        adaptation.retune(parameters.adaptation, given)

    def make_safe(self) -> float:
        """Step to the safe voltage [V], and return it for the last message of an exiting node."""
        limits = self.arrays.p.limits
        # the last message must contain the safe voltage, whatever the slew rate limit
        slew, limits[limiting.SLEW] = limits[limiting.SLEW], 0.0
        voltage = self.compensator.hold(self.parameters.safe_voltage)
        limits[limiting.SLEW] = slew
        return voltage
