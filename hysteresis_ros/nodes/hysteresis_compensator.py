# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Node ``hysteresis_compensator``: ``command`` [m] → ``voltage`` [V] and ``applied`` [m]."""

from __future__ import annotations

import math
import pathlib
import time

from hysteresis_ros import signals
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.loop.compensator import CompensatorPart, adapted_text, compensate
from hysteresis_ros.loop.parameters import CompensatorNodeParameters
from hysteresis_ros.loop.tick import Laws
from hysteresis_ros.loop.watch import MODE_NAMES, RUNNING, STALE, TRIPPED
from hysteresis_ros.models import adaptation as adapting
from hysteresis_ros.models.block import interpreted
from hysteresis_ros.nodes.responder import Input, Responder
from hysteresis_ros.nodes.spin import run
from hysteresis_ros.nodes.timing import AMPLIFIER, LimitedTime, limited_in_all

#: Longest ramp to the safe voltage at exit [s]; after this time the voltage steps to the safe voltage.
LEAVING_TIME = 0.3

_COMPENSATE = interpreted(compensate)


class HysteresisCompensatorNode(Responder):
    """Inverts the hysteresis and keeps the voltage within its limits.

    Missing commands are handled in the node's part of the loop (:mod:`hysteresis_ros.loop.compensator`). In real time
    the commands may come from any node; while no commands arrive, the clock counts the samples. At exit the voltage
    returns to ``safe_voltage``.
    """

    parameters: CompensatorNodeParameters
    identity = ("inverse.type", "hysteresis.type")
    inputs = (Input("command", signals.COMMAND, "motion_controller"),)
    outputs = (("voltage", signals.VOLTAGE), ("applied", signals.APPLIED))
    trigger = "command"
    triggered_by_measurement = False
    share = 0.9
    triggers = (*Responder.triggers, "freeze", "resume", "forget", "save")

    def __init__(self, **options):
        super().__init__("hysteresis_compensator", **options)

    def build(self, parameters) -> None:
        """Create the compensator from the parameters."""
        self.part = CompensatorPart(parameters)
        compensator = self.part.compensator
        model = compensator.hysteresis_kernel
        laws = dict.fromkeys(Laws._fields, model) | {"inverse": compensator.inverse_step}
        self._laws = Laws(**laws)
        self.refused = 0
        self._mode = RUNNING
        self._limited, self._told = LimitedTime(), True
        self.compile()

    def step(self) -> None:
        """Compute the sample in the row with the compensator of the loop."""
        _COMPENSATE(self._laws, self.part.arrays, self.row)

    def begin(self) -> None:
        """In real time, continue from the present output voltage."""
        self._told = False
        if self.runner.by_message and not self.runner.exact and self.sample and self.running:
            self.part.start()

    def reset_blocks(self) -> None:
        """Reset the compensator to rest."""
        super().reset_blocks()
        self.refused = 0
        self._mode = RUNNING

    @property
    def compensator(self):
        """The compensator."""
        return self.part.compensator

    @property
    def voltage(self) -> float:
        """Last output voltage [V]."""
        return self.part.voltage

    @property
    def is_stale(self) -> bool:
        """Whether no command has arrived within the time-out."""
        return self.silent

    @property
    def silent(self) -> bool:
        """Whether no command has arrived within the time-out."""
        return self._mode == STALE

    @property
    def patience(self) -> float:
        """Time without a command after which samples are counted by the clock [s]."""
        return self.parameters.command_timeout

    def read(self, message, row) -> bool:
        """Write into a row whether the axis is stopped, and the measurement if the inverse is adaptive."""
        if self.part.adaptation is not None:
            return super().read(message, row)
        self.read_trip(message, row)
        return True

    def refuse_value(self, input_: Input, data: float) -> None:
        """Log that a command is invalid."""
        self.refused += 1
        self.warn("command", f"command = {data} m refused; {self.compensator.command:.6g} m is kept")
        if not self.runner.exact and self.sample:
            self.publish_outputs()  # the plant counts the voltages, so every command needs exactly one voltage

    def after_step(self) -> None:
        """Log changes of mode."""
        if self.runner.by_message:
            self.row[signals.MEASURED] = math.nan  # so that no measurement is used twice
        self.after_missing()

    def after_missing(self) -> None:
        """Log changes of mode."""
        mode = int(self.row[signals.COMPENSATOR_MODE])
        if mode == self._mode:
            return
        before, self._mode = self._mode, mode
        if mode == STALE:
            limit, safe = self.parameters.command_timeout, self.parameters.safe_voltage
            self.warn("silent", f"no command for {limit:g} s: going to safe_voltage {safe:g} V")
        elif mode == TRIPPED and not self.runner.latched:
            self.warn("tripped", "the plant has stopped the axis: going to safe_voltage", error=True)
        elif mode == RUNNING and before == STALE:
            self.get_logger().info("command is back")

    # -- adaptation ----------------------------------------------------------------------------------------------

    def _on_freeze(self, request, response):
        return self._steer(response, "freeze", "adaptation off: the weights are kept")

    def _on_resume(self, request, response):
        return self._steer(response, "resume", "adaptation on: the weights follow the measurements")

    def _on_forget(self, request, response):
        return self._steer(response, "forget", "the weights are reset to the identified ones")

    def _steer(self, response, action: str, done: str):
        if self.is_fused:
            self.fused.apply(self.kind, action)
        elif self.part is not None:
            getattr(self.part, action)()
            self.log_change(action)
        return self._answer_service(response, done)

    def _on_save(self, request, response):
        if self.part is None:
            return self._answer_service(response, "")
        from hysteresis_ros.identification.parameter_file import write_file

        text, given = adapted_text(self.get_fully_qualified_name(), self.part), self.parameters.adaptation.save_file
        if not given:
            remedy = "names no file; give one at configuration, because only that file is written"
            raise ParameterError([Problem("adaptation.save_file", given, remedy)])
        path = pathlib.Path(given).absolute()
        write_file(path, text)
        return self._answer_service(response, f"{path} written")

    @property
    def rests(self) -> bool:
        """Whether the node is stopped and its voltage is safe."""
        return not self.running and self.voltage == self.parameters.safe_voltage

    def go_safe(self) -> None:
        """Publish the ramp to the safe voltage; in lockstep, where no time passes, only the safe voltage."""
        if self.sample == 0:
            return
        self.part.stop()
        samples = max(round(0.001 * self.parameters.sample_rate), 1)
        step = samples * self.parameters.safe_slew_rate / self.parameters.sample_rate
        deadline = time.monotonic() + LEAVING_TIME
        while (
            not self.runner.exact
            and abs(self.voltage - self.parameters.safe_voltage) > step
            and time.monotonic() < deadline
        ):
            self.row[signals.COMMAND] = math.nan
            for _ in range(samples):
                self.step()
            self.publish_outputs()
            time.sleep(samples / self.parameters.sample_rate)
        # only the voltage is published: in lockstep any other message would be assigned to a sample
        self._message.data = self.part.make_safe()
        self._outputs[0][1].publish(self._message)
        if self.running:
            self.part.start()

    def _limited_counts(self) -> dict[str, int]:
        return {AMPLIFIER: self.compensator.limits.limited_samples}

    def release(self) -> None:
        """Log once, at the end of the run, how long the limits restricted the voltage."""
        if self.part is None or self._told:
            return
        self._told = True
        limited = limited_in_all(self._limited_counts(), self.sample, self.parameters.sample_rate)
        if limited:
            self.get_logger().warning(limited)

    def stopped(self) -> str:
        """Return a message about the effect of ``~/stop``."""
        if self.rests:
            return "stopped"
        return f"stopped: the voltage goes to safe_voltage = {self.parameters.safe_voltage:g} V"

    def health(self):
        """Report saturation, missing commands and refused commands."""
        values = {
            "voltage_v": f"{self.voltage:.6g}",
            "saturated_samples": self.compensator.limits.limited_samples,
            "refused_commands": self.refused,
            "stale": self.silent,
            "mode": MODE_NAMES[self._mode],
        }
        adaptation, adapted = self.part.adaptation, ""
        if adaptation is not None:
            names = adapting.STATE_NAMES
            # a copy of the state after the last sample, because another thread may be using the part
            state, gain = int(self.row[signals.ADAPTATION]), self.row[signals.ADAPTED_GAIN]
            adapted = f"adaptation {names[state]}" if state > adapting.ADAPTING else ""
            values |= {"adaptation": names[state], "adapted_gain": f"{gain:.5g}"}
        refused = self.since_report("refused", self.refused)
        limited = self._limited.report(self._limited_counts(), self.parameters.sample_rate)
        if not self.sample and not self.runner.exact:
            return 2, "no command has arrived yet", values
        if self.silent or self.runner.latched:
            return 2, f"command is stale{': ' * bool(self.loss)}{self.loss}", values
        if self._mode == TRIPPED:
            return 2, "the plant has stopped the axis", values
        if refused:
            return 1, f"{refused} commands refused", values
        if limited:
            return 1, limited, values
        return (1, "voltage saturated", values) if self.compensator.saturated else (0, adapted, values)


def main(arguments=None) -> int:
    """Run the node; return the exit code."""
    return run([HysteresisCompensatorNode], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
