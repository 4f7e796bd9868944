# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Frames: images from messages, and pictures and videos from files."""

from __future__ import annotations

import functools
import json
import shutil
from pathlib import Path
from random import Random

import numpy as np
from judging import Target
from mutations import mutated_bytes, mutated_value

#: Header and content of an image message are two lines.
ENCODINGS = ("mono8", "8UC1", "mono16", "16UC1", "rgb8", "bgra8", "yuv422", "")


def _frame() -> np.ndarray:
    """Return a frame of 48 x 40 px with an edge."""
    return np.where(np.arange(48) < 24, 40, 200).astype(np.uint8) + np.arange(40, dtype=np.uint8)[:, None]


def _images() -> list[bytes]:
    heads = [
        {"encoding": "mono8", "height": 40, "width": 48, "step": 48, "big": False, "region": [], "method": "edge"},
        {"encoding": "mono8", "height": 40, "width": 48, "step": 48, "big": False, "region": [], "method": "pattern"},
        {"encoding": "mono16", "height": 40, "width": 24, "step": 48, "big": True, "region": [], "method": "edge"},
        {"encoding": "rgb8", "height": 40, "width": 16, "step": 48, "big": False, "region": [], "method": "pattern"},
        {
            "encoding": "mono8",
            "height": 40,
            "width": 48,
            "step": 48,
            "region": [1.0, 1.0, 40.0, 36.0],
            "method": "edge",
        },
    ]
    return [json.dumps(head).encode() + b"\n" + _frame().tobytes() for head in heads]


def _mutated_image(random: Random, data: bytes, others: list[bytes], words: tuple[str, ...] = ()) -> bytes:
    head, _, content = data.partition(b"\n")
    if random.random() < 0.7:
        head = mutated_value(random, head, [head], words)
    return head + b"\n" + (mutated_bytes(random, content, others) if random.random() < 0.5 else content)


def _see(data: bytes, folder: Path):
    """An image and its successor, evaluated by the tracker of an axis."""
    from hysteresis_ros.errors import HysteresisError
    from hysteresis_ros.hardware.tracker import CameraParameters, Tracker, grey_image

    text, _, content = data.partition(b"\n")
    head = json.loads(text)
    # values that no message or parameter can have are not passed on
    if not isinstance(head, dict) or not all(type(head.get(name)) is int for name in ("height", "width", "step")):
        raise HysteresisError("no image message")
    if not all(0 <= head[name] < 2**32 for name in ("height", "width", "step")):
        raise HysteresisError("no image message")
    values = {
        "calibration.scale": 1e-6,
        "tracking.region": head.get("region", []),
        "tracking.method": head.get("method"),
    }
    tracker = Tracker(CameraParameters.from_mapping(values))
    grey = grey_image(
        content, str(head.get("encoding")), (head["height"], head["width"]), head["step"], bool(head.get("big"))
    )
    tracker.see(grey)
    return tracker.see(grey[::-1])


@functools.cache
def _pictures() -> list[bytes]:
    import cv2

    return [cv2.imencode(suffix, _frame())[1].tobytes() for suffix in (".png", ".pgm", ".bmp", ".tiff", ".jpg")]


def _follow(data: bytes, folder: Path):
    from hysteresis_ros.hardware.footage import Footage, follow
    from hysteresis_ros.hardware.tracker import CameraParameters, Tracker

    place = folder / "frames"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    for number, content in enumerate((_pictures()[0], data)):
        (place / f"frame_{number}.png").write_bytes(content)
    return follow(Footage(place, 10.0), Tracker(CameraParameters.from_mapping({"calibration.scale": 1e-6})))


TARGETS = (
    Target("images", _see, _images, _mutated_image, ENCODINGS, suite=100),
    Target("pictures", _follow, _pictures, mutated_bytes, suite=60, file="frames"),
)
