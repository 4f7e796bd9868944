"""The recordings from which the papers identify: triangles of a rate independent element."""

from __future__ import annotations

import numpy as np

SAMPLE_TIME = 1e-3  # of the simulated recordings [s]; the models are rate independent


def triangles(peaks, samples: int = 250) -> np.ndarray:
    """Return triangles from 0 to each of ``peaks`` and back, ``samples`` samples a branch (2 Hz: 250 at 1 kHz)."""
    rise = np.arange(1, samples + 1) / samples
    return np.concatenate([[0.0], *(peak * np.concatenate([rise, 1.0 - rise]) for peak in peaks)])
