# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a run of an inchworm motor is worth: its moves by the worst of them, its steps, and whether a clamp held."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hysteresis_ros.analysis.inchworm import COMMON_FIGURES, MOVE_FIGURES, RUN_FIGURES, figures_of
from hysteresis_ros.analysis.inchworm_moves import inchworm_run
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.references.inchworm_parameters import InchwormSequencerParameters

#: Moves to a place that did not come to it.
NOT_ARRIVED = "not_arrived"
#: Figures of moves, which one of all moves counts, and how that one is called.
_WORST: dict[str, tuple[Callable, str]] = {
    "final_error_rms_m": (max, "Final error, worst move"),
    "final_error_max_m": (max, "Final error, largest, worst move"),
    "time_s": (max, "Time, longest move"),
    "overshoot_m": (max, "Overshoot, worst move"),
    "walking_speed_m_s": (min, "Speed of walking, slowest move"),
}
#: Of these a motor that does not arrive has none.
_OF_ARRIVALS = ("final_error_rms_m", "final_error_max_m", "time_s")
#: What is the configuration's own, and what is of clocks, says nothing of a run.
_OF_GAITS = ("gait_speed_m_s", "stroke_m", "period_s", "clamp_threshold_v")
_OF_RUNS = tuple(row for row in RUN_FIGURES if row[0] not in _OF_GAITS)
_COMMON = tuple(row for row in COMMON_FIGURES if row[0].startswith(("chattering", "command", "voltage")))

#: What may be asked of a run of a motor: name → label, unit for people, factor from SI; the first one by default.
MOTOR_METRICS: dict[str, tuple[str, str, float]] = {
    **{
        name: (label, unit, factor)
        for name, (_, label) in _WORST.items()
        for row, _, unit, factor in MOVE_FIGURES
        if row == name
    },
    NOT_ARRIVED: ("Moves that did not arrive", "", 1.0),
    **{name: (label, unit, factor) for name, label, unit, factor in (*_OF_RUNS, *_COMMON)},
}


def judged_motor(
    signals: dict[str, np.ndarray], settings: InchwormSequencerParameters, names: Sequence[str]
) -> list[float]:
    """Return metrics of a run of an inchworm motor; NaN where one has no meaning.

    All are those of :func:`~hysteresis_ros.analysis.inchworm.inchworm_figures`; of the moves to a place the worst one
    counts, and a run in which one did not arrive has neither time nor final error.

    Parameters
    ----------
    signals : dict of str to array
        What the axis has done.
    settings : InchwormSequencerParameters
        Of its sequencer.
    names : sequence of str
        Of :data:`MOTOR_METRICS`.
    """
    recording = Recording(signals["time"], {name: signals[name] for name in signals if name != "time"}, {}, {})
    found = figures_of(inchworm_run(recording, settings), recording)
    moves = [move for move in found["moves"] if move["setpoint_m"] is not None]
    missed = sum(move["outcome"] != "arrived" for move in moves)
    figures = {**found, **found["run"], NOT_ARRIVED: missed}
    for name, (worst, _) in _WORST.items():
        known = [move[name] for move in moves if move[name] is not None]
        figures[name] = None if not known or missed and name in _OF_ARRIVALS else worst(known)
    values = (figures[name] for name in names)
    return [float("nan") if value is None else float(value) for value in values]
