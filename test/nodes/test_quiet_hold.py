# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Quiet hold over ROS: the service, the command, pulses of the trigger input, in lockstep bit for bit as offline."""

from __future__ import annotations

import json
import math
import re
import signal
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import until, write_axis  # noqa: E402
from rcl_interfaces.srv import SetParametersAtomically  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from hysteresis_ros import signals  # noqa: E402
from hysteresis_ros.configuration import load_configuration  # noqa: E402
from hysteresis_ros.loop.axis import Axis  # noqa: E402
from hysteresis_ros.loop.parameters import AxisParameters  # noqa: E402
from hysteresis_ros.loop.watch import MODE_NAMES, QUIET, RUNNING  # noqa: E402
from hysteresis_ros.nodes.quiet import QuietHold  # noqa: E402


def creeping_axis() -> AxisParameters:
    """Return the measured stage at rest after a step of 20 um, in lockstep, without an end."""
    configuration = load_configuration("picma_stage").override("", time_mode="lockstep")
    configuration = configuration.override("reference_generator", waveform__type="hold", initial_setpoint=20e-6)
    configuration = configuration.override("plant_simulator", sensor__noise=3e-9)
    configuration = configuration.override("motion_controller", quiet__on_trigger=0.25)
    return AxisParameters.from_configuration(configuration)


def test_requests_and_pulses_between_nodes_are_repeated_bit_for_bit(processes, observer, tmp_path):
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Empty

    from hysteresis_ros.loop.simulation import differences
    from hysteresis_ros.recordings.files import load_run

    def ask(**values):
        given = [
            Parameter(name, Parameter.Type.DOUBLE if isinstance(value, float) else Parameter.Type.STRING, value)
            for name, value in values.items()
        ]
        request = SetParametersAtomically.Request(parameters=[one.to_parameter_msg() for one in given])
        result = observer.call(SetParametersAtomically, "/motion_controller/quiet", request).result
        return result.successful, result.reason

    def modes(since: int) -> list[int]:
        return [round(one.position[one.name.index("mode")]) for one in heard[since:]]

    def held_and_over(since: int) -> bool:
        """Return whether a quiet hold began and ended; on a busy machine it may be shorter than a look at the last."""
        found = modes(since)
        return QUIET in found and found[-1] != QUIET

    heard = observer.listen(JointState, "/motion_controller/state")
    pulse = observer.talk(Empty, "/trigger_in")
    axis = creeping_axis()
    run = processes.command(
        "up", write_axis(tmp_path / "axis.yaml", axis), "--composed", "--record", str(tmp_path / "bag")
    )
    until(lambda: len(heard) > 400 or run.popen.poll() is not None, what="two seconds of the axis")
    # the tolerance is compared with the creep that the compensator's model has in this state
    success, reason = ask(duration=30.0, tolerance=1e-9)
    assert not success and "allowed now: at most" in reason and "30 % of the predicted creep" in reason
    for wrong in ({"tolerance": 1e-9}, {"duration": "2 s"}, {"duration": 1.0, "time": 1.0}):
        assert not ask(**wrong)[0]
    refused = processes.command("quiet", "30s", "--tolerance", "1nm")
    assert refused.wait() == 2 and "allowed now: at most" in refused.output
    assert QUIET not in modes(0)
    begun = len(heard)
    # more simulated time than the request needs
    success, reason = ask(duration=1.0, tolerance=1e-6)
    assert success and "predicted drift" in reason, reason
    until(lambda: held_and_over(begun), what="the quiet hold and its end")
    until(lambda: pulse.get_subscription_count(), what="the trigger input")
    begun = len(heard)
    pulse.publish(Empty())
    until(lambda: held_and_over(begun), what="the quiet hold of the pulse and its end")
    last = len(heard)
    until(lambda: len(heard) > last + 100, what="samples after the last hold")
    assert run.leave(signal.SIGINT)[0] == 0, run.output
    recorded = load_run(tmp_path / "bag", further=True)
    assert [change["parameters"] for change in recorded.metadata["changes"]] == [{"duration": 1.0}, {"duration": 0.25}]
    assert differences(recorded, axis) == {}
    assert np.count_nonzero(recorded["controller_mode"] == QUIET) == 200 + 50
    # the controller follows the creep of the compensator, which is another node
    same = Axis(axis)
    same.run(recorded["setpoint"][: recorded.metadata["changes"][0]["sample"]])
    told = re.search(r"of the creep of ([\d.]+) (pm|nm|µm)", reason)
    unit = {"pm": 1e-12, "nm": 1e-9, "µm": 1e-6}  # the later the request, the smaller the creep
    assert told, reason
    assert float(told[1]) * unit[told[2]] == pytest.approx(same.forecast().creep(1.0), rel=0.01)


class Hold:
    """The quiet hold of a controller without a graph."""

    def __init__(self, axis: AxisParameters, fused=None):
        self.taken, self.logged, self.warned = [], [], []
        self.hindrance = ""
        self.node = SimpleNamespace(
            parameters=axis.motion_controller,
            kind="motion_controller",
            create_service=lambda *_: None,
            destroy_service=None,
            _topic_handles=[],
            runner=SimpleNamespace(by_message=fused is None),
            subscriber=lambda *_: None,
            changes_qos=lambda: None,
            is_fused=fused is not None,
            fused=fused,
            active=True,
            running=True,
            row=np.zeros(len(signals.SIGNALS)),
            hindrance=lambda: self.hindrance,
            part=SimpleNamespace(quiet=self.taken.append),
            log_change=lambda action, parameters: self.logged.append((action, parameters)),
            warn=lambda name, text: self.warned.append(text),
        )
        self.hold = QuietHold(self.node)

    def ask(self, **values):
        """Request a quiet hold; return whether it is accepted, and the reply."""
        given = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        request = SetParametersAtomically.Request(parameters=given)
        result = self.hold._on_quiet(request, SetParametersAtomically.Response()).result
        return result.successful, result.reason

    def change(self, parameters, action=signals.CONFIGURED, node=signals.COMPENSATOR):
        """Hear an entry of the change log."""
        entry = {"node": node, "action": action, "parameters": parameters}
        self.hold._on_change(String(data=json.dumps(entry)))


@pytest.mark.parametrize("mode", range(len(MODE_NAMES)))
def test_only_a_closed_loop_and_an_axis_that_is_quiet_take_a_quiet_hold(mode):
    one = Hold(creeping_axis())
    one.node.row[signals.CONTROLLER_MODE] = mode
    success, reason = one.ask(duration=2.0)
    if MODE_NAMES[mode] in ("running", "quiet"):
        # 50 ms to average, as long to fade
        assert success and "quiet for 2 s, from 0.1 s after the request" in reason
        assert one.taken == [2.0] and one.logged == [("quiet", {"duration": 2.0})]
        assert one.ask(duration=0.0) == (True, "the quiet hold ends") and one.taken == [2.0, 0.0]
    else:
        assert not success and f"the controller is {MODE_NAMES[mode]}" in reason and not one.taken and one.warned
    one.node.row[signals.CONTROLLER_MODE] = RUNNING
    one.node.running = False
    assert "call ~/start" in one.ask(duration=2.0)[1]
    one.hindrance = "the plant is lost"
    assert "the plant is lost" in one.ask(duration=2.0)[1]


def test_the_creep_that_a_controller_follows_is_that_of_the_compensator_and_rests_with_it():
    axis = creeping_axis()
    mapping = json.loads(json.dumps(axis.hysteresis_compensator.to_mapping()))
    one, same = Hold(axis), Axis(axis)
    assert not one.hold.forecast.is_known
    one.change(mapping)
    applied = same.run(np.full(400, 20e-6))["applied"]

    def follow():
        for value in (math.nan, *applied):
            one.hold.follow(value)

    follow()
    crept = same.forecast().creep(5.0)
    assert crept > 1e-8 and one.hold.forecast.creep(5.0) == pytest.approx(crept, rel=1e-9)
    for other in ({"node": "plant_simulator"}, {"action": "stop"}):
        one.change({"creep.type": "none"}, **other)
    assert one.hold.forecast.creep(5.0) == pytest.approx(crept, rel=1e-9)
    # a retune changes the model of the axis where it is
    rate = mapping["creep.logarithmic.rate"]
    one.change({"creep.logarithmic.rate": 0.5 * rate}, "retune")
    assert one.hold.forecast.creep(5.0) == pytest.approx(0.5 * crept, rel=0.1)
    # a compensator that begins anew, and a reset, are at rest
    one.change(mapping)
    assert one.hold.forecast.creep(5.0) == 0.0
    follow()
    assert one.hold.forecast.creep(5.0) == pytest.approx(crept, rel=1e-9)
    one.hold.reset()
    assert one.hold.forecast.creep(5.0) == 0.0 and one.hold.forecast.is_known


@pytest.mark.parametrize(("action", "passed"), [(None, 0), ("none", 1), ("hold", 0)])
def test_a_pulse_reaches_the_loop_once(action, passed):
    pulses = []
    source = SimpleNamespace(parameters=SimpleNamespace(triggers=SimpleNamespace(input=SimpleNamespace(action=action))))
    # with an action of its own the source passes the pulse to a fused loop
    fused = None if action is None else SimpleNamespace(source=source, pulse=lambda: pulses.append(1))
    one = Hold(creeping_axis(), fused)
    one.node.active = False
    one.hold._on_pulse(None)
    assert not one.taken and not pulses
    one.node.active = True
    one.hold._on_pulse(None)
    assert len(pulses) == passed and one.taken == ([0.25] if action is None else [])
    assert one.logged == ([("quiet", {"duration": 0.25})] if action is None else [])
