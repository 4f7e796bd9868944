# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""ROS 2 nodes: the only core folder that imports rclpy and messages.

Read base (what every node has), then responder (nodes that answer samples), then one of the nodes: plant_simulator,
hysteresis_compensator, motion_controller, reference_generator, inchworm_sequencer, recorder, displacement_camera.
lockstep, realtime and fused are the time modes; axis composes the nodes in one process. launcher and domain start
graphs without ROS in their own process; remote and security serve commands. masters detects competing publishers;
trajectories, ready, quiet and triggers contain what their names say.
"""
