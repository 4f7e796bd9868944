# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Steps and moves of an inchworm's run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import HysteresisError, RecordingError
from hysteresis_ros.recordings.configured import configured, described
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references.inchworm_parameters import InchwormSequencerParameters
from hysteresis_ros.signals import MOTOR_SOURCE as SEQUENCER

#: What a run needs beside ``setpoint`` and ``displacement`` (or ``measured``): signals of the sequencer.
REQUIRED = (
    *("phase", "steps", "total_steps", "step_commanded", "step_achieved", "slip", "arrived", "missed"),
    *("front_voltage", "rear_voltage"),
)
#: Signals that only an inchworm's run has.
DISTINCTIVE = ("phase", "total_steps", "step_achieved", "front_voltage", "rear_voltage")

#: Distance [m] from the first setpoint at which the beginning of a run is no move, where no tolerance is configured.
TOLERANCE = 10.0e-9


@dataclass(frozen=True)
class Steps:
    """The steps of a run, in their order.

    Parameters
    ----------
    index : array of int, shape (S,)
        Sample at which each was judged.
    time : array, shape (S,)
        Its time [s].
    direction : array, shape (S,)
        +1 forward, -1 backward.
    commanded, achieved : array, shape (S,)
        Lengths [m], negative backward; ``achieved`` by the measured slider.
    slip : array, shape (S,)
        Extension less movement of the slider along it [m].
    missed : array of bool, shape (S,)
        Whether the sequencer counted it as missed.
    """

    index: np.ndarray
    time: np.ndarray
    direction: np.ndarray
    commanded: np.ndarray
    achieved: np.ndarray
    slip: np.ndarray
    missed: np.ndarray

    @property
    def extension(self) -> np.ndarray:
        """Extension of each step [m], without sign."""
        return self.slip + self.direction * self.achieved

    def between(self, first: int, last: int) -> Steps:
        """Return the steps that were judged in samples ``first`` ≤ k < ``last``."""
        chosen = (self.index >= first) & (self.index < last)
        return Steps(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Move:
    """Stretch of a run in which one thing was asked for.

    Parameters
    ----------
    first, last : int
        Samples ``first`` ≤ k < ``last``.
    kind : str
        ``move`` to a goal, ``walk`` (continuously), ``stop``, ``release`` or ``hold`` (after walking).
    goal : float or None
        Where to [m]; None where nobody asked for a place.
    arrival : int or None
        Sample from which on the sequencer says that it has arrived, to the end; None when it does not.
    """

    first: int
    last: int
    kind: str
    goal: float | None
    arrival: int | None


@dataclass(frozen=True)
class InchwormRun:
    """An inchworm's run made ready: samples that lack a signal are left out.

    Parameters
    ----------
    time, setpoint, slider : array, shape (N,)
        [s], [m], and the true displacement of the slider, or the measured one where nobody knows the true one [m].
    signals : dict of str to array, shape (N,)
        All signals.
    steps : Steps
    moves : tuple of Move
    gait : GaitParameters or None
        Of the configuration.
    tolerance : float
        Distance at which the motor has arrived [m].
    notes : tuple of str
        What a reader must know.
    """

    time: np.ndarray
    setpoint: np.ndarray
    slider: np.ndarray
    signals: dict
    steps: Steps
    moves: tuple
    gait: object
    tolerance: float
    notes: tuple


def is_inchworm(recording: Recording) -> bool:
    """Tell whether a recording is an inchworm's: by its signals, or by its configuration."""
    if any(recording.has(name) for name in DISTINCTIVE):
        return True
    return _described(recording)


def inchworm_run(recording: Recording, settings: InchwormSequencerParameters | None = None) -> InchwormRun:
    """Find steps and moves in a recording.

    Parameters
    ----------
    recording : Recording
    settings : InchwormSequencerParameters, optional
        What its configuration says, for who knows it already.

    Raises
    ------
    RecordingError
        Signals are missing; the message names them.
    """
    actual = "displacement" if recording.has("displacement") else "measured"
    absent = [name for name in ("setpoint", actual, *REQUIRED) if not recording.has(name)]
    if absent:
        raise RecordingError(
            f"the recording of an inchworm lacks {', '.join(absent)}; record inchworm_sequencer/state and "
            "plant_simulator/state or joint_states"
        )
    notes = list(recording.notes)
    if actual == "measured":
        notes.append("no displacement: errors are judged by the measured one")
    good = np.all([np.isfinite(recording[name]) for name in ("setpoint", actual, *REQUIRED)], axis=0)
    if not np.any(good):
        raise RecordingError("no sample of the recording has all the signals of an inchworm")
    signals = {name: values[good] for name, values in recording.signals.items()}
    time = recording.time[good]
    parameters = settings or _parameters(recording)
    tolerance = parameters.fine.tolerance if parameters else TOLERANCE
    home = parameters.home_position if parameters else None
    moves = find_moves(signals, signals[actual], tolerance, home)
    gait = parameters.gait if parameters else None
    slider, steps = signals[actual], find_steps(time, signals)
    return InchwormRun(time, signals["setpoint"], slider, signals, steps, moves, gait, tolerance, tuple(notes))


def find_steps(time, signals) -> Steps:
    """Return the steps of a run: the samples at which ``total_steps`` grows, and what the sequencer says there."""
    index = np.flatnonzero(np.diff(signals["total_steps"]) > 0.0) + 1
    return Steps(
        index,
        time[index],
        np.sign(signals["steps"][index] - signals["steps"][index - 1]),
        *(signals[name][index] for name in ("step_commanded", "step_achieved", "slip")),
        signals["missed"][index] > signals["missed"][index - 1],
    )


def find_moves(signals, slider, tolerance: float, home: float | None = None) -> tuple[Move, ...]:
    """Return the moves of a run: from each new setpoint, request or speed to the next one.

    The beginning of a run, before anything was asked for, is a move when the slider is not at the setpoint already.

    Parameters
    ----------
    signals : dict of str to array, shape (N,)
        ``setpoint`` and ``arrived``; ``request`` and ``speed`` where they were recorded.
    slider : array, shape (N,)
        Displacement [m].
    tolerance : float
        Distance from the setpoint at which the slider is there [m].
    home : float, optional
        Where a request for home goes [m]; the setpoint by default.
    """
    setpoint, size = signals["setpoint"], len(slider)
    request = np.nan_to_num(signals.get("request", np.zeros(size)))
    request = np.where(request <= at.RELEASE_REQUEST, request, at.NO_REQUEST)  # learning asks for no motion
    speed = np.nan_to_num(signals.get("speed", np.zeros(size)))
    changed = (np.diff(setpoint) != 0.0) | (np.diff(speed) != 0.0) | (request[1:] != 0.0)
    starts = [0, *(np.flatnonzero(changed) + 1).tolist()]
    modes = {at.STOP_REQUEST: "stop", at.RELEASE_REQUEST: "release"}
    mode, goal, found = "move", float(setpoint[0]), []
    for first, last in zip(starts, [*starts[1:], size], strict=True):
        asked = int(request[first])
        if first and setpoint[first] != setpoint[first - 1]:
            goal = float(setpoint[first])
        elif first and speed[first] == 0.0 and speed[first - 1] != 0.0:
            goal = None  # it stays where it is
        if asked == at.HOME_REQUEST:
            goal = float(setpoint[first]) if home is None else home
        if asked:
            mode = modes.get(asked, "move")
        kind = mode
        if mode == "move":
            kind = "walk" if speed[first] != 0.0 else "hold" if goal is None else "move"
        if first == 0 and kind == "move" and abs(goal - slider[0]) <= tolerance:
            continue
        aim = goal if kind == "move" else None
        found.append(Move(first, last, kind, aim, None if aim is None else _arrival(signals["arrived"], first, last)))
    return tuple(found)


def _arrival(arrived, first: int, last: int) -> int | None:
    """Return the sample from which on ``arrived`` is 1 until ``last``."""
    away = np.flatnonzero(arrived[first:last] != 1.0)
    start = first + (int(away[-1]) + 1 if away.size else 0)
    return start if start < last else None


def _described(recording: Recording) -> bool:
    """Tell whether the configuration has a sequencer: values for every node reach one that is not there, too."""
    return described(recording.configuration, SEQUENCER, str(recording.metadata.get("namespace", "")))


def _parameters(recording: Recording):
    """Return the sequencer's parameters, None when the recording does not hold them."""
    if not _described(recording):
        return None
    values = configured(recording.configuration, SEQUENCER, str(recording.metadata.get("namespace", "")))
    names = {row.name for row in InchwormSequencerParameters.table()}
    known = {name: value for name, value in values.items() if name in names}
    try:
        return InchwormSequencerParameters.from_mapping(known)
    except HysteresisError:
        return None
