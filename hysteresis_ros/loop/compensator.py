"""The hysteresis compensator as a part of the loop: from the command to the voltage, and what that carries out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hysteresis_ros import signals as at
from hysteresis_ros.block import nested
from hysteresis_ros.compensation import compensator as compensating
from hysteresis_ros.compensation.compensator import (
    Compensator,
    CompensatorArrays,
    CompensatorParameters,
    compensator_hold,
    compensator_resume,
    compensator_step,
)
from hysteresis_ros.loop import faults as faulty
from hysteresis_ros.loop.node_parameters import CompensatorNodeParameters, part
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
from hysteresis_ros.models import limits as limiting


class CompensationArrays(NamedTuple):
    """All arrays of a compensator in the loop."""

    p: CompensatorArrays
    x: CompensatorArrays
    watch_p: WatchArrays
    watch_x: WatchArrays


# Own parameters.
SAFE_VOLTAGE = 0  # [V]
SAFE_STEP = 1  # [V] a sample
OWN_PARAMETERS = 2

# Own state.
STOP = 0  # 1 while told to stop
RETURNING = 1  # 1: the next voltage goes on from the present one
COMMAND = 2  # last finite command [m]
OWN_STATES = 3


@nested
def compensate(laws, arrays, row):
    """Take the command of a sample out of its row; put the voltage and what it carries out in.

    In a sample that was skipped the voltage stays where it is, and the model follows that.
    """
    p, x = arrays.p, arrays.x
    own_p, own = arrays.watch_p.own, arrays.watch_x.own
    guard_p, guard = arrays.watch_p.guard, arrays.watch_x.guard
    faults_p, faults = arrays.watch_p.faults, arrays.watch_x.faults
    command = receive(guard_p, guard, faults_p, faults, faulty.COMMAND, row[at.COMMAND], 0.0)
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
        voltage = compensator_step(laws.model, laws.inverse, p, x, own[COMMAND])
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


class CompensatorPart:
    """The compensator of an axis, with what watches over its command.

    Parameters
    ----------
    parameters : CompensatorNodeParameters
        Checked on construction.

    Raises
    ------
    ParameterError
        Names every wrong parameter.
    """

    def __init__(self, parameters: CompensatorNodeParameters):
        self.parameters = parameters
        self.compensator = Compensator(part(parameters, CompensatorParameters), 1.0 / parameters.sample_rate)
        faults = faulty.fault_parameters(parameters.faults, (faulty.COMMAND,), parameters.sample_rate)
        guard = guard_parameters(parameters.command_timeout, parameters.sample_rate)
        watch_p = WatchArrays(guard, faults, np.zeros(OWN_PARAMETERS))
        watch_x = WatchArrays(np.zeros(GUARD_STATES), faulty.fault_state(faults), np.zeros(OWN_STATES))
        self.arrays = CompensationArrays(self.compensator.ps, self.compensator.xs, watch_p, watch_x)
        self._pack_own(parameters)

    def _pack_own(self, parameters) -> None:
        own = self.arrays.watch_p.own
        own[SAFE_VOLTAGE] = parameters.safe_voltage
        own[SAFE_STEP] = parameters.safe_slew_rate / parameters.sample_rate

    @property
    def voltage(self) -> float:
        """Voltage [V] that was put out last."""
        return self.compensator.voltage

    def inject(self, faults: tuple[str, ...]) -> None:
        """Let these faults happen, their times counted from now on, and no others."""
        p = faulty.fault_parameters(faults, (faulty.COMMAND,), self.parameters.sample_rate)
        # commands are numbered from now on, too
        self.arrays.watch_x.guard[STAMP] = -1.0
        watch_p = self.arrays.watch_p._replace(faults=p)
        self.arrays = self.arrays._replace(
            watch_p=watch_p, watch_x=self.arrays.watch_x._replace(faults=faulty.fault_state(p))
        )

    def stop(self) -> None:
        """Slew to the safe voltage from the next sample on."""
        self.arrays.watch_x.own[STOP] = 1.0

    def start(self) -> None:
        """Go on without a jump: the difference to the command fades out."""
        self.arrays.watch_x.own[STOP] = 0.0
        self.arrays.watch_x.own[RETURNING] = 1.0

    def reset(self) -> None:
        """Begin again with everything at rest."""
        self.compensator.reset()
        watch_p, watch_x = self.arrays.watch_p, self.arrays.watch_x
        watch_x.guard[:] = 0.0
        watch_x.faults[:] = faulty.fault_state(watch_p.faults)
        stopped = watch_x.own[STOP]
        watch_x.own[:] = 0.0
        watch_x.own[STOP] = stopped

    def retune(self, parameters: CompensatorNodeParameters) -> None:
        """Take new model parameters and limits; the voltage does not jump.

        Raises
        ------
        ParameterError
            The parameters are wrong or of another structure; nothing is changed then.
        """
        self.compensator.retune(part(parameters, CompensatorParameters))
        self.arrays.watch_p.guard[:] = guard_parameters(parameters.command_timeout, parameters.sample_rate)
        self._pack_own(parameters)
        self.parameters = parameters

    def make_safe(self) -> float:
        """Return the safe voltage [V], put out at once: the last message of a node that leaves."""
        limits = self.arrays.p.limits
        # the limit of the slew rate, of one sample, must not keep the last message from being the safe voltage
        slew, limits[limiting.SLEW] = limits[limiting.SLEW], 0.0
        voltage = self.compensator.hold(self.parameters.safe_voltage)
        limits[limiting.SLEW] = slew
        return voltage
