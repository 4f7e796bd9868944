# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A simulated camera: takes a frame of a simulated tip in each sample, and delivers it some frames later.

A bright body with a straight edge moves along the rows of the frame in front of a dark background. The optics blur the
edge, the light drifts, and the sensor has noise and 8 bits. The camera serves to test trackers, and to close a loop
through frames without a real camera.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.errors import Problem

#: Half width of the rendered blur of an edge [standard deviations].
REACH = 6.0
LARGEST = 255.0


@dataclass(frozen=True)
class SceneParameters(Parameters):
    """Parameters of the image of a tip."""

    width: int = parameter(640, unit="px", low=32, high=8192, read_only=True, description="columns of a frame")
    height: int = parameter(480, unit="px", low=16, high=8192, read_only=True, description="rows of a frame")
    scale: float = parameter(
        5.0e-7,
        unit="m/px",
        low=1.0e-12,
        high=1.0,
        read_only=True,
        description="displacement that moves the edge by one pixel",
    )
    zero: float = parameter(
        320.0, unit="px", low=0.0, high=8192.0, read_only=True, description="column of the edge at displacement 0"
    )
    tilt: float = parameter(
        2.0, unit="°", low=-30.0, high=30.0, read_only=True, description="angle between the edge and the columns"
    )
    bright: float = parameter(190.0, low=0.0, high=LARGEST, description="grey level of the body")
    dark: float = parameter(40.0, low=0.0, high=LARGEST, description="grey level of the background")
    texture: float = parameter(
        0.0,
        low=0.0,
        high=0.5,
        read_only=True,
        description="grain of the body: standard deviation relative to its grey level",
    )
    blur: float = parameter(1.2, unit="px", low=0.3, high=50.0, description="standard deviation of the optics' blur")
    noise: float = parameter(2.0, low=0.0, high=50.0, description="standard deviation of the noise [grey levels]")
    light_drift: float = parameter(
        0.1, low=0.0, high=0.9, description="relative amplitude with which the light drifts, and varies over the frame"
    )
    light_period: float = parameter(
        20.0, unit="s", low=1.0e-3, high=1.0e6, description="period of the drift of the light"
    )
    seed: int = parameter(1, low=0, high=2**31 - 1, read_only=True, description="seed of noise and grain")

    def check(self):
        """Yield a Problem for each inconsistency."""
        if not self.zero <= self.width:
            yield Problem("zero", self.zero, f"must lie within the frame of width = {self.width} px")


class Scene:
    """Renders frames of a tip.

    Parameters
    ----------
    parameters : SceneParameters
    """

    def __init__(self, parameters: SceneParameters):
        self.parameters = given = parameters.validated()
        rows = np.arange(given.height) - 0.5 * (given.height - 1)
        # column of the edge in each row at displacement 0
        self._edge = given.zero + math.tan(math.radians(given.tilt)) * rows
        self._columns = np.arange(given.width, dtype=float)
        self._slope = (self._columns / given.width - 0.5).astype(np.float32)
        self._grain = self._make_grain()

    def _make_grain(self) -> np.ndarray | None:
        """Return the grain of the body, three frames wide and smooth over about two pixels; None without grain."""
        given = self.parameters
        if not given.texture:
            return None
        noise = np.random.default_rng([given.seed, 0]).standard_normal((given.height, 3 * given.width))
        frequencies = np.fft.rfftfreq(noise.shape[1]), np.fft.fftfreq(noise.shape[0])[:, np.newaxis]
        smooth = np.exp(-0.5 * (2.0 * np.pi * 1.5) ** 2 * (frequencies[0] ** 2 + frequencies[1] ** 2))
        spectrum = np.fft.rfft2(noise) * smooth
        grain = np.fft.irfft2(spectrum, noise.shape)
        self._grain_spectrum = spectrum * (given.texture / grain.std())
        return grain

    def _body(self, pixels: float) -> np.ndarray | float:
        """Return the body's grey levels after a motion [px], shape (height, width); a number without grain."""
        given = self.parameters
        if self._grain is None:
            return given.bright
        frequencies = np.fft.rfftfreq(self._grain.shape[1])
        moved = np.fft.irfft2(self._grain_spectrum * np.exp(-2j * np.pi * frequencies * pixels), self._grain.shape)
        return given.bright * (1.0 + moved[:, given.width : 2 * given.width])

    def frame(self, displacement: float, number: int = 0, time: float = 0.0) -> np.ndarray:
        """Return a frame of the tip.

        Parameters
        ----------
        displacement : float
            [m]
        number : int
            Number of the frame; each frame has its own noise.
        time : float
            Time of the frame [s], for the drift of the light.

        Returns
        -------
        ndarray of uint8, shape (height, width)
        """
        given = self.parameters
        pixels = displacement / given.scale
        covered = np.zeros((given.height, given.width), dtype=np.float32)
        edge = self._edge + pixels
        reach = REACH * given.blur + 1.0
        first = int(np.clip(math.floor(edge.min() - reach), 0, given.width))
        last = int(np.clip(math.ceil(edge.max() + reach), 0, given.width))
        covered[:, :first] = 1.0
        covered[:, first:last] = self._covered(edge[:, np.newaxis] - self._columns[first:last])
        light = 1.0 + given.light_drift * math.sin(2.0 * math.pi * time / given.light_period) * (1.0 + self._slope)
        covered *= np.subtract(self._body(pixels), given.dark, dtype=np.float32)
        covered += np.float32(given.dark)
        covered *= light
        if given.noise:
            generator = np.random.default_rng([given.seed, 1, number])
            covered += given.noise * generator.standard_normal(covered.shape, dtype=np.float32)
        np.rint(covered, out=covered)
        return np.clip(covered, 0.0, LARGEST, out=covered).astype(np.uint8)

    def _covered(self, inside: np.ndarray) -> np.ndarray:
        """Return the fraction of a pixel's light that comes from the body, at ``inside`` [px] from the edge."""
        # a pixel collects light over its width, so this is the integral of the blurred edge
        return self._blurred(inside + 0.5) - self._blurred(inside - 0.5)

    def _blurred(self, distance: np.ndarray) -> np.ndarray:
        """Return the integral of a blurred edge up to a distance from the edge [px]."""
        # imported here, because every node imports this module for the parameters, but only rendering needs SciPy
        from scipy.special import erf

        sigma = self.parameters.blur
        normal = distance / sigma
        density = np.exp(-0.5 * normal**2) / math.sqrt(2.0 * math.pi)
        return sigma * (normal * 0.5 * (1.0 + erf(normal / math.sqrt(2.0))) + density)


@dataclass(frozen=True)
class SimulatedCameraParameters(SceneParameters):
    """Image and delay of a simulated camera."""

    delay: int = parameter(
        1, unit="frames", low=0, high=100, read_only=True, description="delay with which a frame arrives"
    )


class SimulatedCamera:
    """Takes frames of a simulated tip.

    Parameters
    ----------
    parameters : SimulatedCameraParameters
    sample_time : float
        Time between two frames [s].
    """

    def __init__(self, parameters: SimulatedCameraParameters, sample_time: float):
        self._scene = Scene(parameters)
        self._sample_time = sample_time
        self.reset()

    def reset(self) -> None:
        """Restart with the first frame."""
        self._number = 0
        self._way: deque[float] = deque(maxlen=self._scene.parameters.delay + 1)

    def take(self, displacement: float) -> np.ndarray:
        """Take a frame of the tip and return the frame that arrives now; the first frames show the first displacement.

        Parameters
        ----------
        displacement : float
            Present displacement of the tip [m].
        """
        self._way.append(displacement)
        number = self._number
        self._number += 1
        return self._scene.frame(self._way[0], number, number * self._sample_time)
