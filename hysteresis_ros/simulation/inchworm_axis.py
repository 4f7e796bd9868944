"""An inchworm axis: motor, sequencer, controller and compensator built from a configuration, simulated offline."""

from __future__ import annotations

import math

import numpy as np

from hysteresis_ros.block import compiled
from hysteresis_ros.compensation.compensator import Compensator, CompensatorParameters
from hysteresis_ros.control.controller import (
    ControllerParameters,
    controller_block,
    feedforward_block,
    handover_block,
)
from hysteresis_ros.models.inchworm import Inchworm, InchwormPlantParameters
from hysteresis_ros.references.inchworm_sequencer import InchwormSequencer, InchwormSequencerParameters
from hysteresis_ros.simulation.closed_loop import sample_times
from hysteresis_ros.simulation.inchworm_loop import (
    DROPOUT,
    INCHWORM_SIGNALS,
    INPUTS,
    REQUEST,
    SETPOINT,
    SPEED,
    inchworm_loop,
)
from hysteresis_ros.simulation.node_parameters import part


class InchwormAxis:
    """The blocks of an inchworm axis in closed loop, without ROS.

    Parameters
    ----------
    parameters : AxisParameters
        Parameters of all nodes, with an ``inchworm_sequencer``.

    Attributes
    ----------
    motor, sequencer, feedforward, controller, handover, compensator
        The blocks; their state goes on from one :meth:`run` to the next.
    """

    def __init__(self, parameters):
        self.parameters = parameters
        plant = parameters.plant_simulator
        sample_time = 1.0 / plant.sample_rate
        self.motor = Inchworm(part(plant, InchwormPlantParameters), sample_time)
        given = part(parameters.inchworm_sequencer, InchwormSequencerParameters)
        self.sequencer = InchwormSequencer(given, sample_time)
        control = part(parameters.motion_controller, ControllerParameters)
        self.feedforward = feedforward_block(control, sample_time)
        self.controller = controller_block(control, sample_time)
        self.handover = handover_block(control, sample_time)
        self.compensator = Compensator(part(parameters.hysteresis_compensator, CompensatorParameters), sample_time)
        self.sample = 0

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return self.parameters.plant_simulator.sample_rate

    def default_samples(self) -> int:
        """Return the length of a run that the configuration itself gives, in samples; 0 when it gives none."""
        return self.parameters.plant_simulator.samples or self.sequencer.duration_samples

    def default_setpoints(self, samples: int) -> np.ndarray:
        """Return the setpoints [m] of the schedule at each of the first ``samples`` samples."""
        return self.sequencer.scheduled(samples)

    def run(self, setpoints, requests=None, speeds=None, dropouts=None) -> dict[str, np.ndarray]:
        """Simulate ``len(setpoints)`` samples.

        Parameters
        ----------
        setpoints : array_like, shape (N,)
            Setpoint in force at each sample [m].
        requests : array_like, shape (N,), optional
            Request at each sample (see :mod:`hysteresis_ros.references.inchworm_layout`), 0 for none.
        speeds : array_like, shape (N,), optional
            Walking speed asked for at each sample [m/s]; NaN leaves it as it is.
        dropouts : array_like, shape (N,), optional
            Other than 0 where the slider's measurement is missing.

        Returns
        -------
        dict of str to array, shape (N,)
            ``time`` [s], ``setpoint`` and the signals of :data:`inchworm_loop.INCHWORM_SIGNALS`: ``displacement`` and
            ``measured`` are the slider's, ``reference``, ``command`` and ``estimated`` are relative to ``origin``.
        """
        setpoints = np.ascontiguousarray(setpoints, dtype=np.float64)
        inputs = np.zeros((len(setpoints), INPUTS))
        inputs[:, SETPOINT] = setpoints
        inputs[:, REQUEST] = 0.0 if requests is None else requests
        inputs[:, SPEED] = math.nan if speeds is None else speeds
        inputs[:, DROPOUT] = 0.0 if dropouts is None else dropouts
        table = np.empty((len(setpoints), len(INCHWORM_SIGNALS)))
        compiled(inchworm_loop)(*self._arguments(), inputs, table)
        time = sample_times(self.sample, len(setpoints), self.sample_rate)
        self.sample += len(setpoints)
        signals = {name: table[:, i].copy() for i, name in enumerate(INCHWORM_SIGNALS)}
        return {"time": time, "setpoint": setpoints, **signals}

    def _arguments(self):
        return (
            *(*self.motor.hysteresis_kernels, self.motor.ps, self.motor.xs),
            *(self.sequencer.p, self.sequencer.x),
            *(self.feedforward.p, self.feedforward.x),
            *(self.controller.kernel, self.controller.p, self.controller.x, self.handover.p, self.handover.x),
            *(self.compensator.hysteresis_kernel, self.compensator.inverse_kernel),
            *(self.compensator.ps, self.compensator.xs),
        )

    def reset(self) -> None:
        """Return all blocks to their beginning."""
        for block in (
            *(self.motor, self.sequencer, self.feedforward),
            *(self.controller, self.handover, self.compensator),
        ):
            block.reset()
        self.sample = 0
