# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Learning over periods: the correction of a periodic reference, its parameters, kernel, block and file.

m_(j+1) = m_j + γ_j (Q m_j + G e_j − m_j), with the correction m_j and the error e_j = r − y of period j, the zero-phase
robustness filter Q, and the error filter G = Q L. This is iterative learning control [1]_; as a plug-in of a running
loop it is repetitive control [2]_. γ_j = 1 gives the usual law. A smaller γ_j averages noise over periods and does not
change the limit of m.

Both filters are non-causal, because the whole last period is known. Each sample of m is computed when it is needed,
from the samples around the same instant of the previous period. Therefore the end of a period needs no additional
computation.

The errors of the last period are kept in a ring buffer. NaN or infinity replaces the error of a sample that cannot be
used for learning. If more than
a tenth of the filter's weight falls on such samples, the correction is repeated unchanged. If saturated commands are
the reason, the correction decreases instead, because repeating it would keep the axis at its limits. A late voltage
causes an error that the correction cannot influence, so learning pauses while the axis responds to it. This pause is
shorter than after saturation, because one late sample is a small disturbance. When the reference differs from the
reference of the previous period, the correction is phased out. While an axis approaches the path of its scan, its
reference also differs from the reference in the file of a correction. In this case the correction is phased out too,
but it stays stored until the axis reaches the path, or until another reference repeats.

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

#: Maximum number of taps of a filter.
MOST_TAPS = 256
#: Longest period, and largest lead of a filter [samples].
LONGEST = 100_000
#: Tolerance for a period that is a whole number of samples [samples].
WHOLE = 1e-6


@dataclass(frozen=True)
class LearningParameters(Parameters):
    """Parameters of the learning over periods of the reference."""

    type: str = parameter(
        "none",
        choices=("none", "inversion", "norm_optimal", "repetitive", "coupled"),
        read_only=True,
        description="none, or the method of hysteresis design --learning: inversion (of the closed loop), norm_optimal "
        "(weights on error and correction) or repetitive (phase lead and gain); coupled: corrections of all axes of a "
        "stage, learned together from run to run and constant during a run",
    )
    period: float = parameter(
        0.0, unit="s", low=0.0, read_only=True, description="period of the reference, a whole number of samples"
    )
    error_filter: tuple[float, ...] = parameter(
        (),
        read_only=True,
        description="taps of Q L, from the tap of the latest error to the tap of the oldest error",
    )
    lead: int = parameter(
        0, low=0, high=LONGEST, read_only=True, description="lead of the first tap of error_filter [samples]"
    )
    robustness_filter: tuple[float, ...] = parameter(
        (),
        read_only=True,
        description="taps of the zero-phase filter Q: the middle tap, then the taps on either side",
    )
    gain: float = parameter(
        1.0, low=0.0, high=1.0, description="initial learning gain, the fraction of the update applied per period"
    )
    averaging: float = parameter(
        0.0, low=0.0, high=1e6, description="n: in the j-th period of learning the gain is at most n / j; 0: constant"
    )
    least_gain: float = parameter(0.0, low=0.0, high=1.0, description="lower limit of the gain")
    maximum: float = parameter(
        0.0, unit="m", low=0.0, high=1.0, description="largest magnitude of the correction of the reference"
    )
    shortfall: float = parameter(
        1e-7,
        unit="m",
        low=0.0,
        high=1.0,
        description="difference between command and achieved command above which learning pauses",
    )
    recovery: float = parameter(
        0.0,
        unit="s",
        low=0.0,
        high=1e3,
        description="time for which learning pauses after a saturated command, until the response of the "
        "axis has decayed",
    )
    late_recovery: float = parameter(
        -1.0,
        unit="s",
        low=-1.0,
        high=1e3,
        description="time for which learning pauses after a late voltage, which is a small disturbance; "
        "below 0: the same as recovery",
    )
    active: bool = parameter(
        True,
        description="true: begin with learning; false: begin frozen; the services `learn` and `freeze` change this",
    )
    file: str = parameter("", read_only=True, description="file of an initial correction; '': none", place="files")
    save_file: str = parameter(
        "", read_only=True, description="file that the service `save` writes; '': none", place="files"
    )

    @property
    def in_use(self) -> bool:
        """Whether a correction is configured."""
        return self.type != "none"

    @property
    def late_answer(self) -> float:
        """Time [s] for which learning pauses after a late voltage."""
        return self.late_recovery if self.late_recovery >= 0.0 else self.recovery

    def check(self):
        """Yield a Problem for each inconsistency."""
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
    """Return a period [s] in samples.

    ParameterError about the parameter ``name``: the period is not a whole number of samples, too short, or too long.
    """
    samples = period * sample_rate
    count = round(samples)
    if abs(samples - count) > WHOLE * max(samples, 1.0):
        low, high = (whole / sample_rate for whole in (int(samples), int(samples) + 1))
        remedy = (
            f"is {samples:.6g} samples; must be a whole number of samples: the nearest at {sample_rate:g} Hz are "
            f"{low:.9g} s ({1.0 / low:.9g} Hz) and {high:.9g} s ({1.0 / high:.9g} Hz)"
            if low
            else f"is shorter than a sample at {sample_rate:g} Hz; must be at least 2 samples"
        )
        raise ParameterError([Problem(name, period, remedy)])
    if not 2 <= count <= LONGEST:
        raise ParameterError([Problem(name, period, f"is {count} samples; must be 2 … {LONGEST}")])
    return count


#: Two references that differ by less than this from one period to the next count as equal [m].
SAME = 1e-9


def shortest_period(path: np.ndarray) -> int:
    """Return the smallest period [samples] of a path that is one period of a repeating motion."""
    count = len(path)
    for period in range(2, count):
        if count % period == 0 and np.max(np.abs(path[period:] - path[:-period])) <= 0.5 * SAME:
            return period
    return count


#: First key of the file of a learned correction.
KIND = "learned_correction"
#: Maximum number of values in the file of a learned correction, without its two arrays.
HEAD = 20


@dataclass(frozen=True, eq=False)
class Learned:
    """The correction of one period.

    Parameters
    ----------
    period, sample_time : float
        [s]
    correction, reference : ndarray, shape (N,)
        Correction added to the reference, and the reference itself, from the beginning of the period on [m].
    """

    period: float
    sample_time: float
    correction: np.ndarray
    reference: np.ndarray

    def require(self, period: float, sample_time: float, maximum: float) -> None:
        """Refuse the correction if it does not fit the axis.

        Parameters
        ----------
        period, sample_time : float
            Period and sample time of the axis [s].
        maximum : float
            Largest correction that the axis allows [m].

        Raises
        ------
        ParameterError
            Period or sample time differs, or the correction is larger than allowed.
        """
        wanted = period_samples(period, 1.0 / sample_time)
        if len(self.correction) != wanted or abs(self.sample_time - sample_time) > 1e-6 * sample_time:
            have = f"{len(self.correction)} samples of {self.sample_time:g} s"
            remedy = f"contains {have}, but the axis needs {wanted} samples of {sample_time:g} s: learn again"
            raise ParameterError([Problem("learning.file", f"period {self.period:g} s", remedy)])
        largest = float(np.max(np.abs(self.correction)))
        if largest > maximum:
            remedy = f"must be at most learning.maximum = {maximum:g} m"
            raise ParameterError([Problem("learning.file", f"a correction of {largest:g} m", remedy)])


def write_learned(path, learned: Learned, configuration: str = "") -> None:
    """Write a learned correction, with the name of the axis' configuration; an existing file is replaced atomically."""
    values = {
        KIND: {
            "configuration": configuration,
            "period": learned.period,
            "sample_time": learned.sample_time,
            "correction": learned.correction.tolist(),
            "reference": learned.reference.tolist(),
        }
    }
    text = (
        "# Correction that an axis has learned over periods of its reference; load it with "
        "learning.file of motion_controller.\n"
    )
    text += (
        "# period and sample_time [s]; correction and reference [m], sample by sample from the period's beginning.\n"
    )
    text += yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=120)
    write_text(pathlib.Path(path).expanduser(), text, ConfigurationError)


def read_learned(path) -> Learned:
    """Read a learned correction; ParameterError: the file is missing, or is not a learned correction."""

    def refused(text):
        return ParameterError([Problem("learning.file", str(path), text)])

    try:
        found = read_yaml(read_text(path), most=2 * LONGEST + HEAD)[KIND]
        arrays = [np.array(found[name], dtype=float) for name in ("correction", "reference")]
        period, sample_time = float(found["period"]), float(found["sample_time"])
    except OSError as error:
        raise refused(f"cannot be read: {error.strerror or error}") from None
    except (BoundsError, KeyError, TypeError, ValueError, OverflowError, UnicodeDecodeError):
        raise refused("is not a file of a learned correction, as `save` of motion_controller writes it") from None
    same = arrays[0].ndim == 1 and arrays[0].shape == arrays[1].shape
    if not (same and np.all(np.isfinite(arrays))):
        raise refused("correction and reference must have the same length and contain finite numbers")
    if not (0.0 < period < np.inf and 0.0 < sample_time < np.inf):
        raise refused(f"period {period:g} s and sample_time {sample_time:g} s must be above 0")
    return Learned(period, sample_time, *arrays)


# Parameter array: a head; then the taps of the error filter, beginning with the largest lead; then the taps of the
# robustness filter, beginning with the middle tap.
PERIOD = 0  # N [samples]
LEAD = 1  # lead of the first tap of the error filter [samples]
TAPS = 2  # number of taps of the error filter
HALF = 3  # number of taps of the robustness filter on each side of its middle
GAIN = 4  # initial γ
LEAST_GAIN = 5
AVERAGING = 6  # n: in the j-th period γ is at most n / j; 0: γ is constant
MAXIMUM = 7  # [m]
SHORTFALL = 8  # difference between command and achieved command above which learning pauses [m]
RECOVERY = 11  # number of samples after a saturated command in which learning pauses
LATE_ANSWER = 12  # number of samples after a late voltage in which learning pauses
FADE = 9  # fraction of the correction that fades in or out per sample
MISSING = 10  # fraction of the error filter's weight that may fall on unusable samples
FILTERS = 13

# State array: a head; then three ring buffers for correction, error and reference [m], longer than a period by the
# number of samples that the filters need.
MODE = 0
SAMPLES = 1  # number of samples since the beginning
LEARNED = 2  # number of samples since learning began
WEIGHT = 3  # applied fraction of the correction
CORRECTION = 4  # correction of the last sample [m]
RECOVERING = 5  # number of samples until the response to a saturated command or a late voltage has decayed
LOST = 6  # entry of the recovering samples in the ring of errors: LIMITED or NaN
STORED = 7  # correction from a file: number of samples on its path until it is treated like any other correction;
# more than a period: the axis is not on the path, and the correction stays stored; 0: there is no such correction
FIRST = 8  # reference of the first sample of this period [m]
MOVED = 9  # 1: the reference has left the value FIRST in this period
RINGS = 10

#: Modes: the correction stays as it is, is updated in each period, or fades to zero.
FROZEN, LEARNING, FORGETTING = range(3)
MODES = ("frozen", "learning", "forgetting")

#: Entry of a sample with a saturated command in the ring of errors.
LIMITED = math.inf
#: Decrease of the correction near samples with saturated commands in each period, as a fraction of the correction
#: multiplied by the learning gain.
RELIEF = 0.25


@kernel
def shown(p, x, error, shortfall, skipped):
    """Return the entry of a sample in the ring of errors: its error [m], ``LIMITED``, or NaN if it is unusable.

    Parameters
    ----------
    p, x : ndarray
    error : float
        Reference minus displacement [m]; NaN if the axis does not follow, or if there is no measurement.
    shortfall : float
        Last command minus achieved command [m].
    skipped : float
        1: the voltage of this sample is late, and the axis holds the previous voltage.
    """
    if skipped != 0.0:
        # a late voltage must not shorten the longer pause after a saturated command
        if x[RECOVERING] <= p[LATE_ANSWER]:
            x[RECOVERING] = p[LATE_ANSWER]
            x[LOST] = math.nan
        else:
            x[RECOVERING] -= 1.0
    elif abs(shortfall) > p[SHORTFALL]:
        # while the axis recovers from a late voltage, commands also saturate, but the correction is not the cause
        if x[RECOVERING] == 0.0 or x[LOST] == LIMITED:
            x[LOST] = LIMITED
        x[RECOVERING] = max(x[RECOVERING], p[RECOVERY])
    elif x[RECOVERING] > 0.0:
        x[RECOVERING] -= 1.0
    else:
        return error
    return x[LOST] if error == error else error


@kernel
def updated(p, x, before, length):
    """Return the correction at index ``before`` of its ring [m], updated with the errors around this index."""
    period, lead, taps, half = int(p[PERIOD]), int(p[LEAD]), int(p[TAPS]), int(p[HALF])
    corrections, errors = RINGS, RINGS + length
    repeated = x[corrections + before]
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
    x[LEARNED] += 1.0
    if missing <= p[MISSING]:
        return repeated + gain * (update - repeated)
    if limited > p[MISSING]:
        return repeated - RELIEF * gain * repeated
    return repeated


@kernel
def file_stays(p, x, reference):
    """Return whether a file's correction stays stored: the axis is not yet on its path, and no other reference repeats.

    ``reference`` [m] is the reference of this sample, without correction.
    """
    if x[STORED] == 0.0:
        return False
    repeats = False
    if x[SAMPLES] % p[PERIOD] == 0.0:
        repeats = x[MOVED] != 0.0 and abs(reference - x[FIRST]) <= SAME
        x[FIRST], x[MOVED] = reference, 0.0
    elif abs(reference - x[FIRST]) > SAME:
        x[MOVED] = 1.0
    on_path = x[WEIGHT] == 1.0
    if x[MODE] == FORGETTING or (repeats and not on_path):
        x[STORED] = 0.0
    else:
        # a reference that crosses the path for a single sample has not reached it
        x[STORED] = x[STORED] - 1.0 if on_path else p[PERIOD] + 2.0
    return x[STORED] > p[PERIOD]


@called
def learned_correction(p, x, reference, error):
    """Return the correction of the reference [m] in this sample.

    ``reference`` is the reference without correction [m]; ``error`` is reference minus measured displacement [m], or
    NaN if the sample is unusable for learning.
    """
    period = int(p[PERIOD])
    length = (x.shape[0] - RINGS) // 3
    corrections, errors, references = RINGS, RINGS + length, RINGS + 2 * length
    now = int(x[SAMPLES]) % length
    before = now - period
    if before < 0:
        before += length
    repeated = x[corrections + before]
    value = updated(p, x, before, length) if x[MODE] == LEARNING else repeated
    known = x[references + before]
    if x[MODE] == FORGETTING or abs(reference - known) > SAME:
        x[WEIGHT] = max(x[WEIGHT] - p[FADE], 0.0)
        if x[WEIGHT] == 0.0:
            x[LEARNED] = 0.0  # a new reference begins with the initial gain
    else:
        x[WEIGHT] = min(x[WEIGHT] + p[FADE], 1.0)
    value = min(max(x[WEIGHT] * value, -p[MAXIMUM]), p[MAXIMUM])
    stays = file_stays(p, x, reference)
    x[corrections + now] = repeated if stays else value
    x[errors + now] = math.nan if stays else error
    x[references + now] = known if stays else reference
    x[SAMPLES] += 1.0
    x[CORRECTION] = value
    return value


#: Fraction of the error filter's weight that may fall on unusable samples without a risk to convergence.
UNLEARNED = 0.1


class Learning(Block):
    """Correction of a periodic reference; with type ``none`` it has no arrays and does nothing.

    Parameters
    ----------
    parameters : LearningParameters
    sample_time : float
        [s]
    fade : float
        Time in which a correction is phased in or out [s].

    Raises
    ------
    ParameterError
        The period is not a whole number of samples, a filter has a lead of a period or more, or the file belongs to
        another period or sample time.
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
        """Return the parameter array; empty if no correction is configured."""
        if not parameters.in_use:
            return np.zeros(0)
        period = period_samples(parameters.period, 1.0 / self.sample_time)
        half = len(parameters.robustness_filter) - 1
        for name, ahead in (("lead", parameters.lead), ("robustness_filter", half)):
            if ahead >= period:
                remedy = f"has a lead of {ahead} samples: must be less than the period of {period} samples"
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
        """Return the state before the first sample; it contains the correction of the file."""
        if not len(self.p):
            return np.zeros(0)
        period, back = int(self.p[PERIOD]), int(self.p[TAPS] - 1 - self.p[LEAD])
        length = period + max(back, int(self.p[HALF])) + 1
        # the axis was at rest without error before the beginning; the correction of the file starts with the first
        # sample
        rings = np.zeros((3, length))
        rings[2] = math.nan
        if self._loaded is not None:
            rings[1] = math.nan
            # the sample before the first one is the last entry of the ring
            places = np.arange(-length, 0) % period
            rings[0], rings[2] = self._loaded.correction[places], self._loaded.reference[places]
        state = np.zeros(RINGS)
        state[STORED] = period if self._loaded is not None else 0.0
        state[MODE] = LEARNING if self.parameters.active else FROZEN
        state[WEIGHT] = 1.0
        return np.concatenate([state, rings.ravel()])

    def changed(self, parameters: LearningParameters, fade: float) -> Learning:
        """Return a checked block with other parameters; :meth:`take` can apply these parameters.

        Parameters
        ----------
        parameters : LearningParameters
        fade : float
            Time in which a correction is phased in or out [s].

        Raises
        ------
        ParameterError
            The parameters are wrong, or change the structure.
        """
        for name in ("type", "period", "error_filter", "lead", "robustness_filter", "file"):
            value, present = getattr(parameters, name), getattr(self.parameters, name)
            if value != present:
                raise ParameterError([Problem(f"learning.{name}", value, "is fixed while running")])
        return Learning(replace(parameters, file=""), self.sample_time, fade)

    def take(self, other: Learning) -> None:
        """Continue with the parameters of another block of the same structure."""
        self.parameters = replace(other.parameters, file=self.parameters.file)
        self.p[:] = other.p

    def set_mode(self, mode: int) -> None:
        """Learn, freeze or forget, from the next sample on.

        Parameters
        ----------
        mode : int
            ``LEARNING``, ``FROZEN`` or ``FORGETTING``.

        Raises
        ------
        ParameterError
            No correction is configured.
        """
        self._require_use()
        if mode == LEARNING:
            self.x[LEARNED] = 0.0
        self.x[MODE] = mode

    def _require_use(self) -> None:
        if not self.parameters.in_use:
            remedy = "learning is off; let `hysteresis design --learning` write its filters"
            raise ParameterError([Problem("learning.type", self.parameters.type, remedy)])

    @property
    def mode(self) -> int:
        """``LEARNING``, ``FROZEN`` or ``FORGETTING``; ``FROZEN`` if no correction is configured."""
        return int(self.x[MODE]) if len(self.x) else FROZEN

    @property
    def missed(self) -> int:
        """Number of samples of the last period that could not be used for learning."""
        return int(np.count_nonzero(~np.isfinite(self._last_period(self.x, 1)))) if len(self.x) else 0

    @property
    def at_maximum(self) -> bool:
        """Whether the correction has reached its limit in the last period."""
        return bool(len(self.x)) and bool(np.max(np.abs(self._last_period(self.x, 0))) >= self.p[MAXIMUM])

    def learned(self) -> Learned:
        """Return the correction of the last period.

        Raises
        ------
        ParameterError
            No correction is configured, or no whole period has passed.
        """
        self._require_use()
        # one copy of the whole state, because the loop continues to write samples
        x = self.x.copy()
        reference = self._last_period(x, 2)
        if not np.all(np.isfinite(reference)):
            remedy = f"no whole period of {self.parameters.period:g} s has passed yet; wait for one"
            raise ParameterError([Problem("learning", "nothing learned", remedy)])
        return Learned(self.parameters.period, self.sample_time, self._last_period(x, 0), reference)

    def _last_period(self, x: np.ndarray, ring: int) -> np.ndarray:
        """Return the last period of a ring, beginning with the sample whose number is a multiple of the period."""
        length, period, now = (len(x) - RINGS) // 3, int(self.p[PERIOD]), int(x[SAMPLES])
        numbers = np.arange(now - period, now)
        values = x[RINGS + ring * length + numbers % length]
        return values[np.argsort(numbers % period)]
