# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Node ``reference_generator``: setpoints from people and waveforms → ``reference``, one for every sample."""

from __future__ import annotations

import math

from hysteresis_ros import signals
from hysteresis_ros.block import interpreted
from hysteresis_ros.loop.source import GeneratorSource, generate
from hysteresis_ros.loop.tick import Laws
from hysteresis_ros.nodes.beginning import Beginning
from hysteresis_ros.nodes.external import ExternalRun
from hysteresis_ros.nodes.reference_source import ReferenceSource
from hysteresis_ros.nodes.spin import run
from hysteresis_ros.nodes.timing import STALE
from hysteresis_ros.nodes.trajectories import Trajectories
from hysteresis_ros.nodes.trajectory_action import TrajectoryAction, action_type
from hysteresis_ros.references.settling import Settling

_GENERATE = interpreted(generate)


class ReferenceGeneratorNode(ReferenceSource):
    """Answers every ``joint_states`` with one ``reference`` [m]; takes ``setpoint`` [m] at any time."""

    identity = ("waveform.type",)
    #: Without measurements there is nothing to answer: no samples are counted.
    patience = math.inf
    outputs = (("reference", signals.REFERENCE),)

    def __init__(self, **options):
        super().__init__("reference_generator", **options)
        self.trajectories: Trajectories | None = None
        self.action: TrajectoryAction | None = None

    def build(self, parameters) -> None:
        """Make the generator from the parameters."""
        self.part = GeneratorSource(parameters)
        self._connect_part()
        self.setpoint = parameters.initial_setpoint
        tolerance = parameters.settled.tolerance or 0.01 * (parameters.maximum - parameters.minimum)
        self.settling = Settling(tolerance, parameters.settled.time, 1.0 / parameters.sample_rate)
        self.compile()

    def step(self) -> None:
        """Run the source of the loop on the row."""
        _GENERATE(self._laws, self._arrays, self.row)

    def after_step(self) -> None:
        """Look at moves that somebody waits for, and at the setpoint that a trajectory may have put in force."""
        self.setpoint = self.row[signals.SETPOINT]
        self.trajectories.look()
        if self.runner.by_message:
            self.look_at((self.row,))
        if self.action is not None:
            self.action.tell()

    def retune(self, parameters) -> None:
        """Take another waveform while stopped."""
        self.part.retune(parameters)
        self._connect_part()

    def _connect_part(self) -> None:
        self._laws = Laws(*(self.part.waveform,) * len(Laws._fields))
        self._arrays = self.part.arrays

    def before_step(self) -> None:
        """Put the setpoint into the row."""
        self.row[signals.SETPOINT] = self.setpoint

    def connect(self) -> None:
        """Make the topics."""
        self._run = ExternalRun(self) if self.parameters.external_plant else None
        self._beginning = Beginning(self) if self.runner.by_message and not self.runner.exact else None
        super().connect()
        self.trajectories = Trajectories(self)
        kind = action_type()
        self.action = TrajectoryAction(self, self.trajectories, kind) if kind else None

    def begin(self) -> None:
        """Go to work, and look after the plant of somebody else."""
        super().begin()
        self.forget_settled()
        self.trajectories.begin()
        if self._run is not None:
            self._run.begin()

    def release(self) -> None:
        """Let go of moves that are under way."""
        super().release()
        if self.trajectories is not None:
            self.trajectories.give_up("the node has stopped working")

    def unbuild(self) -> None:
        """Let go of the action."""
        if self.action is not None:
            self.action.server.destroy()
        self.trajectories = self.action = None

    def forget_settled(self) -> None:
        """Begin anew to look whether the axis settles."""
        self.settling.restart()

    def look_at(self, rows) -> None:
        """Look at samples whether the axis has settled in them."""
        look = self.settling.look
        for row in rows:
            if not row[signals.SKIPPED]:  # nobody looked
                stopped = row[signals.TRIPPED] != 0.0
                look(row[signals.SETPOINT], row[signals.REFERENCE], row[signals.MEASURED], stopped)
        self.tell_settled(self.settling.settled)

    def steer(self, action: str, parameters: dict | None = None) -> None:
        """Let the reference follow a trajectory, or come to rest, from the next sample on, and log it.

        Parameters
        ----------
        action : str
            ``follow`` or ``hold``.
        parameters : dict, optional
            The points of a trajectory.

        Raises
        ------
        HysteresisError
            It is refused; nothing is changed then.
        """
        if self.is_fused:
            self.fused.apply(self.kind, action, parameters)
        else:
            getattr(self.part, action)(**(parameters or {}))
            self.log_change(action, parameters)

    @property
    def take_measurement(self):
        """What takes ``joint_states``: once the beginning is known, of an external plant those of the run only."""
        awaited = [one for one in (self._beginning, self._run) if one is not None]
        taken = self.runner.measurement
        if not awaited:
            return taken
        return lambda message: taken(message) if all(one.take(message) for one in awaited) else None

    def begin_at(self, position: float) -> None:
        """Begin where an axis is that runs already [m]; a setpoint that has come meanwhile is gone to from there."""
        asked = self.setpoint != self.parameters.initial_setpoint
        self.part.begin_at(position)
        if not asked:
            self.setpoint = self.part.generator.setpoint
        self.log_change("begin_at", {"position": position})

    @property
    def unasked(self) -> bool:
        """Whether it stays where it has begun, because nobody has asked for anything."""
        return self.part is not None and self.part.generator.unasked

    def on_running(self, running: bool) -> None:
        """``~/stop`` holds the reference, ``~/start`` runs the waveform from its beginning."""
        if running and self.unasked:
            self.setpoint = self.parameters.initial_setpoint
        super().on_running(running)

    def _on_start(self, request, response):
        if self.running and self.part is not None and self.part.generator.waits and not self.is_fused:
            self.on_running(True)
        return super()._on_start(request, response)

    def reset_blocks(self) -> None:
        """Begin again: waveform at its start, setpoint as configured."""
        super().reset_blocks()
        self.setpoint = self.parameters.initial_setpoint

    def take_setpoint(self, value: float) -> str:
        """Take a setpoint [m]; return why it is refused, empty when it is taken."""
        reason = self.part.generator.refuse(value)
        if reason:
            return reason
        self.setpoint = value
        if self.is_fused:
            self.fused.loop.set(setpoint=self.setpoint)
        return ""

    def health(self):
        """Report refused setpoints and the present values."""
        # in real time a reference generator without measurements has nothing to answer
        stale = not self.runner.exact and self.pace.age > max(STALE, 3.0 / self.parameters.sample_rate)
        values = {"setpoint_m": f"{self.setpoint:.9g}", "setpoints_refused": self.refused, "stale": stale}
        refused = self.since_report("refused", self.refused)
        if stale:
            return 2, "joint_states is stale", values
        if self.row[signals.TRIPPED]:
            return 2, "the plant has stopped the axis", values
        begun = "holds where the axis was when it came; send a setpoint, or call ~/start" if self.unasked else ""
        return (1, f"{refused} setpoints refused", values) if refused else (0, begun, values)


def main(arguments=None) -> int:
    """Run the node; returns the exit code."""
    return run([ReferenceGeneratorNode], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
