# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Learning from period to period: the correction of a periodic reference, its parameters, kernel, block and file.

m_(j+1) = m_j + γ_j (Q m_j + G e_j − m_j), with the error e = r − y of a period of N samples, the robustness filter Q,
of zero phase, and the error filter G = Q L (iterative learning control [1]_, and as a plug-in repetitive control [2]_).
γ_j = 1 is the plain law. A smaller one averages noise over periods and leaves the limit of m where it is.

Both filters look ahead: of the last period everything is known. A sample of m is worked at the moment it is needed, out
of the samples around the one a period before; nothing has to be done at the end of a period.

What cannot be learned from is not a finite number in the ring of errors: where more than a tenth of the filter's weight
meets such samples, around them, the correction repeats itself; where the reason is that commands were not carried out,
it gives way, or it would hold the axis at its limits. A voltage that came a sample too late moves the axis off its path
by what the correction has no part in: nothing is learned from it until its answer has died away, which takes less time
than after limits: one sample is a small knock. A reference that is
not the one of a period before takes the correction back.

References
----------
.. [1] Bristow, Tharayil & Alleyne, A survey of iterative learning control, IEEE Control Systems Magazine 26 (3), 2006.
.. [2] Hara, Yamamoto, Omata & Nakano, Repetitive control system, IEEE Transactions on Automatic Control 33 (7), 1988.
"""

from __future__ import annotations

import math
import pathlib
from dataclasses import dataclass, replace

import numpy as np
import yaml

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem
from hysteresis_ros.files import BoundsError, read_text, read_yaml, write_text
from hysteresis_ros.models.block import Block, called, kernel

#: Most taps of a filter, and the longest period [samples].
MOST_TAPS, LONGEST = 256, 100_000
#: A period this close to whole samples, in samples, is one of whole samples.
WHOLE = 1e-6


@dataclass(frozen=True)
class LearningParameters(Parameters):
    """What is learned from one period of the reference to the next, and how."""

    type: str = parameter(
        "none",
        choices=("none", "inversion", "norm_optimal", "repetitive"),
        read_only=True,
        description="none, or how the filters were designed (hysteresis design --learning): as the inverse of the "
        "closed loop, by weights on error and correction, or as a repetitive controller with phase lead",
    )
    period: float = parameter(
        0.0, unit="s", low=0.0, read_only=True, description="period of the reference, a whole number of samples"
    )
    error_filter: tuple[float, ...] = parameter(
        (),
        read_only=True,
        description="taps of Q L, from the one on the furthest error ahead to the one on the oldest",
    )
    lead: int = parameter(
        0, low=0, high=LONGEST, read_only=True, description="samples that the first tap of error_filter looks ahead"
    )
    robustness_filter: tuple[float, ...] = parameter(
        (),
        read_only=True,
        description="taps of Q, of zero phase: the one in the middle, then those on both of its sides",
    )
    gain: float = parameter(
        1.0, low=0.0, high=1.0, description="part of what a period has shown that goes into the correction, at first"
    )
    averaging: float = parameter(
        0.0, low=0.0, high=1e6, description="n: in the j-th period of learning the gain is at most n / j; 0: it stays"
    )
    least_gain: float = parameter(0.0, low=0.0, high=1.0, description="below this the gain does not fall")
    maximum: float = parameter(
        0.0, unit="m", low=0.0, high=1.0, description="largest correction of the reference, either way"
    )
    shortfall: float = parameter(
        1e-7,
        unit="m",
        low=0.0,
        high=1.0,
        description="nothing is learned while what is carried out of the command differs from it by more",
    )
    recovery: float = parameter(
        0.0,
        unit="s",
        low=0.0,
        high=1e3,
        description="nor so long after that, while the axis still answers to it",
    )
    late_recovery: float = parameter(
        -1.0,
        unit="s",
        low=-1.0,
        high=1e3,
        description="nor so long after a voltage that came too late: one sample is a small knock; below 0: as recovery",
    )
    active: bool = parameter(True, description="whether it learns from the beginning; `learn` and `freeze` change it")
    file: str = parameter(
        "", read_only=True, description="file of what was learned, to begin with; '': nothing", place="files"
    )
    save_file: str = parameter(
        "", read_only=True, description="file that the service `save` writes; '': none", place="files"
    )

    @property
    def in_use(self) -> bool:
        """Whether there is a correction."""
        return self.type != "none"

    @property
    def late_answer(self) -> float:
        """Time [s] after a voltage that came too late in which nothing is learned."""
        return self.late_recovery if self.late_recovery >= 0.0 else self.recovery

    def check(self):
        """Yield what does not fit together."""
        if not self.in_use:
            return
        if not self.period:
            yield Problem("period", self.period, "missing; give the period of the reference [s]")
        if not self.maximum:
            yield Problem("maximum", self.maximum, "missing; give the largest correction [m]")
        for name in ("error_filter", "robustness_filter"):
            taps = getattr(self, name)
            if not 1 <= len(taps) <= MOST_TAPS:
                remedy = f"must be 1 … {MOST_TAPS} taps; `hysteresis design --learning {self.type}` finds them"
                yield Problem(name, taps, remedy)


def period_samples(period: float, sample_rate: float, name: str = "learning.period") -> int:
    """Return a period in samples.

    Parameters
    ----------
    period : float
        [s]
    sample_rate : float
        [Hz]
    name : str
        Of the parameter, for the message.

    Raises
    ------
    ParameterError
        It is no whole number of samples, too short, or too long.
    """
    samples = period * sample_rate
    count = round(samples)
    if abs(samples - count) > WHOLE * max(samples, 1.0):
        low, high = (whole / sample_rate for whole in (int(samples), int(samples) + 1))
        remedy = (
            f"is {samples:.6g} samples; must be a whole number of them: the nearest at {sample_rate:g} Hz are "
            f"{low:.9g} s ({1.0 / low:.9g} Hz) and {high:.9g} s ({1.0 / high:.9g} Hz)"
            if low
            else f"is shorter than a sample at {sample_rate:g} Hz"
        )
        raise ParameterError([Problem(name, period, remedy)])
    if not 2 <= count <= LONGEST:
        raise ParameterError([Problem(name, period, f"is {count} samples; must be 2 … {LONGEST}")])
    return count


#: First key of such a file.
KIND = "learned_correction"
#: Most values of such a file beside the two arrays.
HEAD = 20


@dataclass(frozen=True, eq=False)
class Learned:
    """The correction of one period.

    Parameters
    ----------
    period, sample_time : float
        [s]
    correction, reference : ndarray, shape (N,)
        What is added to the reference, and the reference, from the beginning of the period on [m].
    """

    period: float
    sample_time: float
    correction: np.ndarray
    reference: np.ndarray

    def require(self, period: float, sample_time: float, maximum: float) -> None:
        """Refuse it for an axis that it was not learned on.

        Parameters
        ----------
        period, sample_time : float
            Of the axis [s].
        maximum : float
            Largest correction that the axis allows [m].

        Raises
        ------
        ParameterError
            Period or sample time differ, or it is larger than allowed.
        """
        wanted = period_samples(period, 1.0 / sample_time)
        if len(self.correction) != wanted or abs(self.sample_time - sample_time) > 1e-6 * sample_time:
            have = f"{len(self.correction)} samples of {self.sample_time:g} s"
            remedy = (
                f"holds {have}; the axis has {wanted} of {sample_time:g} s: learn anew, or give the axis of the file"
            )
            raise ParameterError([Problem("learning.file", f"period {self.period:g} s", remedy)])
        largest = float(np.max(np.abs(self.correction)))
        if largest > maximum:
            remedy = f"must be at most learning.maximum = {maximum:g} m"
            raise ParameterError([Problem("learning.file", f"a correction of {largest:g} m", remedy)])


def write_learned(path, learned: Learned, configuration: str = "") -> None:
    """Write what was learned; an existing file is replaced as a whole.

    Parameters
    ----------
    path : path-like
    learned : Learned
    configuration : str
        Name of the configuration of the axis.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    values = {
        KIND: {
            "configuration": configuration,
            "period": learned.period,
            "sample_time": learned.sample_time,
            "correction": learned.correction.tolist(),
            "reference": learned.reference.tolist(),
        }
    }
    text = "# What an axis has learned over periods of its reference; learning.file of motion_controller loads it.\n"
    text += (
        "# period and sample_time [s]; correction and reference [m], sample by sample from the period's beginning.\n"
    )
    text += yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=120)
    write_text(pathlib.Path(path).expanduser(), text, ConfigurationError)


def read_learned(path) -> Learned:
    """Return what a file says was learned.

    Parameters
    ----------
    path : path-like

    Raises
    ------
    ParameterError
        There is no such file, or it is no file of a learned correction.
    """

    def refused(text):
        return ParameterError([Problem("learning.file", str(path), text)])

    try:
        found = read_yaml(read_text(path), most=2 * LONGEST + HEAD)[KIND]
        arrays = [np.array(found[name], dtype=float) for name in ("correction", "reference")]
        period, sample_time = float(found["period"]), float(found["sample_time"])
    except OSError as error:
        raise refused(f"cannot be read: {error.strerror or error}") from None
    except (BoundsError, KeyError, TypeError, ValueError, OverflowError, UnicodeDecodeError):
        raise refused("is no file of a learned correction, as `save` of motion_controller writes it") from None
    sizes = {len(array) for array in arrays if array.ndim == 1 and np.all(np.isfinite(array))}
    if len(sizes) != 1 or any(array.ndim != 1 or not np.all(np.isfinite(array)) for array in arrays):
        raise refused("correction and reference must be as many finite numbers")
    if not (0.0 < period < np.inf and 0.0 < sample_time < np.inf):
        raise refused(f"period {period:g} s and sample_time {sample_time:g} s must be above 0")
    return Learned(period, sample_time, *arrays)


# Parameters; then the error filter from its furthest look ahead on, and the robustness filter from its middle on.
PERIOD = 0  # N [samples]
LEAD = 1  # how far the first tap of the error filter looks ahead [samples]
TAPS = 2  # of the error filter
HALF = 3  # taps of the robustness filter beside its middle, on each side
GAIN = 4  # γ at first
LEAST_GAIN = 5
AVERAGING = 6  # n: in the j-th period γ is at most n / j; 0: it stays
MAXIMUM = 7  # [m]
SHORTFALL = 8  # command not carried out above which nothing is learned [m]
RECOVERY = 11  # samples after a command that was not carried out, in which nothing is learned
LATE_ANSWER = 12  # the same after a voltage that came too late
FADE = 9  # part of the correction that comes or goes in a sample
MISSING = 10  # weight of the error filter that may meet samples from which nothing can be learned
FILTERS = 13

# State; then three rings of as many samples as the filters reach back: correction, error, reference [m].
MODE = 0
SAMPLES = 1  # since the beginning
LEARNED = 2  # samples since learning began
WEIGHT = 3  # part of the correction that is in force
CORRECTION = 4  # of the last sample [m]
RECOVERING = 5  # samples until the answer to what was not carried out has died away
LOST = 6  # error of those samples in the ring: LIMITED or NaN
RINGS = 7

#: Modes: the correction repeats itself; it learns; it goes to zero.
FROZEN, LEARNING, FORGETTING = range(3)
MODES = ("frozen", "learning", "forgetting")

#: Error of a sample whose command was not carried out, and part of the correction that gives way around it in a period.
LIMITED, RELIEF = math.inf, 0.25

#: References that differ by less from one period to the next are the same [m].
SAME = 1e-9


@kernel
def shown(p, x, error, shortfall, skipped):
    """Return what a sample shows of the correction: its error [m], ``LIMITED``, or NaN: nothing.

    Parameters
    ----------
    p, x : ndarray
    error : float
        Reference less displacement [m]; NaN: the axis does not follow, or nothing was measured.
    shortfall : float
        What was not carried out of the last command [m].
    skipped : float
        1: the voltage of this sample comes too late, the axis holds the last one.
    """
    if abs(shortfall) > p[SHORTFALL]:
        x[RECOVERING] = p[RECOVERY]
        x[LOST] = LIMITED
    elif skipped != 0.0:
        # one that came while the axis answers for longer to what was not carried out ends nothing of that
        if x[RECOVERING] <= p[LATE_ANSWER]:
            x[RECOVERING] = p[LATE_ANSWER]
            x[LOST] = math.nan
        else:
            x[RECOVERING] -= 1.0
    elif x[RECOVERING] > 0.0:
        x[RECOVERING] -= 1.0
    else:
        return error
    return x[LOST] if error == error else error


@called
def learned_correction(p, x, reference, error):
    """Return what to add to the reference [m] in this sample.

    Parameters
    ----------
    p, x : ndarray
    reference : float
        The one that is followed in this sample, without correction [m].
    error : float
        What the displacement measured in this sample lacks of it [m]; NaN: nothing is to be learned from it.
    """
    period, lead, taps, half = int(p[PERIOD]), int(p[LEAD]), int(p[TAPS]), int(p[HALF])
    length = (x.shape[0] - RINGS) // 3
    corrections, errors, references = RINGS, RINGS + length, RINGS + 2 * length
    now = int(x[SAMPLES]) % length
    before = now - period
    if before < 0:
        before += length
    repeated = x[corrections + before]
    value = repeated
    if x[MODE] == LEARNING:
        place = before + lead
        if place >= length:
            place -= length
        update = missing = limited = 0.0
        for i in range(taps):
            error_then = x[errors + place]
            if error_then - error_then == 0.0:
                update += p[FILTERS + i] * error_then
            else:
                missing += abs(p[FILTERS + i])
                if error_then == LIMITED:
                    limited += abs(p[FILTERS + i])
            place -= 1
            if place < 0:
                place += length
        weights = FILTERS + taps
        update += p[weights] * repeated
        ahead = behind = before
        for i in range(1, half + 1):
            ahead += 1
            if ahead == length:
                ahead = 0
            behind -= 1
            if behind < 0:
                behind += length
            update += p[weights + i] * (x[corrections + ahead] + x[corrections + behind])
        gain = p[GAIN]
        if p[AVERAGING] > 0.0:
            gain = min(gain, max(p[AVERAGING] / (1.0 + x[LEARNED] // period), p[LEAST_GAIN]))
        if missing <= p[MISSING]:
            value = repeated + gain * (update - repeated)
        elif limited > p[MISSING]:
            value = repeated - RELIEF * gain * repeated
        x[LEARNED] += 1.0
    known = x[references + before]
    # before there was a period nothing can differ from it
    if x[MODE] == FORGETTING or abs(reference - known) > SAME:
        x[WEIGHT] = max(x[WEIGHT] - p[FADE], 0.0)
        if x[WEIGHT] == 0.0:
            x[LEARNED] = 0.0  # another reference begins with the whole gain
    else:
        x[WEIGHT] = min(x[WEIGHT] + p[FADE], 1.0)
    value = min(max(x[WEIGHT] * value, -p[MAXIMUM]), p[MAXIMUM])
    x[corrections + now] = value
    x[errors + now] = error
    x[references + now] = reference
    x[SAMPLES] += 1.0
    x[CORRECTION] = value
    return value


#: Part of the error filter's weight that may meet samples from which nothing can be learned: the margin of contraction.
UNLEARNED = 0.1


class Learning(Block):
    """Correction of a periodic reference; without a type it has no arrays and is not worked.

    Parameters
    ----------
    parameters : LearningParameters
    sample_time : float
        [s]
    fade : float
        Time in which a correction comes or goes [s].

    Raises
    ------
    ParameterError
        The period is no whole number of samples, a filter looks ahead by a period, or the file does not fit.
    """

    kernel = staticmethod(learned_correction)

    def __init__(self, parameters: LearningParameters, sample_time: float, fade: float = 0.0):
        self._fade = fade
        self._loaded: Learned | None = None
        if parameters.in_use and parameters.file:
            self._loaded = read_learned(parameters.file)
            self._loaded.require(parameters.period, sample_time, parameters.maximum)
        super().__init__(parameters, sample_time)

    def pack(self, parameters: LearningParameters) -> np.ndarray:
        """Return the parameter array; empty where nothing is learned."""
        if not parameters.in_use:
            return np.zeros(0)
        period = period_samples(parameters.period, 1.0 / self.sample_time)
        half = len(parameters.robustness_filter) - 1
        for name, ahead in (("lead", parameters.lead), ("robustness_filter", half)):
            if ahead >= period:
                remedy = f"looks {ahead} samples ahead; must be less than the period of {period} samples"
                raise ParameterError([Problem(f"learning.{name}", getattr(parameters, name), remedy)])
        head = np.zeros(FILTERS)
        head[PERIOD], head[LEAD] = period, parameters.lead
        head[TAPS], head[HALF] = len(parameters.error_filter), half
        head[GAIN], head[LEAST_GAIN] = parameters.gain, parameters.least_gain
        head[AVERAGING], head[MAXIMUM] = parameters.averaging, parameters.maximum
        head[SHORTFALL] = parameters.shortfall
        head[RECOVERY] = round(parameters.recovery / self.sample_time)
        head[LATE_ANSWER] = round(parameters.late_answer / self.sample_time)
        head[MISSING] = UNLEARNED * sum(map(abs, parameters.error_filter))
        head[FADE] = 1.0 / max(round(self._fade / self.sample_time), 1)
        return np.concatenate([head, parameters.error_filter, parameters.robustness_filter])

    def initial_state(self) -> np.ndarray:
        """Return the state before the first sample: what the file says, or nothing."""
        if not len(self.p):
            return np.zeros(0)
        period, back = int(self.p[PERIOD]), int(self.p[TAPS] - 1 - self.p[LEAD])
        length = period + max(back, int(self.p[HALF])) + 1
        # before it begins the axis was at rest, without error; what was learned waits for the first period's
        rings = np.zeros((3, length))
        rings[2] = math.nan
        if self._loaded is not None:
            rings[1] = math.nan
            # the sample before the first one stands in the last place of a ring
            places = np.arange(-length, 0) % period
            rings[0], rings[2] = self._loaded.correction[places], self._loaded.reference[places]
        state = np.zeros(RINGS)
        state[MODE] = LEARNING if self.parameters.active else FROZEN
        state[WEIGHT] = 1.0
        return np.concatenate([state, rings.ravel()])

    def changed(self, parameters: LearningParameters, fade: float) -> Learning:
        """Return a block of other parameters, to be taken over by :meth:`take` once nothing can be refused any more.

        Parameters
        ----------
        parameters : LearningParameters
        fade : float
            Time in which a correction comes or goes [s].

        Raises
        ------
        ParameterError
            They are wrong, or of another structure.
        """
        for name in ("type", "period", "error_filter", "lead", "robustness_filter", "file"):
            value, present = getattr(parameters, name), getattr(self.parameters, name)
            if value != present:
                raise ParameterError([Problem(f"learning.{name}", value, "is fixed while running")])
        return Learning(replace(parameters, file=""), self.sample_time, fade)

    def take(self, other: Learning) -> None:
        """Go on with the parameters of another block of the same structure.

        Parameters
        ----------
        other : Learning
        """
        self.parameters = replace(other.parameters, file=self.parameters.file)
        self.p[:] = other.p

    def set_mode(self, mode: int) -> None:
        """Learn, repeat, or forget from the next sample on.

        Parameters
        ----------
        mode : int
            ``LEARNING``, ``FROZEN`` or ``FORGETTING``.

        Raises
        ------
        ParameterError
            There is no correction.
        """
        self._require_use()
        if mode == LEARNING:
            self.x[LEARNED] = 0.0
        self.x[MODE] = mode

    def _require_use(self) -> None:
        if not self.parameters.in_use:
            remedy = "nothing learns; let `hysteresis design --learning` write its filters"
            raise ParameterError([Problem("learning.type", self.parameters.type, remedy)])

    @property
    def mode(self) -> int:
        """``LEARNING``, ``FROZEN`` or ``FORGETTING``; frozen where there is no correction."""
        return int(self.x[MODE]) if len(self.x) else FROZEN

    @property
    def missed(self) -> int:
        """Samples of the last period from which nothing could be learned."""
        return int(np.count_nonzero(~np.isfinite(self._last_period(self.x, 1)))) if len(self.x) else 0

    @property
    def at_maximum(self) -> bool:
        """Whether the correction has reached its limit somewhere in the last period."""
        return bool(len(self.x)) and bool(np.max(np.abs(self._last_period(self.x, 0))) >= self.p[MAXIMUM])

    def learned(self) -> Learned:
        """Return the correction of the last period.

        Raises
        ------
        ParameterError
            There is none, or no whole period was seen yet.
        """
        self._require_use()
        # in one go: a loop that runs beside writes one sample at a time
        x = self.x.copy()
        reference = self._last_period(x, 2)
        if not np.all(np.isfinite(reference)):
            remedy = f"no whole period of {self.parameters.period:g} s has been followed yet; wait for one"
            raise ParameterError([Problem("learning", "nothing learned", remedy)])
        return Learned(self.parameters.period, self.sample_time, self._last_period(x, 0), reference)

    def _last_period(self, x: np.ndarray, ring: int) -> np.ndarray:
        """Return the last period of a ring, from the sample whose number is a multiple of the period on."""
        length, period, now = (len(x) - RINGS) // 3, int(self.p[PERIOD]), int(x[SAMPLES])
        numbers = np.arange(now - period, now)
        values = x[RINGS + ring * length + numbers % length]
        return values[np.argsort(numbers % period)]
