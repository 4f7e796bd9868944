# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Real processes and real DDS: every group of nodes in its own domain; waits for conditions, never for a fixed time."""

from __future__ import annotations

import contextlib
import itertools
import os
import pathlib
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from types import SimpleNamespace

from waiting import PATIENCE, until

from hysteresis_ros.nodes.domain import OWN

# Before the first participant: no discovery outside this machine, and no shared memory left by killed processes.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4"

ROOT = pathlib.Path(__file__).resolve().parents[2]
#: Time [s] within which a node has to exit, long enough for a busy machine.
LEAVE = 3.0
#: Time [s] after which an answer counts as lost.
LOST = 8.0
#: State after each transition.
REACHED = {"configure": "inactive", "activate": "active", "deactivate": "inactive", "cleanup": "unconfigured"}

_counter = itertools.count()


#: All non-ideal properties: noise of 5 nm, 16 bits, tight limits, preload.
REAL = {
    "plant_simulator": {
        "sensor__noise": 5.0e-9,
        "limits__maximum": 90.0,
        "limits__slew_rate": 4.0e4,
        "preload__force": 0.2,
    },
    "hysteresis_compensator": {"limits__maximum": 90.0, "limits__slew_rate": 4.0e4},
    "motion_controller": {"model__preload__force": 0.2},
    "reference_generator": {"waveform__type": "sine", "waveform__amplitude": 4.0e-6},
}
SINE = {"waveform__frequency": 20.0, "waveform__offset": 5.0e-6}
_LAG = {"A": (0.5,), "B": (0.5,), "C": (1.0,)}
#: An open-loop axis that is at rest after some samples; Kim's resonance rings for 1500 samples, seconds at a slow rate.
SOON_AT_REST = {
    "plant_simulator": {f"dynamics__{name}": matrix for name, matrix in _LAG.items()},
    "motion_controller": {"type": "open_loop", **{f"model__dynamics__{name}": m for name, m in _LAG.items()}},
}


def axis_parameters(namespace: str = "", overrides: dict | None = None, **common):
    """Return the parameters of Kim's axis with overrides: node → {parameter with double underscores: value}."""
    from hysteresis_ros.configuration import load_configuration
    from hysteresis_ros.loop.parameters import AxisParameters

    configuration = load_configuration(ROOT / "config" / "kim2009.yaml").override("", **common)
    configuration = configuration.override("reference_generator", waveform__type="hold")
    # as for a device: the file allows more late samples in a simulation
    configuration = configuration.override("plant_simulator", late_limit=0)
    if "sample_rate" in common:  # time and errors do not depend on the dynamics here
        configuration = configuration.override("plant_simulator", dynamics__sample_time=0.0)
        configuration = configuration.override("motion_controller", model__dynamics__sample_time=0.0)
    for node, values in (overrides or {}).items():
        configuration = configuration.override(node, **values)
    return AxisParameters.from_configuration(configuration, namespace)


def write_axis(path, axis) -> str:
    path.write_text(axis.configuration_text(), encoding="utf-8")
    return str(path)


class Process:
    """A process with its output in a file."""

    def __init__(self, command, folder, domain: int, name: str):
        self.log = folder / f"{name}-{next(_counter)}.log"
        environment = dict(os.environ, ROS_DOMAIN_ID=str(domain), PYTHONUNBUFFERED="1") | {OWN: str(domain)}
        paths = [str(ROOT), environment.get("PYTHONPATH", "")] if _from_tree() else [environment.get("PYTHONPATH", "")]
        environment["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
        with open(self.log, "w", encoding="utf-8") as output:
            self.popen = subprocess.Popen(
                command, cwd=folder, env=environment, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
            )

    @property
    def output(self) -> str:
        return self.log.read_text(encoding="utf-8")

    def wait(self, timeout: float = PATIENCE) -> int:
        try:
            return self.popen.wait(timeout)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"still running after {timeout:g} s:\n{self.output}") from None

    def send(self, number) -> None:
        self.popen.send_signal(number)

    def leave(self, number=signal.SIGTERM) -> tuple[int, float]:
        """Send a signal; return the exit code and the time [s] until the process ended."""
        start = time.monotonic()
        self.send(number)
        code = self.wait()
        return code, time.monotonic() - start

    def kill(self) -> None:
        if self.popen.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.popen.pid, signal.SIGKILL)
        self.popen.wait()


def _from_tree() -> bool:
    import hysteresis_ros

    return pathlib.Path(hysteresis_ros.__file__).is_relative_to(ROOT) and "site-packages" not in hysteresis_ros.__file__


class Processes:
    """Starts processes in one domain, and kills the remaining ones at the end."""

    def __init__(self, folder, domain: int):
        self.folder, self.domain, self.started = folder, domain, []

    def start(self, command, name: str) -> Process:
        process = Process(command, self.folder, self.domain, name)
        self.started.append(process)
        return process

    def node(self, name: str, path, *more: str, namespace: str = "") -> Process:
        module = "axis" if name == "hysteresis_axis" else name
        command = [sys.executable, "-m", f"hysteresis_ros.nodes.{module}", "--ros-args", "--params-file", str(path)]
        command += ["-r", f"__ns:={namespace}"] if namespace else []
        return self.start([*command, *more], name)

    def command(self, *arguments: str) -> Process:
        return self.start([sys.executable, "-m", "hysteresis_ros.cli.main", *arguments], arguments[0])

    def busy(self, number: int = 2) -> list[Process]:
        """Keep the cores busy, until these processes are killed."""
        # these processes must end even if the test run is killed
        loop = f"import os\nwhile os.getppid() == {os.getpid()}: sum(range(100000))"
        return [self.start([sys.executable, "-c", loop], "busy") for _ in range(number)]

    def close(self) -> None:
        for process in self.started:
            process.kill()


def executor_in(context):
    """Return an executor; rclpy's EventsExecutor takes a tenth of the default executor's processor time."""
    try:
        from rclpy.experimental import EventsExecutor as Executor
    except ImportError:
        from rclpy.executors import SingleThreadedExecutor as Executor
    return Executor(context=context)


class Observer:
    """A node of the test itself, spun in a thread; stores received messages."""

    def __init__(self, domain: int):
        import rclpy
        from rclpy.context import Context

        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node(f"observer_{next(_counter)}", context=self.context)
        self.executor = executor_in(self.context)
        self.executor.add_node(self.node)
        self._leaving = threading.Event()
        self.kept_clients: dict = {}
        self.asked = 0
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        while not self._leaving.is_set():
            self.executor.spin_once(timeout_sec=0.02)

    def close(self) -> None:
        self._leaving.set()
        self._thread.join()
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def listen(self, message_type, topic: str, qos=1000) -> list:
        heard: list = []
        self.node.create_subscription(message_type, topic, heard.append, qos)
        return heard

    def talk(self, message_type, topic: str, qos=10):
        publisher = self.node.create_publisher(message_type, topic, qos)
        return publisher

    def call(self, service_type, name: str, request):
        client = self.kept_clients.get(name) or self.node.create_client(service_type, name)
        try:
            until(client.service_is_ready, what=f"service {name}")
            return self._answer(client, name, request)
        finally:
            if name not in self.kept_clients:
                self.node.destroy_client(client)

    def _answer(self, client, name: str, request):
        """Send a request repeatedly: an answer sent before the server has found the client is lost."""
        futures = []

        def answered():
            return next((future for future in futures if future.done()), None)

        deadline = time.monotonic() + PATIENCE
        while answered() is None and time.monotonic() < deadline:
            futures.append(client.call_async(request))
            with contextlib.suppress(AssertionError):
                until(answered, LOST, what=f"answer of {name}", every=0.001)
        assert answered() is not None, f"{name} has not answered in {PATIENCE:g} s"
        self.asked = len(futures)
        return answered().result()

    def keep_client(self, service_type, name: str) -> None:
        """Create a client once for all calls, because discovery takes longer than a call."""
        client = self.kept_clients[name] = self.node.create_client(service_type, name)
        until(client.service_is_ready, what=f"service {name}")

    def trigger(self, name: str):
        from std_srvs.srv import Trigger

        return self.call(Trigger, name, Trigger.Request())

    def transition(self, node: str, name: str) -> bool:
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState, GetState

        request = ChangeState.Request()
        request.transition.id = getattr(Transition, f"TRANSITION_{name.upper()}")
        success = self.call(ChangeState, f"{node}/change_state", request).success
        if self.asked > 1:  # a request that succeeded the first time is refused the second time
            return self.call(GetState, f"{node}/get_state", GetState.Request()).current_state.label == REACHED[name]
        return success

    def set_parameters(self, node: str, atomically: bool = True, **values):
        """Set parameters (double underscores for dots) and return (successful, reason)."""
        from rcl_interfaces.srv import SetParametersAtomically
        from rclpy.parameter import Parameter

        request = SetParametersAtomically.Request()
        for name, value in values.items():
            value = list(value) if isinstance(value, tuple) else value
            request.parameters.append(Parameter(name.replace("__", "."), value=value).to_parameter_msg())
        result = self.call(SetParametersAtomically, f"{node}/set_parameters_atomically", request).result
        return result.successful, result.reason


class InProcess:
    """Nodes of the package in the test's own process, on one executor in a thread."""

    def __init__(self, domain: int):
        import rclpy
        from rclpy.context import Context

        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.executor = executor_in(self.context)
        self.nodes: list = []
        self._leaving = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)

    def add(self, cls, parameters, autostart: bool = True, **options):
        """Create a node with typed parameters."""
        from rclpy.parameter import Parameter

        values = {name: value for name, value in parameters.to_mapping().items() if value != ()}
        overrides = [Parameter(n, value=list(v) if isinstance(v, tuple) else v) for n, v in values.items()]
        node = cls(context=self.context, parameter_overrides=overrides, **options)
        self.executor.add_node(node)
        self.nodes.append(node)
        if autostart:
            assert node.configure_now() and node.activate_now()
        return node

    def spin(self) -> None:
        self._thread.start()

    def _spin(self) -> None:
        while not self._leaving.is_set():
            self.executor.spin_once(timeout_sec=0.02)

    def close(self) -> None:
        self._leaving.set()
        if self._thread.is_alive():
            self._thread.join()
        for node in self.nodes:
            node.active = False
            node.release()
        # the executor never releases a node whose callback it has scheduled but not run
        for _ in range(100):
            self.executor.spin_once(timeout_sec=0.0)
        for node in self.nodes:
            self.executor.remove_node(node)
            node.destroy_node()
        self.context.try_shutdown()


def shortened(axis, samples: int, **plant):
    """Return the axis with a run of ``samples`` samples."""
    return replace(axis, plant_simulator=replace(axis.plant_simulator, samples=samples, **plant))


def compose(inside, axis, **options):
    from hysteresis_ros.nodes.hysteresis_compensator import HysteresisCompensatorNode
    from hysteresis_ros.nodes.motion_controller import MotionControllerNode
    from hysteresis_ros.nodes.plant_simulator import PlantSimulatorNode
    from hysteresis_ros.nodes.reference_generator import ReferenceGeneratorNode

    classes = (PlantSimulatorNode, HysteresisCompensatorNode, MotionControllerNode, ReferenceGeneratorNode)
    names = ("plant_simulator", "hysteresis_compensator", "motion_controller", "reference_generator")
    return [
        inside.add(cls, getattr(axis, name), namespace=axis.namespace, **options)
        for cls, name in zip(classes, names, strict=True)
    ]


def compose_stage(inside, parameters, *further: str) -> list:
    """Make, configure and activate the nodes of a stage; recorders, if there are any, come first, then the plants."""
    from rclpy.parameter import Parameter

    from hysteresis_ros.nodes.stage import KINDS, stage_nodes

    nodes = []
    for kind, axis, make in stage_nodes(parameters, (*further, *KINDS)):
        values = {name: value for name, value in getattr(axis, kind).to_mapping().items() if value != ()}
        overrides = [Parameter(n, value=list(v) if isinstance(v, tuple) else v) for n, v in values.items()]
        nodes.append(make(context=inside.context, parameter_overrides=overrides))
        inside.executor.add_node(nodes[-1])
        inside.nodes.append(nodes[-1])
    for step in ("configure_now", "activate_now"):
        assert all(getattr(node, step)() for node in nodes)
    return nodes


class Goal:
    """Replaces a goal handle of rclpy: stores requests, and has its states."""

    def __init__(self, server, message, **tolerances):
        from builtin_interfaces.msg import Duration

        self.request = SimpleNamespace(
            trajectory=message,
            path_tolerance=tolerances.get("path", []),
            goal_tolerance=tolerances.get("goal", []),
            goal_time_tolerance=Duration(sec=20),
        )
        self.is_cancel_requested, self.status, self.result, self.feedback = False, None, None, []
        self._server = server

    def execute(self):
        assert self.status is None, "executed twice"
        self.result = self._server._answer(self)

    def succeed(self):
        from action_msgs.msg import GoalStatus

        self.status = GoalStatus.STATUS_SUCCEEDED

    def abort(self):
        from action_msgs.msg import GoalStatus

        self.status = GoalStatus.STATUS_ABORTED

    def canceled(self):
        from action_msgs.msg import GoalStatus

        self.status = GoalStatus.STATUS_CANCELED

    def publish_feedback(self, feedback):
        self.feedback.append(feedback)


class StandIn:
    """The used part of control_msgs/FollowJointTrajectory."""

    class Result(SimpleNamespace):
        SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED = 0, -1, -2, -4, -5

    Feedback = SimpleNamespace


class RecordedRun:
    """An axis composed in the test's process with a recorder; the plant begins when the recorder is present."""

    def __init__(self, inside, axis, bag):
        from hysteresis_ros.nodes.recorder import RecorderNode

        self.axis = replace(
            axis,
            plant_simulator=replace(axis.plant_simulator, wait_for_recorder=True),
            recorder=replace(axis.recorder, path=str(bag)),
        )
        self._inside, self._bag = inside, bag
        self._recorder = inside.add(RecorderNode, self.axis.recorder)
        self.plant, self.compensator, self.controller, self.source = compose(inside, self.axis)

    def result(self):
        """Wait for the end of the run, and return its recording with all fields of ``~/state``."""
        from hysteresis_ros.recordings.files import load_run

        until(lambda: self.plant.end_of_run > 0 or self._failed(), what="the end of the run")
        assert not self._failed()
        until(lambda: min(self._recorder._counts) == self.plant.sample, what="the last messages")
        self._recorder.release()
        return load_run(self._bag, further=True)

    def _failed(self) -> list[str]:
        return [node.failure for node in self._inside.nodes if node.failure]


def diagnostics(heard, node: str):
    """Return the last status of a node as (level, message, values), or None."""
    for array in reversed(heard):
        status = array.status[0]
        if status.name == f"{node}: axis":
            return int.from_bytes(status.level, "big"), status.message, {v.key: v.value for v in status.values}
    return None


class Driver:
    """A driver of real hardware: publishes joint_states on request of the test."""

    def __init__(self, observer, joint: str = "extender"):
        from sensor_msgs.msg import JointState

        self.message = JointState(name=["another", joint], position=[7.0, 0.0])
        self.publisher = observer.talk(JointState, "/joint_states")
        self.stamp = 1_000_000_000

    def send(self, position: float = 0.0, step: int = 5_000_000) -> None:
        self.stamp += step
        self.message.header.stamp.sec, self.message.header.stamp.nanosec = divmod(self.stamp, 1_000_000_000)
        self.message.position[1] = position
        self.publisher.publish(self.message)
