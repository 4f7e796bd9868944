# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Figures of merit of an inchworm motor's run in SI units: moves, steps, and clamping forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.analysis.metrics import FIGURES, TIMELINESS, chattering_figures, sampling_figures
from hysteresis_ros.analysis.tables import aligned, format_value, shown
from hysteresis_ros.errors import HysteresisError, RecordingError
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.provenance import configured, described
from hysteresis_ros.references import inchworm_layout as at
from hysteresis_ros.references.inchworm_parameters import GaitParameters, InchwormSequencerParameters
from hysteresis_ros.signals import MOTOR_SOURCE as SEQUENCER

#: Sequencer signals that a run needs in addition to ``setpoint`` and ``displacement`` (or ``measured``).
REQUIRED = (
    *("phase", "steps", "total_steps", "step_commanded", "step_achieved", "slip", "arrived", "missed"),
    *("front_voltage", "rear_voltage"),
)
#: Signals that occur only in the run of an inchworm motor.
DISTINCTIVE = ("phase", "total_steps", "step_achieved", "front_voltage", "rear_voltage")

#: Default tolerance [m]: a run begins at rest if the slider starts within this distance of the first setpoint.
TOLERANCE = 10.0e-9


@dataclass(frozen=True)
class Steps:
    """The steps of a run, in order."""

    index: np.ndarray  #: shape (S,); Sample in which the sequencer evaluated the step.
    time: np.ndarray  #: shape (S,); Time of that sample [s].
    direction: np.ndarray  #: shape (S,); +1 forward, -1 backward.
    #: commanded, achieved: shape (S,); Step lengths [m], negative backward; ``achieved`` is measured at the slider.
    commanded: np.ndarray
    achieved: np.ndarray
    slip: np.ndarray  #: shape (S,); Slip: extension minus movement of the slider in the direction of the step [m].
    missed: np.ndarray  #: shape (S,); Whether the sequencer counted the step as missed.

    @property
    def extension(self) -> np.ndarray:
        """Extension of each step [m], without sign."""
        return self.slip + self.direction * self.achieved

    def between(self, first: int, last: int) -> Steps:
        """Return the steps that were evaluated in the samples ``first`` ≤ k < ``last``."""
        chosen = (self.index >= first) & (self.index < last)
        return Steps(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Move:
    """Part of a run that belongs to one request."""

    first: int  #: first, last: Samples ``first`` ≤ k < ``last``.
    last: int
    kind: str  #: ``move`` to a goal, ``walk`` (continuously), ``stop``, ``release`` or ``hold`` (after walking).
    goal: float | None  #: Requested position [m]; None if the request states no position.
    #: First sample of the arrival that the sequencer reports without interruption until the end of the move; None: no
    #: arrival.
    arrival: int | None


@dataclass(frozen=True)
class InchwormRun:
    """The run of an inchworm motor, prepared for evaluation: samples with a missing signal are omitted."""

    #: time, setpoint, slider: shape (N,); Time [s], setpoint [m], and displacement of the slider [m]: the true one or,
    #: if it is unknown, the measured one.
    time: np.ndarray
    setpoint: np.ndarray
    slider: np.ndarray
    signals: dict  #: shape (N,); All signals.
    steps: Steps
    moves: tuple
    gait: GaitParameters | None  #: Gait in the recorded configuration.
    tolerance: float  #: Distance from the setpoint at which the motor has arrived [m].
    notes: tuple  #: Notes for the reader.


def is_inchworm(recording: Recording) -> bool:
    """Return whether a recording is of an inchworm motor, according to its signals or its configuration."""
    if any(recording.has(name) for name in DISTINCTIVE):
        return True
    return _described(recording)


def inchworm_run(recording: Recording, settings: InchwormSequencerParameters | None = None) -> InchwormRun:
    """Find steps and moves in a recording."""
    actual = "displacement" if recording.has("displacement") else "measured"
    absent = [name for name in ("setpoint", actual, *REQUIRED) if not recording.has(name)]
    if absent:
        raise RecordingError(
            f"the recording of an inchworm motor lacks {', '.join(absent)}; record inchworm_sequencer/state and "
            "plant_simulator/state or joint_states"
        )
    notes = list(recording.notes)
    if actual == "measured":
        notes.append("no true displacement: errors are computed from the measured displacement")
    good = np.all([np.isfinite(recording[name]) for name in ("setpoint", actual, *REQUIRED)], axis=0)
    if not np.any(good):
        raise RecordingError("no sample of the recording has all the signals of an inchworm motor")
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
    """Return the steps of a run: the sequencer's signals in the samples in which ``total_steps`` grows."""
    index = np.flatnonzero(np.diff(signals["total_steps"]) > 0.0) + 1
    return Steps(
        index,
        time[index],
        np.sign(signals["steps"][index] - signals["steps"][index - 1]),
        commanded=signals["step_commanded"][index],
        achieved=signals["step_achieved"][index],
        slip=signals["slip"][index],
        missed=signals["missed"][index] > signals["missed"][index - 1],
    )


def find_moves(signals, slider, tolerance: float, home: float | None = None) -> tuple[Move, ...]:
    """Return the moves of a run; each move lasts from a change of setpoint, speed or request to the next change.

    The part of a run before the first change is a move too, unless the slider is already at the setpoint.

    Units: ``slider`` [m], ``tolerance`` [m], ``home`` [m].
    """
    setpoint, size = signals["setpoint"], len(slider)
    request = np.nan_to_num(signals.get("request", np.zeros(size)))
    request = np.where(request <= at.RELEASE_REQUEST, request, at.NO_REQUEST)  # a request to learn causes no motion
    speed = np.nan_to_num(signals.get("speed", np.zeros(size)))
    changed = (np.diff(setpoint) != 0.0) | (np.diff(speed) != 0.0) | (request[1:] != 0.0)
    starts = [0, *(np.flatnonzero(changed) + 1).tolist()]
    modes = {at.STOP_REQUEST: "stop", at.RELEASE_REQUEST: "release"}
    mode, found = "move", []
    goal: float | None = float(setpoint[0])
    for first, last in zip(starts, [*starts[1:], size], strict=True):
        asked = int(request[first])
        if first and setpoint[first] != setpoint[first - 1]:
            goal = float(setpoint[first])
        elif first and speed[first] == 0.0 and speed[first - 1] != 0.0:
            goal = None  # the slider stays at its position
        if asked == at.HOME_REQUEST:
            goal = float(setpoint[first]) if home is None else home
        if asked:
            mode = modes.get(asked, "move")
        kind = mode
        if mode == "move":
            kind = "walk" if speed[first] != 0.0 else "hold" if goal is None else "move"
        if first == 0 and kind == "move" and goal is not None and abs(goal - slider[0]) <= tolerance:
            continue
        aim = goal if kind == "move" else None
        found.append(Move(first, last, kind, aim, None if aim is None else _arrival(signals["arrived"], first, last)))
    return tuple(found)


def _arrival(arrived, first: int, last: int) -> int | None:
    """Return the first sample from which ``arrived`` remains 1 until ``last``; None: it is not 1 at the end."""
    away = np.flatnonzero(arrived[first:last] != 1.0)
    start = first + (int(away[-1]) + 1 if away.size else 0)
    return start if start < last else None


def _described(recording: Recording) -> bool:
    """Return whether the configuration has a section of the sequencer; values for all nodes do not suffice."""
    return described(recording.configuration, SEQUENCER, str(recording.metadata.get("namespace", "")))


def _parameters(recording: Recording):
    """Return the sequencer's parameters; None if the recording does not contain them."""
    if not _described(recording):
        return None
    values = configured(recording.configuration, SEQUENCER, str(recording.metadata.get("namespace", "")))
    names = {row.name for row in InchwormSequencerParameters.table()}
    known = {name: value for name, value in values.items() if name in names}
    try:
        return InchwormSequencerParameters.from_mapping(known)
    except HysteresisError:
        return None


#: A step is a full step if its extension is at least this fraction of the median extension in the same move.
FULL_PART = 0.95

#: Figures of a move: name, label, displayed unit, factor that converts from the SI unit.
MOVE_FIGURES = (
    ("start_s", "given at", "s", 1.0),
    ("setpoint_m", "setpoint", "mm", 1e3),
    ("travel_m", "travel", "mm", 1e3),
    ("time_s", "time", "s", 1.0),
    ("steps", "steps", "", 1.0),
    ("missed", "missed", "", 1.0),
    ("mean_speed_m_s", "mean speed", "µm/s", 1e6),
    ("walking_speed_m_s", "walking", "µm/s", 1e6),
    ("walking_speed_percent", "of gait", "%", 1.0),
    ("final_error_rms_m", "final error", "nm rms", 1e9),
    ("final_error_mean_m", "mean", "nm", 1e9),
    ("final_error_max_m", "largest", "nm", 1e9),
    ("overshoot_m", "overshoot", "µm", 1e6),
    ("slip_m", "slip", "µm", 1e6),
    ("slip_percent", "slip", "%", 1.0),
)
#: Figures of the whole run, in the form of :data:`MOVE_FIGURES`.
RUN_FIGURES = (
    ("steps", "Steps", "", 1.0),
    ("steps_forward", "Steps forward", "", 1.0),
    ("steps_backward", "Steps backward", "", 1.0),
    ("missed", "Missed grips", "", 1.0),
    ("step_error_mean_m", "Step length, commanded − achieved, mean", "nm", 1e9),
    ("step_error_std_m", "Step length, commanded − achieved, 1 σ", "nm", 1e9),
    ("slip_m", "Slip, all steps", "µm", 1e6),
    ("slip_percent", "Slip", "% of extension", 1.0),
    ("clamp_voltage_v", "Minimum of the higher clamp voltage", "V", 1.0),
    ("clamp_threshold_v", "Threshold voltage of a closed clamp", "V", 1.0),
    ("clamp_force_n", "Minimum of the larger clamp force", "N", 1.0),
    ("gait_speed_m_s", "Speed of the gait", "µm/s", 1e6),
    ("stroke_m", "Stroke of the gait", "µm", 1e6),
    ("period_s", "Period of the gait", "ms", 1e3),
)
#: Figures of any axis that also apply to an inchworm motor.
COMMON = (
    *("chattering_m", "chattering_m_s", "command_reversals_hz", "voltage_rate_v_s", "voltage_variation_v"),
    *("samples", "missing_samples", "duration_s", "sample_rate_hz", "rate_hz", "jitter_p99_s"),
    *(name for name, *_ in TIMELINESS),
)
COMMON_FIGURES = tuple(row for row in FIGURES if row[0] in COMMON)


def inchworm_figures(recording: Recording) -> dict:
    """Return the figures of merit of an inchworm motor's run.

    A *move* lasts from a change of setpoint, speed or request to the next change. q is the slider's true displacement;
    it is the measured displacement if the notes of the recording state this.

    ============================== ===================================================================================
    ``start_s``, ``setpoint_m``    time of the request and requested position (None: no position)
    ``outcome``                    ``arrived``, ``not arrived``, ``walking``, ``stopped``, ``released``, ``holding``, or
                                   ``error:`` and its name
    ``travel_m``                   setpoint - q at the beginning; without a setpoint q at the end - q at the beginning
    ``time_s``                     until the sequencer reports arrival that lasts until the next move
    ``steps``, ``missed``          number of steps, whole and partial; missed or repeated grips
    ``mean_speed_m_s``             abs(q at arrival - q at the beginning) / ``time_s``
    ``walking_speed_m_s``          abs(q after the last full step - q after the first one) / time between them; a full
                                   step extends by at least 95 % of the move's median extension
    ``walking_speed_percent``      the same in % of the gait's speed, stroke / period
    ``final_error_rms_m``          √(mean (setpoint - q)²) over the second half of the time from arrival to the end
    ``final_error_mean_m``         mean of setpoint - q over the same time
    ``final_error_max_m``          largest abs(setpoint - q) over the same time
    ``overshoot_m``                largest distance of q beyond the setpoint in the direction of the move, at least 0
    ``slip_m``, ``slip_percent``   Σ (extension - slider movement along the extension) of its steps; in % of Σ extension
    ============================== ===================================================================================

    Figures of the whole run: ``steps_forward``, ``steps_backward``, ``step_error_mean_m`` and ``step_error_std_m``
    (commanded minus achieved length along the step), ``clamp_voltage_v`` (minimum of the higher of the two clamp
    voltages; it is never below ``clamp_threshold_v``), ``clamp_force_n`` (the same with the normal forces), and
    ``gait_speed_m_s``, ``stroke_m``, ``period_s`` of the configuration. The other figures are those of
    :func:`hysteresis_ros.analysis.metrics.compute_metrics`; their ``reference`` is the reference of the extender.
    """
    return figures_of(inchworm_run(recording), recording)


def figures_of(run: InchwormRun, recording: Recording) -> dict:
    """Return the figures of :func:`inchworm_figures` for a prepared run."""
    notes: dict = {"recording": list(run.notes)}
    common = dict.fromkeys(COMMON)
    reference = run.signals.get("reference", run.setpoint)
    smooth = chattering_figures(
        run.time, reference, run.signals.get("command"), run.signals.get("voltage"), notes
    ) | sampling_figures(recording, notes)
    common.update({name: smooth[name] for name in COMMON if name in smooth})
    figures = {"moves": [_move_figures(run, move) for move in run.moves], "run": _run_figures(run), **common}
    return _plain({**figures, "notes": notes})


def format_inchworm(figures: dict) -> str:
    """Return the figures as aligned lines for a terminal: one column per move, then the figures of the run."""
    moves = figures["moves"]
    rows = [("Move", [str(i + 1) for i in range(len(moves))], ""), ("outcome", [m["outcome"] for m in moves], "")]
    for name, label, unit, factor in MOVE_FIGURES:
        rows.append((label, [format_value(move[name], factor) for move in moves], unit))
    lines = aligned(rows) if moves else ["no moves: the recording contains no request"]
    lines.append("")
    of_run = []
    for values, names in ((figures["run"], RUN_FIGURES), (figures, COMMON_FIGURES)):
        for name, label, unit, factor in names:
            value, finer = shown(values[name], unit, factor)
            of_run.append((label, [value], finer))
    lines += aligned(of_run)
    return "\n".join([*lines, *(f"note: {note}" for note in figures["notes"]["recording"])])


def _move_figures(run: InchwormRun, move: Move) -> dict:
    first, end = move.first, move.last - 1
    steps, begin = run.steps.between(first, move.last), float(run.slider[first])
    target = begin if move.goal is None else move.goal
    stop = end if move.arrival is None else move.arrival
    duration = float(run.time[stop] - run.time[first])
    missed = run.signals["missed"]
    figures = {
        "outcome": _outcome(run, move),
        "start_s": float(run.time[first] - run.time[0]),
        "setpoint_m": move.goal,
        "travel_m": (float(run.slider[end]) if move.goal is None else target) - begin,
        "time_s": duration if move.arrival is not None else None,
        "steps": int(steps.index.size),
        "missed": int(missed[end] - missed[max(first - 1, 0)]),
        "mean_speed_m_s": abs(float(run.slider[stop]) - begin) / duration if duration > 0.0 else None,
        **_walking(run, steps),
        **_slip(steps),
        **dict.fromkeys(("final_error_rms_m", "final_error_mean_m", "final_error_max_m", "overshoot_m")),
    }
    if move.goal is not None:
        beyond = np.sign(target - begin) * (run.slider[first : move.last] - target)
        figures["overshoot_m"] = max(0.0, float(np.max(beyond)))
    if move.arrival is not None:
        error = target - run.slider[(move.arrival + move.last) // 2 : move.last]
        figures["final_error_rms_m"] = float(np.sqrt(np.mean(error**2)))
        figures["final_error_mean_m"] = float(np.mean(error))
        figures["final_error_max_m"] = float(np.max(np.abs(error)))
    return figures


def _outcome(run: InchwormRun, move: Move) -> str:
    errors = run.signals.get("error")
    code = 0 if errors is None or not np.isfinite(errors[move.last - 1]) else int(errors[move.last - 1])
    if code:
        return f"error: {at.ERROR_NAMES[code] if 0 < code < len(at.ERROR_NAMES) else code}"
    if move.kind == "move":
        return "not arrived" if move.arrival is None else "arrived"
    return {"walk": "walking", "stop": "stopped", "release": "released", "hold": "holding"}[move.kind]


def _walking(run: InchwormRun, steps: Steps) -> dict:
    found: dict[str, float | None] = {"walking_speed_m_s": None, "walking_speed_percent": None}
    full = steps.index[steps.extension >= FULL_PART * np.median(steps.extension)] if steps.index.size else steps.index
    if full.size > 1:
        moved = abs(float(run.slider[full[-1]] - run.slider[full[0]]))
        speed = moved / float(run.time[full[-1]] - run.time[full[0]])
        found["walking_speed_m_s"] = speed
        if run.gait is not None:
            found["walking_speed_percent"] = 100.0 * speed / run.gait.speed
    return found


def _slip(steps: Steps) -> dict:
    whole = float(np.sum(steps.extension))
    total = float(np.sum(steps.slip))
    return {"slip_m": total, "slip_percent": 100.0 * total / whole if whole > 0.0 else None}


def _run_figures(run: InchwormRun) -> dict:
    steps, signals = run.steps, run.signals
    error = steps.direction * (steps.commanded - steps.achieved)
    figures = dict.fromkeys(name for name, *_ in RUN_FIGURES)
    figures |= {
        "steps": int(steps.index.size),
        "steps_forward": int(np.count_nonzero(steps.direction > 0.0)),
        "steps_backward": int(np.count_nonzero(steps.direction < 0.0)),
        "missed": int(signals["missed"][-1] - signals["missed"][0]),
        "clamp_voltage_v": float(np.min(np.maximum(signals["front_voltage"], signals["rear_voltage"]))),
        **_slip(steps),
    }
    if error.size:
        figures |= {"step_error_mean_m": float(np.mean(error)), "step_error_std_m": float(np.std(error))}
    if "front_force" in signals and "rear_force" in signals:
        forces = np.maximum(signals["front_force"], signals["rear_force"])
        figures["clamp_force_n"] = float(np.min(forces[np.isfinite(forces)], initial=np.inf))
    if run.gait is not None:
        figures |= {
            "gait_speed_m_s": run.gait.speed,
            "stroke_m": run.gait.stroke,
            "period_s": run.gait.period,
            "clamp_threshold_v": run.gait.threshold_voltage,
        }
    return figures


def _plain(value):
    """Return the value; replace numbers that JSON cannot represent by None."""
    if isinstance(value, dict):
        return {name: _plain(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
