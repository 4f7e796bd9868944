# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The linear response of a stage around its operating point, and the bandwidth and commands that a scan requires.

The bandwidth of the loop of an axis is the frequency up to which its displacement follows its reference with at least
0.71 of the amplitude. The bandwidth that a scan needs is the frequency below which the path of that axis has 99.99 % of
its power. Feedback alone cannot follow motions beyond its bandwidth; learned corrections can, within the range of the
actuators.
"""

from __future__ import annotations

import math

import numpy as np

from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.damping.inner_loop import inner_loop
from hysteresis_ros.control.damping.kind import NOTHING
from hysteresis_ros.control.linearisation import whole_loop
from hysteresis_ros.errors import ConfigurationError, ParameterError, Problem
from hysteresis_ros.loop.parameters import part
from hysteresis_ros.loop.stage_parameters import HAMMERSTEIN, StageParameters
from hysteresis_ros.models.compensator import reachable_commands
from hysteresis_ros.models.linear import StateSpace
from hysteresis_ros.models.linear_algebra import product
from hysteresis_ros.references.scan import OCCUPIED, rounded_down
from hysteresis_ros.references.waveforms.scan import repetition
from hysteresis_ros.units import readable

#: Angle [rad per sample] used instead of 0, where the response of an integrator is infinite.
RESTING = 1e-7
#: Frequencies at which the bandwidth of a loop is searched, as fractions of the sample rate.
GRID = np.geomspace(1e-5, 0.5, 2000)
#: Harmonics of a path below this fraction of the largest one are ignored.
SMALLEST = 1e-7
#: Smallest ratio of the amplitudes of displacement and reference at which the axis counts as following.
FOLLOWED = math.sqrt(0.5)
#: The search for a frame rate within the range of the actuators takes fewer steps than this number.
STEPS = 60
#: Factor of the frame rate per step of this search.
SLOWER = 0.97


def diagonal(systems) -> StateSpace:
    """Combine systems with one input and one output into one uncoupled system."""
    sizes = [system.order for system in systems]
    places = np.cumsum([0, *sizes])
    A, B = np.zeros((places[-1], places[-1])), np.zeros((places[-1], len(systems)))
    C, D = np.zeros((len(systems), places[-1])), np.zeros((len(systems), len(systems)))
    for i, system in enumerate(systems):
        own = slice(places[i], places[i + 1])
        A[own, own], B[own, i], C[i, own], D[i, i] = system.A, system.B[:, 0], system.C[0], system.D[0, 0]
    return StateSpace(A, B, C, D)


def in_series(first: StateSpace, second: StateSpace) -> StateSpace:
    """Return the series connection: ``first``, then ``second``."""
    A = np.block([[first.A, np.zeros((first.order, second.order))], [product(second.B, first.C), second.A]])
    B = np.vstack([first.B, product(second.B, first.D)])
    return StateSpace(A, B, np.hstack([product(second.D, first.C), second.C]), product(second.D, first.D))


def stage_plant(parameters: StageParameters) -> StateSpace:
    """Return the plant with compensated hysteresis, from the commands of the degrees of freedom to their measurements.

    The plant includes the delays of the actuators, and each measurement precedes the commands of its sample. With
    hysteresis inside the structure the result is the linear plant for motions smaller than the radius of every play.
    """
    stage = parameters.stage
    linear = stage.structure.linear if stage.type == HAMMERSTEIN else stage.structure.small
    late = []
    for axis in parameters.axes:
        model = axis.plant_simulator.dynamics.state_space
        row, through = axis.plant_simulator.dynamics.acting
        late.append(StateSpace(model.A, model.B, row[np.newaxis], np.array([[through]])))
    plant = in_series(diagonal(late), linear.held())
    into, out = stage.matrix("decoupling"), stage.matrix("sensor_matrix")
    return StateSpace(plant.A, product(plant.B, into), product(out, plant.C), product(out, product(plant.D, into)))


def controllers_of(parameters: StageParameters) -> list[StateSpace]:
    """Return the controller of each axis with its damping, from reference and measurement to the command."""
    found = []
    for axis in parameters.axes:
        controller = whole_loop(part(axis.motion_controller, ControllerParameters), 1.0 / parameters.sample_rate)[0]
        if controller.B.shape[1] != 2:
            raise ConfigurationError(
                f"{axis.namespace}/motion_controller: a damping law with force feedback is not supported in a stage"
            )
        found.append(controller)
    return found


def stage_loop(parameters: StageParameters) -> StateSpace:
    """Return the loop transfer of a stage, cut at the commands of the degrees of freedom, with negative feedback.

    Controllers and damping laws are linearised around the operating point, as for the margins of a single axis.
    """
    feedbacks = [StateSpace(one.A, one.B[:, 1:], -one.C, -one.D[:, 1:]) for one in controllers_of(parameters)]
    return in_series(stage_plant(parameters), diagonal(feedbacks))


def stage_response(parameters: StageParameters, angles) -> np.ndarray:
    """Return the closed loop from references to displacements at angles [rad per sample], shape (F, n, n)."""
    return _closed(parameters, controllers_of(parameters), angles)


def damped_response(parameters: StageParameters, angles) -> np.ndarray:
    """Return the response from the outputs of the control laws to the displacements, including the damping.

    The response has shape (F, n, n); ``angles`` are in rad per sample. The feedforward inverts this response.
    """
    dampings = []
    for axis in parameters.axes:
        control = part(axis.motion_controller, ControllerParameters)
        law = StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[1.0, 0.0]]))
        if control.damping.source != NOTHING:
            own = control.damping, control.model.dynamics, 1.0 / parameters.sample_rate, control.model.force
            law = inner_loop(*own).behind(law)
        dampings.append(law)
    return _closed(parameters, dampings, angles)


def _closed(parameters: StageParameters, loops, angles) -> np.ndarray:
    """Return the closed loop of the stage with systems from (input, measurement) to command, shape (F, n, n)."""
    z = np.exp(1j * np.maximum(np.abs(angles), RESTING))
    plant, count = stage_plant(parameters).response(z), len(parameters.names)
    both = np.array([one.response(z)[:, 0] for one in loops])
    forward, back = (np.swapaxes(both[:, :, place], 0, 1)[:, np.newaxis] for place in (0, 1))
    return np.linalg.solve(np.eye(count) - plant * back, plant * forward)


def scanned_paths(parameters: StageParameters) -> np.ndarray:
    """Return the motion that the scan adds to the setpoints of the axes during one period, shape (n, N) [m]."""
    scan = parameters.scan
    if scan is None:
        raise ConfigurationError(
            "the stage follows no scan: give scan.kind and scan.values in its section, e.g. kind: raster"
        )
    count = repetition(scan.period, 1.0 / parameters.sample_rate)
    paths = np.zeros((len(parameters.names), count))
    moved = scan.samples(count, 1.0 / parameters.sample_rate)
    paths[[parameters.names.index(name) for name in parameters.scanning_axes]] = moved
    return paths


def scan_warnings(parameters: StageParameters) -> tuple[str, ...]:
    """Return a sentence for each axis without learning that cannot follow its path in the scan.

    The path needs more than the bandwidth of the loop, or the axis follows it late because of the preview of its
    feedforward.
    """
    scan = parameters.scan
    if scan is None:
        return ()
    followed = loop_bandwidths(parameters)
    needed = path_bandwidths(parameters)
    found = []
    for name in parameters.scanning_axes:
        place = parameters.names.index(name)
        control = parameters.axes[place].motion_controller
        fed = control.feedforward
        if not control.learning.in_use and fed.type != "none" and fed.preview:
            found.append(
                f"{name}: its feedforward follows the scan {fed.preview} samples, "
                f"{readable(fed.preview / parameters.sample_rate, 's')}, late, which is an error in the plane; "
                "to follow without delay, learn the scan (hysteresis design --learning) without feedforward"
            )
        if control.learning.in_use or fed.type != "none" or needed[place] <= followed[place]:
            continue
        rate = rounded_down(scan.rate * followed[place] / needed[place])
        found.append(
            f"{name}: the path of the scan needs {needed[place]:.4g} Hz, {needed[place] / followed[place]:.3g} times "
            f"the bandwidth of the loop, {followed[place]:.4g} Hz: frame_rate ≤ {rate:.4g} Hz, a frame in "
            f"{1.0 / rate:.4g} s or more, stays within it; or learn the scan (hysteresis design --learning)"
        )
    return tuple(found)


def loop_bandwidths(parameters: StageParameters) -> np.ndarray:
    """Return the frequency up to which each axis follows its reference, shape (n,) [Hz]."""
    sizes = np.abs(np.diagonal(stage_response(parameters, 2.0 * np.pi * GRID), axis1=1, axis2=2))
    lost = sizes < FOLLOWED
    first = np.where(lost.any(axis=0), np.argmax(lost, axis=0), len(GRID) - 1)
    return GRID[first] * parameters.sample_rate


def path_bandwidths(parameters: StageParameters) -> np.ndarray:
    """Return the frequency below which the path of each axis has 99.99 % of its power, shape (n,) [Hz]; 0: at rest."""
    paths = scanned_paths(parameters)
    power = np.cumsum(np.abs(np.fft.rfft(paths, axis=1)[:, 1:]) ** 2, axis=1)
    found = []
    for row in power:
        order = int(np.searchsorted(row, OCCUPIED * row[-1])) + 1 if row[-1] > 0.0 else 0
        found.append(order * parameters.sample_rate / paths.shape[1])
    return np.array(found)


def check_scan(parameters: StageParameters) -> None:
    """Raise ParameterError if a scan needs commands beyond the range of the actuators, whatever the controller.

    The message states the actuator, the excess, and the highest frame rate at which the commands stay within the range.
    """
    scan = parameters.scan
    if scan is None:
        return
    over = _overreach(parameters, 1.0)
    place = int(np.argmax(over))
    if over[place] <= 1.0:
        return
    slower = next((SLOWER**k for k in range(1, STEPS) if np.max(_overreach(parameters, SLOWER**k)) <= 1.0), None)
    rate = 0.0 if slower is None else rounded_down(slower * scan.rate)
    remedy = f"allowed: ≤ {rate:.4g} Hz, a frame in {1.0 / rate:.4g} s or more" if rate else "make the scan smaller"
    text = (
        f"the actuator of {parameters.names[place]} would need commands that are {over[place]:.4g} times its range, "
        f"measured from the middle of the scan; {remedy}"
    )
    raise ParameterError([Problem("scan: frame_rate", scan.rate, text)])


def _overreach(parameters: StageParameters, speed: float) -> np.ndarray:
    """Return the largest command of each actuator as a fraction of its range in that direction, shape (n,).

    ``speed`` is the speed of the scan as a fraction of the configured speed.
    """
    paths = scanned_paths(parameters)
    count = paths.shape[1]
    lines = np.fft.rfft(paths, axis=1)
    sizes = np.max(np.abs(lines), axis=0)
    places = np.flatnonzero(sizes > SMALLEST * np.max(sizes[1:], initial=0.0))
    places = places[(places > 0) & (2 * places < count)]
    plant = stage_plant(parameters).response(np.exp(2j * np.pi * speed * places / count))
    commands = np.zeros_like(lines)
    commands[:, places] = np.linalg.solve(plant, lines[:, places].T[:, :, np.newaxis])[:, :, 0].T
    moved = np.fft.irfft(commands, count, axis=1)
    rest = stage_plant(parameters).dc_gain.reshape(len(paths), -1)
    centre = [axis.generator.initial_setpoint for axis in parameters.axes] + paths.mean(axis=1)
    middle = np.linalg.solve(rest, centre)
    into = parameters.stage.matrix("decoupling")
    asked, around = into @ moved, into @ middle
    found = []
    for row, centre, axis in zip(asked, around, parameters.axes, strict=True):
        low, high = reachable_commands(axis.hysteresis_compensator, 1.0 / parameters.sample_rate)
        found.append(max(np.max(row) / max(high - centre, 1e-12), -np.min(row) / max(centre - low, 1e-12)))
    return np.array(found)
