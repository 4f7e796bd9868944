# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Reference waveforms: each file in this folder declares waveforms and is found automatically; a parameter selects one.

:mod:`hysteresis_ros.references.declaration` describes the declaration of a waveform. A waveform is a block whose output
depends only on the sample counter; that module computes the position within the cycle from the counter. After the last
of ``cycles`` cycles, a waveform holds its value at the end of the cycle: for a square the last level, for a staircase
the level after the last step, at which the next cycle would begin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter, variants
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.block import Block
from hysteresis_ros.references.declaration import PREFIX, WaveformShape
from hysteresis_ros.registry import discover

#: The waveforms, by name. Other packages add waveforms by an entry point: ``sinc = my_package.sinc:WAVEFORM``.
WAVEFORMS: dict[str, WaveformShape] = discover(__name__, "WAVEFORM", WaveformShape, "hysteresis_ros.waveforms")


def _names(chosen) -> str:
    return ", ".join(name for name, shape in WAVEFORMS.items() if chosen(shape))


@dataclass(frozen=True)
@variants("type", {name: shape.parameters for name, shape in WAVEFORMS.items() if shape.parameters is not None})
class WaveformParameters(Parameters):
    """The waveform that is added to the setpoint."""

    type: str = parameter("hold", description="shape of the waveform", choices=tuple(WAVEFORMS))
    amplitude: float = parameter(0.0, description="height above the offset (peak)", unit="m", low=0.0)
    frequency: float = parameter(1.0, description="cycles per second; chirp: initial frequency", unit="Hz", low=0.0)
    offset: float = parameter(0.0, description="constant that is added to the waveform; hold: the value", unit="m")
    phase: float = parameter(
        0.0,
        description=f"phase at the first sample; not for {_names(lambda shape: not shape.takes_phase)}",
        unit="rad",
    )
    cycles: int = parameter(0, description="cycles after which the final value is held, 0 = endless", low=0)
    polarity: str = parameter(
        "unipolar",
        description=f"{_names(lambda shape: shape.takes_polarity)}: from offset to offset + amplitude, or offset ± "
        "amplitude",
        choices=("unipolar", "symmetric"),
    )

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

    @property
    def shape(self) -> WaveformShape:
        """Declaration of the chosen waveform."""
        return WAVEFORMS[self.type]

    def check(self):
        """Yield a Problem for each parameter that does not fit the chosen waveform."""
        shape = self.shape
        if shape.takes_frequency and not self.frequency > 0.0:
            yield Problem("frequency", self.frequency, f"must be > 0 Hz for {self.type}")
        if not shape.takes_phase and self.phase != 0.0:
            yield Problem("phase", self.phase, f"must be 0 for {self.type}, which always starts at its beginning")
        yield from shape.check(self)


class Waveform(Block):
    """One waveform.

    Parameters
    ----------
    parameters : WaveformParameters
        Parameters of the waveform.
    sample_time : float
        Sample time [s].

    Attributes
    ----------
    lowest, highest : float
        Range of the waveform [m], including the offset; for a waveform given by a formula, the range of the continuous
        shape.
    crest_factor : float or None
        Peak divided by root mean square, without the offset, of a multisine.
    period : int or None
        Number of samples after which the output repeats bit for bit; None if there is no such number up to 2²⁶.
    edges : ndarray
        Scan edges of each sample as bits (:meth:`.ScanClock.edges`); a single 0: no scan.

    Raises
    ------
    ParameterError
        Parameters are wrong, a frequency is too high for the sample rate, the period of a multisine is not a whole
        number of samples, or a file is missing or unusable.
    """

    def __init__(self, parameters: WaveformParameters, sample_time: float):
        super().__init__(parameters.validated(PREFIX), sample_time)

    @property
    def duration_samples(self) -> int:
        """Length of the waveform in samples; 0 if it has no end.

        The last of several steps is assumed to last as long as the previous one.
        """
        return self.parameters.shape.duration(self.p)

    def pack(self, parameters) -> np.ndarray:
        """Return the kernel's parameters; their layout is in :mod:`~hysteresis_ros.references.declaration`."""
        packed = parameters.shape.pack(parameters, self.sample_time)
        self.kernel, self.period, self.crest_factor = packed.kernel, packed.period, packed.crest_factor
        self.lowest, self.highest, self.edges = packed.lowest, packed.highest, packed.edges
        return packed.p

    def retune(self, parameters) -> None:
        """Refuse any change, because the arrays of another waveform may have another size.

        Raises
        ------
        ParameterError
            The parameters differ from the present ones.
        """
        if parameters != self.parameters:
            text = "a waveform in use cannot change; stop the generator first"
            raise ParameterError([Problem(PREFIX + "type", parameters.type, text)])
