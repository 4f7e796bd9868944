# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Dynamics of a chain from a second recording, small and fast, behind a hysteresis that a slow one gave.

A slow recording with large loops and a fast one with small amplitudes each tell what the other does not. What the
hysteresis puts out under the fast voltage is computed, and the dynamics are what leads from there to the measurement.
"""

from __future__ import annotations

from dataclasses import replace

from hysteresis_ros.errors import IdentificationError
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.identified import PlantModel
from hysteresis_ros.identification.linear_part import LinearPart
from hysteresis_ros.identification.modal_choice import choose_dynamics
from hysteresis_ros.identification.prediction import predict
from hysteresis_ros.identification.segment_spectra import segment_spectra
from hysteresis_ros.models.linear import LinearParameters


def with_fast_dynamics(chain: PlantModel, fast: IdentificationData, skip: int) -> tuple[PlantModel, float]:
    """Return the chain at the rate of the fast recording with its dynamics, and the gain of small movements.

    Lag, delay and modes stand one behind the other: small loops are less steep than large ones, and zeros of the
    dynamics would stand for that.

    Parameters
    ----------
    chain : PlantModel
        Found from a slow recording; its creep is kept.
    fast : IdentificationData
        From rest at 0 V on.
    skip : int
        First samples that do not count.

    Returns
    -------
    PlantModel, float
        The gain is that of the recording over the model's.

    Raises
    ------
    IdentificationError
        The chain has dynamics inside its hysteresis.
    """
    if not chain.invertible:
        raise IdentificationError(
            f"model {chain.hysteresis.type}: has dynamics inside its hysteresis, no others can stand behind it; choose "
            "another model"
        )
    slow = chain.continuous
    creeping = LinearPart(creep_rate=slow.creep_rate, longest_time=slow.longest_time)
    kept = dict(transfer_function=None, sample_time=fast.sample_time)
    bare = replace(chain, dynamics=LinearParameters(), linear_part=creeping, synchronous=True, initial="zero", **kept)
    moved = predict(bare, fast.input, fast.sample_time, "zoh")
    # what is measured at a sample answers voltages before it
    spectra = segment_spectra(moved, fast.output, fast.sample_time, skip, 1)
    found = choose_dynamics(spectra, zeros=False)
    part = replace(found.part, creep_rate=slow.creep_rate, longest_time=slow.longest_time)
    dynamics = part.dynamics(fast.sample_time)
    return replace(chain, dynamics=dynamics, linear_part=part, synchronous=False, **kept), found.gain
