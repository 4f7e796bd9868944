"""What ``plant_simulator`` simulates: one actuator, or an inchworm motor, with their topics."""

from __future__ import annotations

from array import array

from sensor_msgs.msg import JointState

from hysteresis_ros.models.actuator import Actuator, ActuatorParameters
from hysteresis_ros.models.inchworm import (
    EFFORT,
    FRONT_LIMITS,
    JOINT_NAMES,
    JOINTS,
    POSITION,
    REAR_LIMITS,
    TRUE_POSITION,
    VELOCITY,
    Inchworm,
    InchwormPlantParameters,
)
from hysteresis_ros.simulation.node_parameters import part


def _joint_states(names: tuple[str, ...]) -> JointState:
    """Return a message for these joints that is filled in place at each sample."""
    message = JointState()
    message.name = list(names)
    message.position, message.velocity, message.effort = (array("d", bytes(8 * len(names))) for _ in range(3))
    return message


class ActuatorPlant:
    """One actuator.

    Parameters
    ----------
    parameters : PlantNodeParameters
        Of type actuator.

    Attributes
    ----------
    state_names : tuple of str
        Signals of ``~/state``, as :meth:`advance` returns them.
    inputs : tuple of (str, str)
        Topics of the voltages, and who publishes each.
    message : sensor_msgs.msg.JointState
        ``joint_states``; :meth:`measure` fills it.
    """

    state_names = ("displacement", "measured", "voltage")
    inputs = (("voltage", "hysteresis_compensator"),)

    def __init__(self, parameters):
        self._rate = parameters.sample_rate
        self.actuator = Actuator(part(parameters, ActuatorParameters), 1.0 / parameters.sample_rate)
        self.message = _joint_states((parameters.joint,))
        self.message.effort[0] = parameters.preload.force
        self.actuator.measure()  # compile now, not at the first sample
        self.actuator.advance(0.0)
        self.actuator.reset()

    @property
    def resting_voltages(self) -> tuple[float, ...]:
        """Voltage of each input before the first one is received [V]."""
        return (self.actuator.voltage,)

    def safe_voltages(self, parameters, held) -> tuple[float, ...]:
        """Return where each voltage goes when its publisher falls silent [V]; ``held`` is what is put out now."""
        return (parameters.safe_voltage,)

    def measure(self, first: bool) -> None:
        """Measure the present sample into the message; ``first``: there is none before it."""
        message = self.message
        before = message.position[0]
        measured = self.actuator.measure()
        message.position[0] = measured
        message.velocity[0] = 0.0 if first else (measured - before) * self._rate

    def advance(self, voltage: float) -> tuple[float, ...]:
        """Hold the voltage [V] for one sample; returns the signals of ``~/state``."""
        displacement = self.actuator.displacement
        measured = self.message.position[0]
        return displacement, measured, self.actuator.advance(voltage)

    def reset(self) -> None:
        """Begin again at rest."""
        self.actuator.reset()

    def retune(self, parameters) -> None:
        """Take new parameters while running."""
        self.actuator.retune(part(parameters, ActuatorParameters))

    @property
    def saturated(self) -> bool:
        """Whether range or slew rate limited the last voltage."""
        return self.actuator.saturated

    @property
    def limited_samples(self) -> int:
        """Samples so far that range or slew rate limited."""
        return self.actuator.limits.limited_samples


class InchwormPlant:
    """An inchworm motor: three voltages, four joints; otherwise as :class:`ActuatorPlant`.

    Its slider has the name of the parameter ``joint``, the others are called as in the model.

    Parameters
    ----------
    parameters : PlantNodeParameters
        Of type inchworm.
    """

    state_names = (
        *("displacement", "measured", "voltage", "extender_displacement", "extender", "front_force", "rear_force"),
        *("front_voltage", "rear_voltage"),
    )
    inputs = (
        ("voltage", "hysteresis_compensator"),
        ("front_clamp/voltage", "inchworm_sequencer"),
        ("rear_clamp/voltage", "inchworm_sequencer"),
    )

    def __init__(self, parameters):
        self.motor = Inchworm(part(parameters, InchwormPlantParameters), 1.0 / parameters.sample_rate)
        self.message = _joint_states((parameters.joint, *JOINT_NAMES[1:]))
        self.motor.measure()  # compile now, not at the first sample
        self.motor.advance(*self.motor.voltages)
        self.motor.reset()

    @property
    def resting_voltages(self) -> tuple[float, ...]:
        """Voltage of each input before the first one is received [V]."""
        return self.motor.voltages

    def safe_voltages(self, parameters, held) -> tuple[float, ...]:
        """Return where each voltage goes when its publisher falls silent [V]; ``held`` is what is put out now.

        A clamp is never opened: a slider that nobody holds falls. It goes to the voltage at which it stands before the
        start, or stays where it is when that is higher. The gait keeps one clamp closed at any time.
        """
        motor = parameters.inchworm
        front, rear = motor.front_clamp.initial_voltage, motor.rear_clamp.initial_voltage
        return parameters.safe_voltage, max(front, held[1]), max(rear, held[2])

    def measure(self, first: bool) -> None:
        """Measure the present sample into the message."""
        self.motor.measure()
        joints, message = self.motor.xs[JOINTS], self.message
        message.position[:] = array("d", joints[POSITION : POSITION + 4].tobytes())
        message.velocity[:] = array("d", joints[VELOCITY : VELOCITY + 4].tobytes())
        message.effort[:] = array("d", joints[EFFORT : EFFORT + 4].tobytes())

    def advance(self, voltage: float, front_voltage: float, rear_voltage: float) -> tuple[float, ...]:
        """Hold three voltages [V] for one sample; returns the signals of ``~/state``."""
        xs = self.motor.xs
        really = self.motor.advance(voltage, front_voltage, rear_voltage)
        joints = xs[JOINTS].tolist()
        return (
            *(joints[TRUE_POSITION], joints[POSITION], really, joints[TRUE_POSITION + 1], joints[POSITION + 1]),
            *(joints[EFFORT + 2], joints[EFFORT + 3], xs[FRONT_LIMITS][0], xs[REAR_LIMITS][0]),
        )

    def reset(self) -> None:
        """Begin again at rest, the clamps at their initial voltages."""
        self.motor.reset()

    def retune(self, parameters) -> None:
        """Take new parameters while running."""
        self.motor.retune(part(parameters, InchwormPlantParameters))

    @property
    def saturated(self) -> bool:
        """Whether range or slew rate limited one of the last voltages."""
        return self.motor.saturated

    @property
    def limited_samples(self) -> int:
        """Samples so far in which range or slew rate limited a voltage, summed over the three amplifiers."""
        motor = self.motor
        return sum(part.limits.limited_samples for part in (motor.extender, motor.front_clamp, motor.rear_clamp))


#: Plant of each ``type``.
PLANTS = {"actuator": ActuatorPlant, "inchworm": InchwormPlant}
