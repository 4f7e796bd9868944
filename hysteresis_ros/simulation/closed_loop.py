"""One sample after another through plant, reference, controller and compensator: the loop the nodes run in lockstep."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.block import composite, nested
from hysteresis_ros.compensation.compensator import APPLIED as COMPENSATOR_APPLIED
from hysteresis_ros.compensation.compensator import LIMITS as COMPENSATOR_LIMITS
from hysteresis_ros.compensation.compensator import OUT, compensator_step
from hysteresis_ros.control.feedforward import COMMAND as FEEDFORWARD_COMMAND
from hysteresis_ros.control.feedforward import feedforward
from hysteresis_ros.control.handover import handover
from hysteresis_ros.control.open_loop import APPLIED, COMMAND, DISTURBANCE, ESTIMATED, FEEDFORWARD, SWITCHING
from hysteresis_ros.models.actuator import DISPLACEMENT, SENSOR, actuator_advance, actuator_measure
from hysteresis_ros.models.limits import FLAGS
from hysteresis_ros.references.generator import reference_step

#: Columns of the table that :func:`closed_loop` fills, SI units (switching function and saturation: no unit).
SIGNALS = (
    "reference",
    "command",
    "voltage",
    "displacement",
    "measured",
    "estimated",
    "applied",
    "switching",
    "disturbance",
    "plant_voltage",
    "saturated",
)


def sample_times(first: int, count: int, sample_rate: float) -> np.ndarray:
    """Return the times [s] of samples ``first`` … ``first + count - 1`` as the nodes stamp them: whole nanoseconds.

    Parameters
    ----------
    first, count : int
        Number of the first sample, and how many there are.
    sample_rate : float
        [Hz]
    """
    return np.rint(np.arange(first, first + count) * 1e9 / sample_rate) / 1e9


@nested
def answer(
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
    measured,
    table,
    k,
):
    """Return the voltage [V] for a reference and a measurement [m] and note in row ``k`` what every loop notes.

    A measurement that is missing (NaN) leaves the command as it was.
    """
    command = controller_x[COMMAND]
    if measured == measured:
        delayed = feedforward(feedforward_p, feedforward_x, reference)
        controller_x[FEEDFORWARD] = feedforward_x[FEEDFORWARD_COMMAND]
        command = handover(handover_p, handover_x, controller(controller_p, controller_x, delayed, measured))
    voltage = compensator_step(model_hysteresis, inverse, compensator_ps, compensator_xs, command)
    table[k, 0] = reference
    table[k, 1] = command
    table[k, 2] = voltage
    table[k, 5] = controller_x[ESTIMATED]
    table[k, 6] = compensator_xs[OUT][COMPENSATOR_APPLIED]
    table[k, 7] = controller_x[SWITCHING]
    table[k, 8] = controller_x[DISTURBANCE]
    # the lower two flags are range and slew rate, the next one is quantisation
    table[k, 10] = 1.0 if compensator_xs[COMPENSATOR_LIMITS][FLAGS] % 4.0 != 0.0 else 0.0
    controller_x[COMMAND] = command
    controller_x[APPLIED] = compensator_xs[OUT][COMPENSATOR_APPLIED]
    return voltage


@composite(
    "void",
    *("kernel", "arrays:5", "arrays:5"),
    *("kernel", "arrays:3", "arrays:3"),
    *("array", "array", "controller", "array", "array", "array", "array"),
    *("kernel", "inverse", "arrays:5", "arrays:5"),
    *("array", "table"),
)
def closed_loop(
    plant_hysteresis,
    plant_ps,
    plant_xs,
    waveform,
    reference_ps,
    reference_xs,
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
    setpoints,
    table,
):
    """Run the loop for ``len(setpoints)`` samples; all states go on in place.

    Parameters
    ----------
    plant_hysteresis, waveform, controller, model_hysteresis, inverse : kernels
        What makes this loop that loop.
    plant_ps, plant_xs, reference_ps, reference_xs, compensator_ps, compensator_xs : tuples of arrays
        Parameters and states of plant, reference generator and compensator.
    feedforward_p, feedforward_x, controller_p, controller_x, handover_p, handover_x : arrays
        Parameters and states of feedforward, controller and hand-over.
    setpoints : array, shape (N,)
        Setpoint in force at each sample [m].
    table : array, shape (N, len(SIGNALS))
        Filled with the signals of each sample.
    """
    for k in range(setpoints.shape[0]):
        measured = actuator_measure(plant_ps, plant_xs)
        reference = reference_step(waveform, reference_ps, reference_xs, setpoints[k])
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
            measured,
            table,
            k,
        )
        table[k, 3] = plant_xs[SENSOR][DISPLACEMENT]
        table[k, 4] = measured
        table[k, 9] = actuator_advance(plant_hysteresis, plant_ps, plant_xs, voltage)
