"""One sample after another through the inchworm motor, its sequencer, controller and compensator."""

from __future__ import annotations

import math

from hysteresis_ros.block import composite
from hysteresis_ros.models.inchworm import EFFORT, JOINTS, TRUE_POSITION, inchworm_advance, inchworm_measure
from hysteresis_ros.recordings.dataset import INCHWORM_UNITS
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references.inchworm_machine import sequence
from hysteresis_ros.simulation.closed_loop import SIGNALS, answer

#: Columns of the table that :func:`inchworm_loop` fills.
INCHWORM_SIGNALS = (*SIGNALS, *INCHWORM_UNITS)

#: Columns of the inputs: setpoint [m], request (0: none), walking speed [m/s] (NaN: as before), 1 where the slider's
#: sensor gives nothing.
SETPOINT, REQUEST, SPEED, DROPOUT = range(4)
INPUTS = 4


@composite(
    "void",
    *("kernel", "kernel", "kernel", "arrays:16", "arrays:16"),
    *("array", "array"),
    *("array", "array", "controller", "array", "array", "array", "array"),
    *("kernel", "inverse", "arrays:5", "arrays:5"),
    *("table", "table"),
)
def inchworm_loop(
    extender_hysteresis,
    front_hysteresis,
    rear_hysteresis,
    plant_ps,
    plant_xs,
    sequencer_p,
    sequencer_x,
    feedforward_p,
    feedforward_x,
    controller,
    controller_p,
    controller_x,
    handover_p,
    handover_x,
    model_hysteresis,
    inverse,
    compensator_ps,
    compensator_xs,
    inputs,
    table,
):
    """Run the loop for ``len(inputs)`` samples; all states go on in place.

    Without a measurement the command stays as it is, as in the motion controller's node.

    Parameters
    ----------
    extender_hysteresis, front_hysteresis, rear_hysteresis, controller, model_hysteresis, inverse : kernels
        What makes this loop that loop.
    plant_ps, plant_xs, compensator_ps, compensator_xs : tuples of arrays
        Parameters and states of plant and compensator.
    sequencer_p, sequencer_x, feedforward_p, feedforward_x, controller_p, controller_x, handover_p, handover_x : arrays
        Parameters and states of sequencer, feedforward, controller and hand-over.
    inputs : array, shape (N, 4)
        Setpoint, request, walking speed and dropout of each sample.
    table : array, shape (N, len(INCHWORM_SIGNALS))
        Filled with the signals of each sample.
    """
    for k in range(inputs.shape[0]):
        measured = inchworm_measure(plant_ps, plant_xs)
        extender = plant_xs[JOINTS][1]
        seen = measured
        if inputs[k, DROPOUT] != 0.0:
            seen = math.nan
        if inputs[k, REQUEST] != 0.0:
            sequencer_x[at.REQUEST] = inputs[k, REQUEST]
        if inputs[k, SPEED] == inputs[k, SPEED]:
            sequencer_x[at.SPEED] = inputs[k, SPEED]
        reference = sequence(sequencer_p, sequencer_x, inputs[k, SETPOINT], seen, extender)
        voltage = answer(
            feedforward_p,
            feedforward_x,
            controller,
            controller_p,
            controller_x,
            handover_p,
            handover_x,
            model_hysteresis,
            inverse,
            compensator_ps,
            compensator_xs,
            reference,
            seen - sequencer_x[at.ORIGIN],
            table,
            k,
        )
        table[k, 3] = plant_xs[JOINTS][TRUE_POSITION]
        table[k, 4] = measured
        table[k, 11] = sequencer_x[at.ORIGIN]
        table[k, 12] = extender
        table[k, 13] = plant_xs[JOINTS][TRUE_POSITION + 1]
        table[k, 14] = sequencer_x[at.FRONT_VOLTAGE]
        table[k, 15] = sequencer_x[at.REAR_VOLTAGE]
        table[k, 16] = plant_xs[JOINTS][EFFORT + 2]
        table[k, 17] = plant_xs[JOINTS][EFFORT + 3]
        table[k, 18] = sequencer_x[at.PHASE]
        table[k, 19] = sequencer_x[at.STEPS]
        table[k, 20] = sequencer_x[at.DIRECTION]
        table[k, 21] = sequencer_x[at.SLIP]
        table[k, 22] = sequencer_x[at.ERROR]
        table[k, 23] = sequencer_x[at.ARRIVED]
        table[k, 24] = sequencer_x[at.TOTAL_STEPS]
        table[k, 25] = sequencer_x[at.MISSED]
        table[k, 26] = sequencer_x[at.COMMANDED_STEP]
        table[k, 27] = sequencer_x[at.ACHIEVED_STEP]
        table[k, 9] = inchworm_advance(
            extender_hysteresis,
            front_hysteresis,
            rear_hysteresis,
            plant_ps,
            plant_xs,
            voltage,
            sequencer_x[at.FRONT_VOLTAGE],
            sequencer_x[at.REAR_VOLTAGE],
        )
