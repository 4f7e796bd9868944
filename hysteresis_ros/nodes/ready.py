# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Prediction and report of the end of moves: topics ``ready``, ``ready_in`` and ``~/moves``, service ``~/move``.

The reference generator makes the predictions, with the parameters of controller and compensator from ``changes``.
Predictions are computed in a thread; the loop does not wait for them.
"""

from __future__ import annotations

import json
import math
import queue
import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from std_msgs.msg import Bool, Float64, String

from hysteresis_ros import signals
from hysteresis_ros.loop.parameters import CompensatorNodeParameters, ControllerNodeParameters
from hysteresis_ros.models.actuator import PreloadParameters
from hysteresis_ros.nodes.qos import latched_qos, setpoint_qos
from hysteresis_ros.references.moves import Noise, NoiseMeter, Readiness
from hysteresis_ros.units import micrometres, readable

if TYPE_CHECKING:
    from hysteresis_ros.loop.ready import Predictor

#: Name of the service that takes a setpoint with a tolerance.
MOVE = "move"
#: Name of the setpoint in a request of this service.
SETPOINT = "setpoint"
#: Name of the tolerance in a request.
TOLERANCE = "tolerance"
#: Name of the dwell time in a request.
DWELL = "dwell"
#: Time for which the reference must rest before the noise is measured [s].
REST = 0.05
#: Number of samples after which the noise is evaluated.
BLOCK = NoiseMeter.BLOCK
#: Maximum number of measurements of a move from which the predictor learns.
MOST = 20_000
#: Largest number of waiting jobs. If setpoints arrive faster than predictions are computed, some moves are not
#: predicted.
WAITING = 8
#: Tolerance of a move without a tolerance on an axis without ``ready.tolerance``, as a multiple of the smallest
#: tolerance that the noise permits. Normal noise exceeds twice this smallest tolerance in 1e-7 of the time.
FREE = 2.0
#: Parameter classes of the nodes whose loop is predicted.
KINDS = {signals.CONTROLLER: ControllerNodeParameters, signals.COMPENSATOR: CompensatorNodeParameters}


#: A job of the prediction thread; the thread of the node calls the function that the job may return.
Job = Callable[[], Callable[[], object] | None]


class MoveToReady:
    """A move that begins with sample ``first``, or, without a ``path``, when its setpoint next appears in a sample."""

    def __init__(self, number: int, first: int, setpoint: float, readiness: Readiness, path: dict | None):
        self.number, self.first, self.setpoint, self.path = number, first, setpoint, path
        self.readiness = readiness
        self.predicted = math.nan
        self.measured: list[float] = []
        #: Number of samples without a measurement before the axis was ready.
        self.missing = 0
        self.begun = self.done = False

    def look(self, number: int, row, offset: float) -> bool:
        """Add a sample; return whether the axis is ready. ``offset`` is the offset of the measurements [m]."""
        if not self.begun:
            is_first = number >= self.first and (self.path is not None or row[signals.SETPOINT] == self.setpoint)
            if not is_first:
                return False
            self.begun = True
        measured = math.nan if row[signals.SKIPPED] else row[signals.MEASURED] - offset
        if not self.done and len(self.measured) < MOST:
            self.measured.append(measured)
            self.missing += math.isnan(measured)
        return self.readiness.look(self.setpoint, measured)


class Thread:
    """Runs jobs one after the other, and keeps their results for :meth:`take`."""

    def __init__(self, failed: Callable[[str], object]):
        self._failed = failed
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._results: deque[Callable[[], object]] = deque()
        self._thread: threading.Thread | None = None

    def run(self, job: Job) -> bool:
        """Run a job, unless too many are waiting; return whether it will run."""
        if self._jobs.qsize() >= WAITING:
            return False
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="ready", daemon=True)
            self._thread.start()
        self._jobs.put(job)
        return True

    def _work(self) -> None:
        while True:
            job = self._jobs.get()
            if job is None:
                return
            try:
                result = job()
            except Exception as error:  # a failed prediction must not end the thread
                self.report(error)
                continue
            if result is not None:
                self._results.append(result)

    def take(self) -> None:
        """Call the functions that finished jobs have returned, in the thread of the node."""
        while self._results:
            self._results.popleft()()

    def report(self, error: Exception) -> str:
        """Let the thread of the node report an error; return the report."""
        words = f"nothing is predicted: {' '.join(str(error).split())}"
        self._results.append(partial(self._failed, words))
        return words

    def end(self) -> None:
        """End after the present job."""
        self._jobs.put(None)


def _offset(controller: dict) -> float:
    """Return the offset of the preload [m] from the parameters of a controller."""
    start = "model.preload."
    given = {name.removeprefix(start): value for name, value in controller.items() if name.startswith(start)}
    return PreloadParameters.from_mapping(given).offset


class ReadyTopics:
    """Predicts and measures when the moves of a reference generator are ready."""

    def __init__(self, node):
        self._node = node
        self._ready = node.publisher(Bool, "ready", latched_qos())
        self._ready_in = node.publisher(Float64, "ready_in", latched_qos())
        self._moves = node.publisher(String, "~/moves", setpoint_qos())
        node.subscriber(String, "changes", self._on_change, node.changes_qos())
        service = node.create_service(SetParametersAtomically, f"~/{MOVE}", self._on_move)
        node._topic_handles.append((node.destroy_service, service))
        self._thread = Thread(lambda text: node.warn("prediction", text))
        self._given: dict[str, dict] = {}
        #: Offset of the preload [m], which measurements contain and references do not.
        self.offset = 0.0
        self._predictor: Predictor | None = None
        self._stale = True
        #: Whether the axis has made a move that the predictor has not simulated.
        self._moved = True
        #: The last move that was predicted.
        self._foreseen: MoveToReady | None = None
        self._meter = NoiseMeter(REST, 1.0 / node.parameters.sample_rate)
        self._block: list[tuple[float, float]] = []
        self._number, self._first = 0, 0
        #: Tolerance [m] and dwell time [s] of the request that is being processed.
        self.asked: tuple[float, float] | None = None
        self.move: MoveToReady | None = None
        self._told: tuple[bool, float] | None = None
        self._tell(False, math.nan)

    def end(self) -> None:
        """End the thread."""
        self._thread.end()

    # -- topics --------------------------------------------------------------------------------------------------

    def _tell(self, ready: bool, time: float) -> None:
        """Publish whether the axis is ready, and the predicted time of the move [s]."""
        before = self._told or (not ready, math.inf)
        if ready != before[0]:
            self._ready.publish(Bool(data=ready))
        if time != before[1] and not (math.isnan(time) and math.isnan(before[1])):
            self._ready_in.publish(Float64(data=time))
        self._told = ready, time

    def _say(self, **values) -> None:
        """Publish the state of a move as JSON; numbers that are not finite are null."""
        plain = {
            name: None if isinstance(one, float) and not math.isfinite(one) else one for name, one in values.items()
        }
        self._moves.publish(String(data=json.dumps(plain)))

    def _on_change(self, message) -> None:
        """Store the parameters of controller and compensator."""
        try:
            entry = json.loads(message.data)
            node, action, parameters = entry["node"], entry["action"], entry["parameters"]
            if action not in (signals.CONFIGURED, "retune"):
                return
            if node in KINDS:
                before = {} if action == signals.CONFIGURED else self._given.get(node, {})
                self._given[node] = {**before, **parameters}
                if node == signals.CONTROLLER:
                    self.offset = _offset(self._given[node])
            elif node != signals.SOURCE or not any(name.startswith("shaping.") for name in parameters):
                return  # these do not affect the predicted loop
        except (ValueError, KeyError, TypeError):
            return
        self._stale = True
        if self._node.parameters.ready.tolerance > 0.0 and len(self._given) == len(KINDS):
            self._thread.run(self._prepare)

    # -- prediction, in the thread ---------------------------------------------------------------------------------

    def _prepare(self) -> None:
        """Build the predictor from the present parameters, unless it exists."""
        if not self._stale or len(self._given) < len(KINDS):
            return
        from hysteresis_ros.loop.ready import Predictor, model_of  # not needed without predictions

        self._stale = False
        node = self._node
        self._predictor = None
        controller = ControllerNodeParameters.from_mapping(self._given[signals.CONTROLLER])
        compensator = CompensatorNodeParameters.from_mapping(self._given[signals.COMPENSATOR])
        self._predictor = Predictor(model_of(node.parameters, controller, compensator))
        self._moved = True

    def _predict(
        self, move: MoveToReady, before: float, after: int, noise: Noise, dwell: float
    ) -> Callable[[], object]:
        try:
            self._prepare()
            if self._predictor is None:
                why = "the parameters of motion_controller and hysteresis_compensator are not known yet"
                return partial(self._on_predicted, move, why)
            if self._moved:
                self._moved = False
                self._predictor.rest_at(before)
            self._foreseen = move
            given = move.setpoint, after, move.readiness.tolerance, dwell, noise, move.path
            move.predicted = self._predictor.predict(*given)
        except Exception as error:  # report to the client that the move is not predicted
            return partial(self._on_predicted, move, self._thread.report(error))
        return partial(self._on_predicted, move)

    def _on_predicted(self, move: MoveToReady, why: str = "") -> None:
        if move is self.move and not move.done:
            self._tell(False, move.predicted)
        if not (why or math.isfinite(move.predicted)):
            why = "the simulated axis does not stay within the tolerance for the dwell time"
        self._say(move=move.number, predicted=move.predicted, **{"why": why} if why else {})

    def _learn(self, move: MoveToReady, noise: Noise) -> None:
        if self._predictor is not None and move is self._foreseen and math.isfinite(move.predicted):
            # in a sample without a measurement, the axis may have moved differently from the model
            if not move.missing:
                self._predictor.learn(move.measured, noise)
            self._predictor.follow(len(move.measured))

    # -- moves ---------------------------------------------------------------------------------------------------

    @property
    def noise(self) -> Noise | None:
        """Measured noise; None: the axis has not rested yet."""
        if math.isnan(self._meter.sensor):
            return None
        resting = self._predictor.resting if self._predictor is not None else None
        return self._meter.noise() if resting is None else self._meter.noise(resting.displacement, resting.error)

    @property
    def present(self) -> int:
        """Number of the next sample."""
        node = self._node
        return node.fused.loop.sample if node.is_fused else node.sample

    def begin(self, before: float, setpoint: float, path: dict | None = None, first: int | None = None) -> None:
        """Monitor an accepted move from the setpoint ``before`` to ``setpoint`` [m], beginning with sample ``first``.

        The tolerance comes from the request ``~/move``, or from the parameters. ``path`` are the points of a
        trajectory.
        """
        node = self._node
        now = self.present if first is None else first
        tolerance, dwell = self.asked or (node.parameters.ready.tolerance, node.parameters.ready.dwell)
        self._close("replaced")
        self._tell(False, math.nan)
        noise = self.noise or Noise(0.0, 0.0)
        if tolerance < noise.least_tolerance and tolerance > 0.0:
            node.warn("ready", f"ready.tolerance = {readable(tolerance, 'm')}: {self._too_small(noise)}")
        if tolerance <= 0.0 or tolerance < noise.least_tolerance or node.parameters.waveform.type != "hold":
            self._moved = True
            return
        after, self._first, self._number = now - self._first, now, self._number + 1
        readiness = Readiness(tolerance, dwell, noise, 1.0 / node.parameters.sample_rate)
        self.move = MoveToReady(self._number, now, setpoint, readiness, path)
        self._say(move=self._number, setpoint=setpoint, tolerance=tolerance, dwell=dwell)
        if not self._thread.run(partial(self._predict, self.move, before, after, noise, dwell)):
            self._moved = True
            why = f"{WAITING} moves are waiting for their predictions; send setpoints less often"
            self._say(move=self._number, predicted=math.nan, why=why)

    def look(self, row, number: int) -> None:
        """Take a sample and its number."""
        self._thread.take()
        if self.move is not None:
            self._take(self.move, number, row)
        missing = row[signals.SKIPPED] or row[signals.TRIPPED]
        self._block.append((row[signals.REFERENCE], math.nan if missing else row[signals.MEASURED] - self.offset))
        self._meter_noise()

    def look_at_all(self, first: int, table: np.ndarray) -> None:
        """Take samples, beginning with number ``first``, shape (row length, N); during a move, process them singly."""
        self._thread.take()
        for number, row in enumerate(table.T.tolist() if self.move is not None else (), first):
            if self.move is not None:
                self._take(self.move, number, row)
        missing = (table[signals.SKIPPED] != 0.0) | (table[signals.TRIPPED] != 0.0)
        measured = np.where(missing, math.nan, table[signals.MEASURED] - self.offset)
        self._block.extend(zip(table[signals.REFERENCE].tolist(), measured.tolist(), strict=True))
        self._meter_noise()

    def _meter_noise(self) -> None:
        """Pass the collected samples to the noise meter if they fill a block."""
        if len(self._block) >= BLOCK:
            self._meter.take(*zip(*self._block, strict=True))
            self._block.clear()

    def _take(self, move: MoveToReady, number: int, row) -> None:
        """Take a sample of the present move."""
        if row[signals.TRIPPED]:
            self.stop("the axis was stopped")
            return
        if move.begun and row[signals.SETPOINT] != move.setpoint and move.path is None:
            self.stop("the setpoint was changed without a move")
            return
        ready = move.look(number, row, self.offset)
        if ready and not move.done:
            move.done = True
            self._say(move=move.number, ready=move.readiness.since, missing=move.missing)
            self._thread.run(partial(self._learn, move, self.noise or Noise(0.0, 0.0)))
        if move.done:
            self._tell(ready, 0.0 if ready else math.nan)

    def _close(self, why: str) -> None:
        """End the present move."""
        if self.move is not None and not self.move.done:
            self._say(move=self.move.number, ended=why)
            self._thread.run(partial(self._learn, self.move, self.noise or Noise(0.0, 0.0)))
        self.move = None

    def stop(self, why: str) -> None:
        """End the present move; the axis is not ready."""
        self._close(why)
        self._moved = True
        self._tell(False, math.nan)

    def fall_silent(self) -> None:
        """Report not ready while no samples arrive; end the move, unless the axis is fused and delivers them later."""
        if not self._node.is_fused:
            self.stop("no samples arrive")
        elif self._told is not None and self._told[0]:
            self._tell(False, math.nan)

    # -- requests ------------------------------------------------------------------------------------------------

    def _too_small(self, noise: Noise) -> str:
        return (
            f"the displacement at rest has {readable(noise.displacement, 'm')} RMS of noise "
            f"(sensor {readable(noise.sensor, 'm')}) and is within "
            f"{readable(noise.least_tolerance, 'm')} of its mean during 99 % of the time; give at least that"
        )

    def _tolerance(self, given: dict[str, float]) -> float:
        """Return the tolerance of a request [m]: its own, that of the axis, or a multiple of the smallest one."""
        own, noise = self._node.parameters.ready.tolerance, self.noise
        allowed = FREE * noise.least_tolerance if noise is not None else 0.0
        return given.get(TOLERANCE, own or allowed)

    def _refusal(self, given: dict[str, float]) -> str:
        """Return why a request for a move is refused; empty if it is accepted."""
        node, noise = self._node, self.noise
        tolerance, dwell = self._tolerance(given), given.get(DWELL, 0.0)
        waveform = node.parameters.waveform.type
        if not (node.active and node.running):
            return "the reference generator does not run; activate it, or call ~/start"
        if node.hindrance():
            return node.hindrance()
        stated = TOLERANCE in given or node.parameters.ready.tolerance > 0.0
        if stated and not 0.0 < tolerance < math.inf:
            return f"tolerance {readable(tolerance, 'm')} refused: must be > 0"
        if not 0.0 <= dwell < math.inf:
            return f"dwell {dwell:g} s refused: must be ≥ 0 s"
        if waveform != "hold":
            return f"waveform.type = '{waveform}' moves the axis, so no move becomes ready; set waveform.type: hold"
        if noise is None:
            samples = NoiseMeter.SETTLED + NoiseMeter.FEWEST
            return f"the noise is not measured yet: let the axis rest for {REST:g} s and {samples} samples"
        if not tolerance > 0.0:
            return "the axis has no noise that gives a tolerance: give one, --tolerance 50nm, or set ready.tolerance"
        if tolerance < noise.least_tolerance:
            return f"tolerance {readable(tolerance, 'm')} refused: {self._too_small(noise)}"
        return ""

    def _on_move(self, request, response):
        """Take a setpoint with a tolerance and a dwell time, and reply with the number of the move as JSON."""
        node, result = self._node, response.result
        given = {one.name: one.value.double_value for one in request.parameters}
        wrong = [one for one in request.parameters if one.value.type != Parameter.Type.DOUBLE.value]
        known = SETPOINT in given and set(given) <= {SETPOINT, TOLERANCE, DWELL}
        if not known or wrong or len(given) < len(request.parameters):
            reason = f"{MOVE} takes '{SETPOINT}' [m], '{TOLERANCE}' [m] and '{DWELL}' [s], each of type double and once"
        else:
            reason = node.part.generator.refuse(given[SETPOINT]) or self._refusal(given)
        if reason:
            node.refuse("move", f"{reason}; {micrometres(node.setpoint)} is kept")
            result.successful, result.reason = False, reason
            return response
        own, target = node.parameters.ready, given[SETPOINT]
        if abs(target - node.setpoint) <= own.deadband and not node.part.generator.moving and own.deadband > 0.0:
            result.successful, result.reason = True, json.dumps({"move": None, "deadband": own.deadband})
            return response
        self.asked = self._tolerance(given), given.get(DWELL, own.dwell)
        try:
            reason = node.take_and_tell(target)
        finally:
            self.asked = None
        number = self._number
        result.successful, result.reason = not reason, reason or json.dumps({"move": number})
        return response
