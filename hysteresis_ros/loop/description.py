# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The URDF of an axis, with its joint."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from hysteresis_ros.loop.parameters import SourceParameters

#: Name of the link that does not move.
BASE = "base"


def robot_description(parameters: SourceParameters, name: str = "hysteresis_axis") -> str:
    """Return a URDF of an axis: a base, and a link that moves along z on a prismatic joint.

    The position limits are the limits of the reference source. The velocity limit is the source's largest velocity; if
    the source does not limit steps, it is the whole range in one sample. The effort limit is 0, which means unknown.
    """
    moved = f"{parameters.joint}_tip"
    robot = ET.Element("robot", name=name)
    ET.SubElement(robot, "link", name=BASE)
    ET.SubElement(robot, "link", name=moved)
    joint = ET.SubElement(robot, "joint", name=parameters.joint, type="prismatic")
    ET.SubElement(joint, "parent", link=BASE)
    ET.SubElement(joint, "child", link=moved)
    ET.SubElement(joint, "origin", xyz="0 0 0", rpy="0 0 0")
    ET.SubElement(joint, "axis", xyz="0 0 1")
    limits = {"lower": parameters.minimum, "upper": parameters.maximum, "velocity": parameters.fastest, "effort": 0.0}
    ET.SubElement(joint, "limit", {key: repr(value) for key, value in limits.items()})
    ET.indent(robot)
    return f'<?xml version="1.0"?>\n{ET.tostring(robot, encoding="unicode")}\n'
