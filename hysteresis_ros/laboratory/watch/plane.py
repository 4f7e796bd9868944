# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The plane of two axes of a stage: the path and its reference over the last seconds.

All axes of a stage have the same stamps, so samples are matched by stamp.
"""

from __future__ import annotations

import threading
from collections import deque

import numpy as np

from hysteresis_ros import signals
from hysteresis_ros.nodes.samples import SECOND, Block

#: Length of the shown path [s], and number of its points.
WINDOW, POINTS = 4.0, 1500


class Track:
    """Reference and measured displacement of one axis over the last seconds."""

    def __init__(self, preview: int = 0):
        self._preview = preview
        self._coming = np.full(preview, np.nan)
        self._pieces: deque[tuple[np.ndarray, np.ndarray, np.ndarray]] = deque()

    def add(self, block: Block) -> None:
        """Append samples; begin again where they do not follow the last ones."""
        if not block.stamps.size:
            return
        if self._pieces and block.stamps[0] <= self._pieces[-1][0][-1]:
            self._pieces.clear()
            self._coming = np.full(self._preview, np.nan)
        published = np.concatenate([self._coming, block.table[signals.REFERENCE]])
        reference, self._coming = published[: block.stamps.size], published[block.stamps.size :]
        self._pieces.append((block.stamps, reference, block.table[signals.MEASURED].copy()))
        while self._pieces[0][0][-1] < block.stamps[-1] - WINDOW * SECOND:
            self._pieces.popleft()

    def samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the stamps, shape (N,), and reference and measured displacement, shape (2, N) [m]."""
        if not self._pieces:
            return np.zeros(0, np.int64), np.zeros((2, 0))
        stamps, reference, measured = map(np.concatenate, zip(*self._pieces, strict=True))
        return stamps, np.array([reference, measured])


class Plane:
    """The tracks of two axes of a stage, written by one thread, read by another."""

    def __init__(self):
        self._lock = threading.Lock()
        self._tracks: dict[str, Track] = {}

    @property
    def axes(self) -> tuple[str, ...]:
        """Namespaces of the two axes, x first; none without a stage."""
        return tuple(self._tracks)

    def choose(self, axes: dict[str, int]) -> None:
        """Show the plane of two axes, given as namespace → preview [samples]; no plane without axes."""
        with self._lock:
            self._tracks = {namespace: Track(preview) for namespace, preview in axes.items()}

    def add(self, namespace: str, block: Block) -> None:
        """Append samples of an axis."""
        with self._lock:
            if namespace in self._tracks:
                self._tracks[namespace].add(block)

    def told(self) -> dict | None:
        """Return names, reference and path of the plane [m], and the error of each point [m]; None without a plane.

        A point represents several consecutive samples, and its error is the largest of them.
        """
        with self._lock:
            names = [namespace.rpartition("/")[2] for namespace in self._tracks]
            found = [track.samples() for track in self._tracks.values()]
        if len(found) != 2:
            return None
        (first, one), (second, other) = found
        _, at_one, at_other = np.intersect1d(first, second, assume_unique=True, return_indices=True)
        both = np.stack([one[:, at_one], other[:, at_other]], axis=1)
        both = both[:, :, np.all(np.isfinite(both), axis=(0, 1))]
        reference, measured = both
        size = np.hypot(*(reference - measured))
        starts = np.arange(0, size.size, max(-(-size.size // POINTS), 1))
        error = np.maximum.reduceat(size, starts) if size.size else size
        return {
            "names": names,
            "reference": reference[:, starts].tolist(),
            "path": measured[:, starts].tolist(),
            "error": error.tolist(),
            "rms": float(np.sqrt(np.mean(size**2))) if size.size else None,
            "largest": float(size.max()) if size.size else None,
        }
