# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Scan: one coordinate of a scan of a plane, relative to the setpoint (:mod:`hysteresis_ros.references.scan`)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.references.declaration import END, FINAL, Packed, WaveformShape, head, refuse
from hysteresis_ros.references.scan_clock import (
    LEVELS,
    MOST_PERIODS,
    WHOLE,
    ScanClock,
    end_of,
    samples_of_period,
)
from hysteresis_ros.references.waveforms.file import LARGEST_TABLE, file

#: Coordinates of a scan, in the order of its axes.
COORDINATES = ("x", "y", "z")


@dataclass(frozen=True)
class ScanWaveformParameters(Parameters):
    """One coordinate of a scan."""

    kind: str = parameter(description="kind of the scan: raster, spiral, lissajous, cycloid, rosette, file")
    values: tuple[str, ...] = parameter(
        (),
        read_only=True,
        description="parameters of the scan as `hysteresis scan` takes them, e.g. [width=30um, depth=30um]",
        place="start",
    )
    coordinate: str = parameter("x", choices=COORDINATES, description="coordinate that the axis follows")
    clock: str = parameter(
        "line", choices=LEVELS, description="finest level of the clock on scan_clock and at the outputs of a device"
    )


def repetition(period: float, sample_time: float, name: str = "scan.values") -> int:
    """Return the number of samples after which the sampled path repeats.

    Parameters
    ----------
    period, sample_time : float
        [s]
    name : str, optional
        Name of the parameter, for the message.

    Raises
    ------
    ParameterError
        There is no such number, or it is too large.
    """
    samples = period / sample_time
    found = samples_of_period(period, sample_time)
    count = found.numerator
    if abs(samples - found) * found.denominator > WHOLE * max(samples, 1.0) or not 2 <= count <= LARGEST_TABLE:
        nearest = [whole * sample_time for whole in (math.floor(samples), math.ceil(samples)) if whole > 1]
        allowed = (
            f"the path repeats after {samples:.9g} samples: must be a whole number, 2 … {LARGEST_TABLE}, within "
            f"{MOST_PERIODS} periods; the nearest whole periods last {' and '.join(f'{one:.9g} s' for one in nearest)}"
        )
        refuse(name, period, allowed)
    return count


def clock_of(parameters, sample_time: float) -> ScanClock:
    """Return the clock of a scan from the parameters of a waveform of type ``scan`` and the sample time [s]."""
    from hysteresis_ros.references.scans import parsed_scan

    own = parameters.scan
    return ScanClock(parsed_scan(own.kind, own.values), sample_time, own.clock, parameters.cycles)


def pack(parameters, sample_time: float) -> Packed:
    """Return the coordinate at the samples of a repetition.

    Raises
    ------
    ParameterError
        There is no such scan, one of its parameters is wrong, or the scan has no such coordinate or does not repeat.
    """
    # imported here, because the scan from a file imports the waveform ``file``
    from hysteresis_ros.references.scans import parsed_scan

    own, p = parameters.scan, head(parameters)
    scan = parsed_scan(own.kind, own.values)
    place = COORDINATES.index(own.coordinate)
    if place >= scan.axes:
        refuse("scan.coordinate", own.coordinate, "the scan has no third axis; set axes=3 among its values")
    count = repetition(scan.period, sample_time)
    table = scan.samples(count, sample_time)[place]
    if parameters.cycles:
        p[END] = end_of(parameters.cycles, scan.period, sample_time)
        p[FINAL] = parameters.offset + table[int(p[END]) % count]
    return Packed(
        np.concatenate([p, [count, count], table]),
        file,
        parameters.offset + float(np.min(table)),
        parameters.offset + float(np.max(table)),
        None if parameters.cycles else count,
        edges=clock_of(parameters, sample_time).edges(),
    )


WAVEFORM = WaveformShape(
    name="scan",
    pack=pack,
    parameters=ScanWaveformParameters,
    takes_frequency=False,
    takes_phase=False,
    extent="scan.values",
    example=ScanWaveformParameters("spiral", ("diameter=10um", "turns=8", "frame_rate=1Hz")),
)
