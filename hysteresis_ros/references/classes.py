# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The waveforms for notebooks: ``hr.references.Sine(amplitude=1e-6, frequency=10.0)``, one class per waveform."""

from __future__ import annotations

import numpy as np

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.references.waveforms import WAVEFORMS, Waveform, WaveformParameters
from hysteresis_ros.registry import block_class, class_name


class Reference(Waveform):  # numpydoc ignore=PR02
    """A waveform that counts its samples; base class of the classes in ``hr.references``.

    Parameters
    ----------
    parameters : WaveformParameters
        Parameters of the waveform.
    sample_time : float
        Sample time [s].
    """

    def samples(self, count: int | None = None) -> np.ndarray:
        """Return the next samples; the waveform continues from the samples of the previous call.

        Parameters
        ----------
        count : int, optional
            Number of samples N; by default the whole waveform.

        Returns
        -------
        ndarray, shape (N,)
            Displacement [m].

        Raises
        ------
        HysteresisError
            The waveform has no end and no ``count`` is given, or ``count`` is negative.
        """
        if count is None:
            count = self.duration_samples
            if not count:
                raise HysteresisError("the waveform has no end: give the number of samples, or cycles")
        if count < 0:
            raise HysteresisError(f"count = {count}: must be 0 or more samples")
        return self.simulate(np.zeros(count))


def _made(kind: str) -> type[Reference]:
    shape = WAVEFORMS[kind]
    others = tuple(f"{other}." for other in WAVEFORMS if other != kind)
    frequency = shape.takes_frequency or shape.begins_at_frequency
    taken = {"frequency": frequency, "phase": shape.takes_phase, "polarity": shape.takes_polarity}
    return block_class(
        class_name(kind),
        (Reference,),
        WaveformParameters,
        module="hysteresis_ros.references",
        summary=f"The waveform {kind.replace('_', ' ')}.",
        fixed={"type": kind},
        own=(kind,),
        hidden=lambda name: name.startswith(others) or not taken.get(name, True),
    )


#: The classes, by name.
CLASSES: dict[str, type[Reference]] = {class_name(kind): _made(kind) for kind in WAVEFORMS}
