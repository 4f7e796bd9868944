# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Node ``displacement_camera``: ``image`` → ``joint_states``; it measures the position of the tip.

Images come from the camera's driver, or from ``plant_simulator`` with ``type: camera``. If no position is found in a
frame, the sample has no measurement, and the axis reacts as to any missing measurement. The reason is in the log and on
``/diagnostics``.
"""

from __future__ import annotations

import math
import time

from sensor_msgs.msg import Image, JointState

from hysteresis_ros.hardware.tracker import FrameError, grey_image, nowhere
from hysteresis_ros.loop.parameters import DisplacementCameraNodeParameters
from hysteresis_ros.loop.plant import CameraPart
from hysteresis_ros.nodes.base import AxisNode
from hysteresis_ros.nodes.responder import TRIPPED_FRAME
from hysteresis_ros.nodes.samples import FRAMES, camera_qos
from hysteresis_ros.nodes.spin import run

#: Names in ``~/state``, which ``docs/topics.md`` lists with their units.
STATE = ("displacement", "pixels", "uncertainty", "contrast", "blur")


class DisplacementCameraNode(AxisNode):
    """Publishes one ``joint_states`` for each image."""

    parameters: DisplacementCameraNodeParameters

    def __init__(self, **options):
        self.part = None
        super().__init__("displacement_camera", **options)

    def build(self, parameters) -> None:
        """Create the tracker from the parameters."""
        self.part = CameraPart(parameters)
        self.part.tracker.rehearse()
        self._clear()

    def _clear(self) -> None:
        self.part.reset()
        self._reason = ""
        self._heard = time.monotonic()
        self._stamp, self._lost = -1, 0

    def state_signals(self) -> dict[str, str]:
        """Return the content of ``~/state``, which contains no signals of the loop."""
        return dict.fromkeys(STATE, "")

    def connect(self) -> None:
        """Create the topics."""
        self._message = JointState(name=[self.parameters.joint], position=[math.nan])
        self._joint_states = self.publisher(JointState, "joint_states", self.qos(), loop=True)
        self.subscribe_end()
        qos = self.qos() if self.runner.exact else camera_qos()
        self.subscriber(Image, FRAMES, self._on_image, qos, partner="plant_simulator")

    def reset_blocks(self) -> None:
        """Restart with the next frame."""
        self._clear()

    def retune(self, parameters) -> None:
        """Apply new limits for the rejection of frames."""
        self.part.retune(parameters)

    def _on_image(self, message) -> None:
        if not self.active or self.failure:
            return
        if self.runner.exact:
            if not self.runner.expected(self.sample_of(message.header.stamp)):
                return
            self.runner.heard()
        else:
            self._count_lost(message.header.stamp)
        self._heard = time.monotonic()
        self.pace.tick()
        if self.running:
            self._see(message)
        else:
            self._answer(message.header, math.nan, nowhere("stopped"))
        self.sample += 1

    def _count_lost(self, stamp) -> None:
        """Count the frames lost since the last received frame; the samples of lost frames have no measurement."""
        nanoseconds = stamp.sec * 1_000_000_000 + stamp.nanosec
        lost = round((nanoseconds - self._stamp) * 1e-9 * self.parameters.sample_rate) - 1
        if self._stamp >= 0 and lost > 0:
            self._lost += lost
            self.warn("lost", f"{lost} frames lost, {self._lost} so far: check the camera, its link and sample_rate")
        self._stamp = nanoseconds

    def _see(self, message) -> None:
        try:
            shape = message.height, message.width
            grey = grey_image(message.data, message.encoding, shape, message.step, bool(message.is_bigendian))
            displacement, place = self.part.tracker.see(grey)
        except FrameError as error:
            displacement, place = math.nan, nowhere(str(error))
        if place.refusal:
            self.warn("refused", f"frame refused: {place.refusal}")
        self._reason = place.refusal
        self._answer(message.header, displacement, place)

    def _answer(self, header, displacement: float, place) -> None:
        told = self._message
        told.header.stamp = header.stamp
        # only TRIPPED_FRAME is passed on; any other frame_id of an image names the camera
        told.header.frame_id = TRIPPED_FRAME if header.frame_id == TRIPPED_FRAME else ""
        told.position[0] = displacement
        self._joint_states.publish(told)
        self.publish_state(header.stamp, displacement, place.pixels, place.uncertainty, place.contrast, place.blur)

    def health(self):
        """Report refused frames and missing images."""
        tracker = self.part.tracker
        values = {"refused_frames": tracker.refused, "lost_frames": self._lost, "homing": tracker.calibration.homing}
        lost = self.since_report("lost", self._lost)
        silent = time.monotonic() - self._heard
        if not self.runner.exact and silent > self.parameters.image_timeout:
            text = f"no image on {self.resolve_topic_name(FRAMES)} for {silent:.1f} s: is the camera driver running?"
            return 2, text, values
        if self._reason:
            return 2, f"frame refused: {self._reason}", values
        return (1, f"{lost} frames lost", values) if lost else (0, "", values)


def main(arguments=None) -> int:
    """Run the node; return the exit code."""
    return run([DisplacementCameraNode], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
