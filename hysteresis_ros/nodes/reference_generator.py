"""Node ``reference_generator``: setpoints from people and waveforms → ``reference``, one for every sample."""

from __future__ import annotations

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from hysteresis_ros.nodes.base import AxisNode, sample_index
from hysteresis_ros.nodes.qos import setpoint_qos
from hysteresis_ros.nodes.spin import run
from hysteresis_ros.nodes.timing import STALE
from hysteresis_ros.references.generator import ReferenceGenerator, ReferenceParameters
from hysteresis_ros.simulation.node_parameters import part


class ReferenceGeneratorNode(AxisNode):
    """Answers every ``joint_states`` with one ``reference`` [m]; takes ``setpoint`` [m] at any time."""

    state_names = ("setpoint", "reference")

    def __init__(self, **options):
        super().__init__("reference_generator", **options)
        self.refused = 0

    def build(self, parameters) -> None:
        """Make the generator from the parameters."""
        self.generator = ReferenceGenerator(part(parameters, ReferenceParameters), 1.0 / parameters.sample_rate)
        self.setpoint = parameters.initial_setpoint
        self.generator.step(self.setpoint)  # compile now, not at the first sample
        self.generator.reset()

    def connect(self) -> None:
        """Make the topics."""
        self._message = Float64()
        self._reference = self.publisher(Float64, "reference", self.qos(), loop=True)
        self.subscriber(JointState, "joint_states", self._on_measurement, self.qos(), partner="plant_simulator")
        self.subscriber(Float64, "setpoint", self._on_setpoint, setpoint_qos())
        self.subscribe_end()
        self._awaiting = None

    def reset_blocks(self) -> None:
        """Begin again: waveform at its start, setpoint as configured."""
        self.generator.reset()
        self.setpoint = self.parameters.initial_setpoint
        self._awaiting = None

    def retune(self, parameters) -> None:
        """Take new limits of approach and range, and the waveform while it is stopped."""
        self.generator.retune(part(parameters, ReferenceParameters))

    def on_running(self, running: bool) -> None:
        """Start the waveform from its beginning, or hold the reference where it is."""
        if running:
            self.generator.start()
        else:
            self.generator.stop()

    def _on_setpoint(self, message) -> None:
        reason = self.generator.refuse(message.data)
        if reason:
            self.refused += 1
            self.warn("setpoint", f"{reason}; {self.setpoint:.6g} m is kept")
            return
        self.setpoint = message.data

    def _on_measurement(self, message) -> None:
        if self.lockstep:
            if self.expected(sample_index(message.header.stamp, self.parameters.sample_rate)):
                self.heard()
                self._awaiting = message.header.stamp
                self.advance()
        elif self.active:
            self.pace.tick()
            self._answer(message.header.stamp)

    def advance(self) -> None:
        """Answer the awaited sample once the partner is there."""
        if self._awaiting is not None and self.active and not self.failure and self.matched():
            self.pace.tick()
            stamp, self._awaiting = self._awaiting, None
            self._answer(stamp)

    def missing_partner(self) -> str:
        """Name who has not delivered what the present sample needs."""
        return "plant_simulator" if self._awaiting is None else ""

    def _answer(self, stamp) -> None:
        reference = self.generator.step(self.setpoint)
        self._message.data = reference
        self._reference.publish(self._message)
        self.publish_state(stamp, self.setpoint, reference)
        self.sample += 1

    def health(self):
        """Report refused setpoints and the present values."""
        # in real time a reference generator without measurements has nothing to answer
        stale = not self.lockstep and self.pace.age > max(STALE, 3.0 / self.parameters.sample_rate)
        values = {"setpoint_m": f"{self.setpoint:.9g}", "setpoints_refused": self.refused, "stale": stale}
        refused = self.since_report("refused", self.refused)
        if stale:
            return 2, "joint_states is stale", values
        return (1, f"{refused} setpoints refused", values) if refused else (0, "", values)


def main(arguments=None) -> int:
    """Run the node; returns the exit code."""
    return run([ReferenceGeneratorNode], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
