"""References: waveforms, the jerk-limited approach to setpoints, and the generator that adds them."""

from __future__ import annotations

from hysteresis_ros.references.approach import Approach, ApproachParameters
from hysteresis_ros.references.generator import ReferenceGenerator, ReferenceParameters, reference_step
from hysteresis_ros.references.waveforms import Waveform, WaveformParameters

__all__ = [
    "Approach",
    "ApproachParameters",
    "ReferenceGenerator",
    "ReferenceParameters",
    "Waveform",
    "WaveformParameters",
    "reference_step",
]
