# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The sequence of the stages: what is done already is passed over, the rest is asked for, run, judged and kept."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Protocol

from hysteresis_ros.commissioning.bench import Bench, held_back, require_sound
from hysteresis_ros.commissioning.outcome import CommissioningError, Outcome
from hysteresis_ros.commissioning.situation import Situation
from hysteresis_ros.commissioning.stages import STAGES, Computation
from hysteresis_ros.errors import HysteresisError, did_you_mean


class Attendant(Protocol):
    """Who is asked before anything moves, and told what was found."""

    def may_move(self, stage: str, words: str) -> bool:
        """Tell what is about to move and return whether it may.

        Parameters
        ----------
        stage, words : str
        """

    def told(self, stage: str, outcome: Outcome, done_before: bool) -> None:
        """Hear what a stage found.

        Parameters
        ----------
        stage : str
        outcome : Outcome
        done_before : bool
            It was done in an earlier sitting.
        """


class NotAllowedError(CommissioningError):
    """Nobody allowed the next movement."""


def require_stages(stages: Iterable[str]) -> None:
    """Refuse names that no stage has.

    Parameters
    ----------
    stages : iterable of str

    Raises
    ------
    CommissioningError
        There is no such stage; the message says which there are.
    """
    for stage in stages:
        if stage not in STAGES:
            there = f"there are {', '.join(STAGES)}{did_you_mean(stage, STAGES)}"
            raise CommissioningError(f"no stage {stage}; {there}")


def commission(situation: Situation, bench: Bench, attendant: Attendant, stages: Iterable[str] = ()) -> bool:
    """Do the stages in their order, without those that are done.

    Parameters
    ----------
    situation : Situation
        What is found is put into it and kept in its folder.
    bench : Bench
    attendant : Attendant
    stages : iterable of str
        Names of those to be done, anew, and no others; all by default.

    Returns
    -------
    bool
        Whether all stages are done now.

    Raises
    ------
    NotAllowedError
        The attendant said no.
    HysteresisError
        Something looks wrong; outputs are safe, and what was done before is kept.
    """
    asked = set(stages)
    names = list(STAGES)
    for place, name in enumerate(names):
        before = situation.folder.outcome(name)
        if before is not None and name not in asked:
            situation.found[name] = before
            attendant.told(name, before, True)
            continue
        if asked and name not in asked:
            continue
        missing = [other for other in names[:place] if other not in situation.found]
        if missing:
            raise CommissioningError(f"{name} needs what {', '.join(missing)} find; do them first, or all in a row")
        # what was found later rested on what is done anew
        situation.folder.forget(names[place:])
        outcome = _done(situation, bench, attendant, name)
        situation.folder.keep(name, outcome)
        situation.found[name] = outcome
        attendant.told(name, outcome, False)
    return all(situation.folder.outcome(name) is not None for name in names)


def _done(situation: Situation, bench: Bench, attendant: Attendant, name: str) -> Outcome:
    stage = STAGES[name]
    situation.progress(0, name)
    if isinstance(stage, Computation):
        return stage.compute(situation)
    axis = stage.axis(situation)
    if isinstance(axis, Outcome):
        return axis
    samples = axis.plant_simulator.samples
    seconds = samples / situation.rate
    if not attendant.may_move(name, f"{stage.words(situation)}; {seconds:.3g} s"):
        raise NotAllowedError(f"stopped before {name}: nothing was moved; go on with --resume")
    try:
        recording = require_sound(bench.run(axis), samples)
    except HysteresisError as error:
        raise _named(error, f"{name}: {error}") from error
    situation.folder.record(name, recording)
    try:
        outcome = stage.judge(situation, recording)
    except CommissioningError as error:
        raise CommissioningError(f"{name}: {error}") from error
    return replace(outcome, lines=[*outcome.lines, *held_back(recording)], seconds=seconds)


def _named(error: HysteresisError, text: str) -> CommissioningError:
    """Return an error that says in which stage another happened, with the exit code of that one."""
    named = CommissioningError(text)
    named.exit_code = getattr(error, "exit_code", 2)
    return named
