# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Wave tables: points that the wave generator plays, as the command ``WAV`` defines them."""

from __future__ import annotations

import math

from hysteresis_ros.hardware.drivers.gcs.emulator.dictionary import Refusal
from hysteresis_ros.hardware.drivers.gcs.protocol import OUT_OF_RANGE, WAVE_LENGTH, WAVE_TYPE, WRONG_COUNT

#: Points of a table, and how many tables there are.
LONGEST, TABLES = 65536, 8
#: Numbers that follow each type: length of the segment, amplitude, offset, length of the curve, start, and those of its
#: shape; of single points the first one, how many, and they themselves.
SHAPES = {"SIN_P": 6, "RAMP": 7, "LIN": 6}


def segment(kind: str, numbers: list[float]) -> list[float]:
    """Return the points of a segment.

    Parameters
    ----------
    kind : str
        ``PNT``, ``SIN_P``, ``RAMP`` or ``LIN``.
    numbers : list of float
        As they follow in the command.

    Raises
    ------
    Refusal
        The type is unknown, or numbers are missing or out of range.
    """
    if kind == "PNT":
        if len(numbers) < 3 or numbers[1] != len(numbers) - 2:
            raise Refusal(WRONG_COUNT)
        return numbers[2:]
    if kind not in SHAPES:
        raise Refusal(WAVE_TYPE)
    if len(numbers) != SHAPES[kind]:
        raise Refusal(WRONG_COUNT)
    length, amplitude, offset, curve, start, *shape = numbers
    if not (1.0 <= length <= LONGEST and 1.0 <= curve <= LONGEST):
        raise Refusal(WAVE_LENGTH)
    if start < 0.0 or start + curve > length or any(not 0.0 <= item <= curve for item in shape):
        raise Refusal(OUT_OF_RANGE)
    form = {"SIN_P": _sine, "RAMP": _ramp, "LIN": _line}[kind]
    begin, count = int(start), int(curve)
    points = [form(point, count, shape) for point in range(count)]
    last = points[-1] if kind == "LIN" else 0.0
    whole = [0.0] * begin + points + [last] * (int(length) - begin - count)
    return [offset + amplitude * point for point in whole]


def _sine(point: int, count: int, shape: list[float]) -> float:
    """Return a point of an inverted cosine whose top is at the centre of the curve."""
    centre = shape[0] or 0.5 * count
    part = point / centre if point < centre else 2.0 - (count - point) / max(count - centre, 1.0)
    return 0.5 - 0.5 * math.cos(math.pi * part)


def _line(point: int, count: int, shape: list[float]) -> float:
    """Return a point of a line whose ends are parabolas of so many points."""
    bend = min(shape[0], 0.5 * count)
    speed = 1.0 / max(count - bend, 1.0)
    if point < bend:
        return 0.5 * speed * point * point / bend
    if point > count - bend:
        return 1.0 - 0.5 * speed * (count - point) ** 2 / bend
    return speed * (point - 0.5 * bend)


def _ramp(point: int, count: int, shape: list[float]) -> float:
    """Return a point of a line up to the centre of the curve and one down again."""
    bend, centre = shape
    centre = centre or 0.5 * count
    if point < centre:
        return _line(point, int(centre), [bend])
    return 1.0 - _line(point - int(centre), max(int(count - centre), 1), [bend])
