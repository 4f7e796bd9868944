# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Frame by frame: where the tip is, how certain that is, or why a frame is refused."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.errors import Problem
from hysteresis_ros.models.calibration import SensorCalibration, SensorCalibrationParameters
from hysteresis_ros.parameters import Parameters, group, parameter
from hysteresis_ros.sensing.edge import Place, find_edge, nowhere
from hysteresis_ros.sensing.pattern import Pattern


@dataclass(frozen=True)
class TrackingParameters(Parameters):
    """How the tip is found in a frame."""

    method: str = parameter(
        "edge",
        choices=("edge", "pattern"),
        read_only=True,
        description="edge: a straight edge across the direction of motion; pattern: whatever the first frame shows",
    )
    along: str = parameter(
        "x", choices=("x", "y"), read_only=True, description="motion along the rows (x) or along the columns (y)"
    )
    region: tuple[float, ...] = parameter(
        (),
        unit="px",
        low=0.0,
        high=65535.0,
        read_only=True,
        description="part of the frame that is looked at: first column, first row, width, height; empty: all of it. "
        "Of a pattern it is the part that is found again, and has to leave room for the motion",
    )
    smallest_contrast: float = parameter(
        20.0, low=0.5, high=255.0, description="edge: grey levels (of 255) between its sides that a frame has to have"
    )
    largest_blur: float = parameter(
        4.0, unit="px", low=0.3, high=50.0, description="edge: largest standard deviation of its blur"
    )
    smallest_coherence: float = parameter(
        0.5, low=0.01, high=1.0, read_only=True, description="pattern: least coherence with the first frame"
    )
    largest_uncertainty: float = parameter(
        0.1, unit="px", low=1.0e-6, high=10.0, description="largest standard deviation of the place"
    )
    frozen_frames: int = parameter(
        5, low=0, high=10**9, description="frames in a row without a single bit that differs: a frozen camera; 0: never"
    )

    def check(self):
        """Yield what is inconsistent."""
        if self.region and (len(self.region) != 4 or not all(number == int(number) for number in self.region)):
            yield Problem("region", self.region, "give four whole numbers: first column, first row, width, height")
        elif self.region and not (self.region[2] > 0.0 and self.region[3] > 0.0):
            yield Problem("region", self.region, "width and height must be above 0")


@dataclass(frozen=True)
class CameraCalibrationParameters(SensorCalibrationParameters):
    """From pixels to displacements."""

    unit: str = parameter("px", choices=("px",), read_only=True, description="unit of what a camera sees")
    homing_samples: int = parameter(
        5, low=1, high=10**6, read_only=True, description="relative: frames whose mean is the place of home"
    )


@dataclass(frozen=True)
class CameraParameters(Parameters):
    """What makes displacements of frames."""

    tracking: TrackingParameters = group(TrackingParameters)
    calibration: CameraCalibrationParameters = group(CameraCalibrationParameters)


def fits(grey: np.ndarray, tracking: TrackingParameters) -> bool:
    """Tell whether the region lies within a frame."""
    x, y, width, height = tracking.region or (0, 0, 0, 0)
    return x + width <= grey.shape[1] and y + height <= grey.shape[0]


def turned(grey: np.ndarray, tracking: TrackingParameters) -> tuple[np.ndarray, tuple[int, int, int, int]]:
    """Return a frame with its motion along the rows, and the region in it."""
    x, y, width, height = map(int, tracking.region or (0, 0, grey.shape[1], grey.shape[0]))
    return (grey.T, (y, x, height, width)) if tracking.along == "y" else (grey, (x, y, width, height))


def looked_at(grey: np.ndarray, tracking: TrackingParameters) -> np.ndarray:
    """Return the part of a frame that is looked at, its motion along the rows."""
    frame, (x, y, width, height) = turned(grey, tracking)
    return frame[y : y + height, x : x + width]


class Tracker:
    """Makes displacements of frames.

    Parameters
    ----------
    parameters : CameraParameters

    Attributes
    ----------
    calibration : SensorCalibration
        Pixels to m; it knows where home is.
    refused : int
        Frames so far that gave no displacement.
    """

    def __init__(self, parameters: CameraParameters):
        self.parameters = parameters.validated()
        self.calibration = SensorCalibration(parameters.calibration, 1.0)
        self.reset()

    def reset(self) -> None:
        """Begin again with the next frame."""
        self.calibration.reset()
        self._shape: tuple[int, int] | None = None
        self._last: np.ndarray | None = None
        self._same = 0
        self._pattern: Pattern | None = None
        self.refused = 0

    def rehearse(self) -> None:
        """Compile what is called, so that no frame waits for it."""
        self.calibration.step(math.nan)

    def retune(self, parameters: CameraParameters) -> None:
        """Take other limits of what is refused."""
        self.parameters = parameters.validated()

    def see(self, grey: np.ndarray) -> tuple[float, Place]:
        """Return the displacement [m], NaN when the frame is refused, and the place it is of.

        Parameters
        ----------
        grey : ndarray, shape (rows, columns)
            Grey levels, of 8 bits or from 0 to 255.
        """
        place = self._place(grey)
        if not place.refusal and place.uncertainty > self.parameters.tracking.largest_uncertainty:
            text = f"uncertain to {place.uncertainty:.3g} px, largest_uncertainty is "
            place = nowhere(f"{text}{self.parameters.tracking.largest_uncertainty:g}", place.contrast, place.blur)
        displacement = self.calibration.step(place.pixels)
        if math.isnan(displacement) and not place.refusal:
            refusal = self.calibration.complaint.replace("the sensor reads", "the tip is at")
            place = place._replace(refusal=refusal or "homing")
        self.refused += math.isnan(displacement)
        return displacement, place

    def _place(self, grey: np.ndarray) -> Place:
        tracking = self.parameters.tracking
        if self._shape is None:
            self._shape = grey.shape
        elif grey.shape != self._shape:
            (rows, columns), (first_rows, first_columns) = grey.shape, self._shape
            return nowhere(f"the frame has {columns} x {rows} px, the first one had {first_columns} x {first_rows}")
        self._same = self._same + 1 if self._last is not None and np.array_equal(grey, self._last) else 0
        self._last = grey
        if 0 < tracking.frozen_frames <= self._same:
            return nowhere(f"frozen: {self._same + 1} frames in a row are equal in every bit")
        if not fits(grey, tracking):
            return nowhere(f"region = {tracking.region} does not lie within {grey.shape[1]} x {grey.shape[0]} px")
        if tracking.method == "pattern":
            return self._seen_again(*turned(grey, tracking))
        place = find_edge(looked_at(grey, tracking), tracking.smallest_contrast, tracking.largest_blur)
        return place._replace(pixels=place.pixels + turned(grey, tracking)[1][0])

    def _seen_again(self, grey: np.ndarray, region: tuple[int, int, int, int]) -> Place:
        if self._pattern is None:
            pattern = Pattern(grey, region, self.parameters.tracking.smallest_coherence)
            if not pattern.has_details:
                return nowhere("the first frame shows nothing that could be found again")
            self._pattern = pattern
        return self._pattern.find(grey)
