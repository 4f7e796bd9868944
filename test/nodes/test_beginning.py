# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A reference generator that joins an axis in real time: as configured, or where others have moved the axis."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, compose, until  # noqa: E402

from hysteresis_ros.loop import watch  # noqa: E402
from hysteresis_ros.loop.source import GeneratorSource  # noqa: E402
from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode, place_of  # noqa: E402

PLACE = 7.0e-6
TRIANGLE = {
    # however busy the machine is
    "plant_simulator": {"late_limit": -1, "overtravel": -1.0, "voltage_timeout": 3600.0},
    "hysteresis_compensator": {"command_timeout": 3600.0},
    "motion_controller": {"type": "open_loop", "measurement_timeout": 3600.0},
    "reference_generator": {
        "initial_setpoint": 2.0e-6,
        "waveform__type": "triangle",
        "waveform__amplitude": 1.0e-6,
        "waveform__offset": 1.0e-6,
        "waveform__frequency": 5.0,
    },
}


def test_a_generator_that_comes_back_begins_where_the_axis_is_and_moves_when_it_is_asked(inside, observer):
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    *_, controller, generator = compose(inside, axis_parameters(overrides=TRIANGLE, sample_rate=100.0))
    heard = observer.listen(JointState, "/reference_generator/state")
    led = observer.listen(JointState, "/motion_controller/state")
    talk = observer.talk(Float64, "/setpoint")
    inside.spin()
    # a fresh axis begins as configured: initial setpoint, with its waveform on top
    until(lambda: {round(m.position[1], 9) for m in heard} > {3e-6}, what="the waveform")
    assert min(m.position[1] for m in heard) > 1.9e-6
    until(talk.get_subscription_count)
    talk.publish(Float64(data=PLACE))
    until(lambda: heard[-1].position[0] == PLACE and heard[-1].position[1] > 6e-6, what="the setpoint")
    for action in ("deactivate", "cleanup"):
        assert observer.transition("/reference_generator", action)
    before = controller.sample
    until(lambda: controller.sample > before + 20, what="the axis without its generator")
    last = led[-1].position[0]
    heard.clear()
    for action in ("configure", "activate"):
        assert observer.transition("/reference_generator", action)
    until(lambda: len(heard) > 50, what="the generator again")
    assert {m.position[1] for m in heard} == {last} == {m.position[0] for m in heard}
    # a setpoint moves it, without the waveform
    asked = Float64(data=4.0e-6)
    until(lambda: (talk.publish(asked), heard[-1].position[1] == 4.0e-6)[1], what="the setpoint")
    since = len(heard)
    until(lambda: len(heard) > since + 50)
    assert {m.position[1] for m in heard[since:]} == {4.0e-6}
    # and ~/start runs the waveform
    assert observer.trigger("/reference_generator/start").success
    until(lambda: heard[-1].position[1] > 5e-6, what="the waveform")
    assert not generator.unasked


@pytest.mark.parametrize("mode", range(6))
def test_the_place_is_the_reference_under_a_controller_at_work_and_its_command_under_one_that_is_stopped(mode):
    state = {"reference": 5e-6, "command": 1e-6, "mode": float(mode)}
    stopped = mode in (watch.STALE, watch.STOPPED, watch.TRIPPED)
    assert place_of(state) == (1e-6 if stopped else 5e-6)
    assert math.isnan(place_of({**state, "reference": math.nan}))


@pytest.mark.slow
def test_a_generator_warns_of_steps_that_it_cannot_follow_within_its_limits():
    limits = {"approach__steps": True, "approach__maximum_velocity": 1e-3, "waveform__amplitude": 4e-6}
    said = []
    node = SimpleNamespace(warn=lambda _, text: said.append(text))
    for frequency in (5.0, 150.0):
        given = {"waveform__type": "square", "waveform__frequency": frequency, **limits}
        node.part = GeneratorSource(axis_parameters(overrides={"reference_generator": given}).generator)
        ReferenceGeneratorNode._connect_part(node)
    (text,) = said
    assert "waveform.frequency = 150.0" in text and "the axis does not reach the level" in text


def test_a_fused_generator_warns_of_a_changed_waveform_that_exceeds_the_slew_rate():
    said = []
    given = axis_parameters(overrides={"plant_simulator": {"limits__slew_rate": 2000.0}})
    node = SimpleNamespace(
        warn=lambda _, text: said.append(text), fused=SimpleNamespace(present_parameters=lambda: given)
    )
    for frequency in (5.0, 150.0):
        waveform = {"type": "triangle", "frequency": frequency, "amplitude": 4e-6}
        asked = {f"waveform__{name}": value for name, value in waveform.items()}
        changed = axis_parameters(overrides={"reference_generator": asked}).generator
        ReferenceGeneratorNode.warn_of_slope(node, changed)
    (text,) = said
    assert "waveform.frequency = 150.0" in text and "limits.slew_rate allows 2000 V/s" in text
