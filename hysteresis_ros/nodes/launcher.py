# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Start the processes of a graph, end them with the process that started them, stop them in order; imports no ROS."""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import json
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

from hysteresis_ros.errors import ConfigurationError, HysteresisError
from hysteresis_ros.nodes.domain import Domain
from hysteresis_ros.nodes.security.policy import enclave_of
from hysteresis_ros.signals import ACTUATOR

if TYPE_CHECKING:
    from hysteresis_ros.loop.parameters import AxisParameters
    from hysteresis_ros.loop.stage_parameters import StageParameters

_PR_SET_PDEATHSIG = 1

#: Commands of ``ros2`` whose nodes continue to run when SIGTERM or SIGKILL ends the command.
STARTERS = ("launch", "run")


def die_with_parent(parent: int) -> None:
    """On Linux, end this child process when its parent ends; call it in the child, or as its ``preexec_fn``."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:
            os._exit(1)


def starts_nodes(command: list[str]) -> bool:
    """Return whether a command line runs ``ros2 launch`` or ``ros2 run``."""
    words = [pathlib.PurePath(word).name for word in command[:3]]
    return "ros2" in words[:2] and any(word in STARTERS for word in words[1:])


def leave_with_ros2() -> bool:
    """Signal this process to exit when the ``ros2 launch`` or ``ros2 run`` that started it has ended.

    Return whether one of these commands has started the process. Both commands pass only Ctrl-C on to their nodes: when
    SIGTERM ends them, for instance from a service manager, the nodes continue to run the axis. The exit of any other
    parent, such as a shell that has started a node in the background, has no effect.
    """
    parent = os.getppid()
    with contextlib.suppress(OSError):
        text = pathlib.Path(f"/proc/{parent}/cmdline").read_bytes().decode(errors="replace")
        if starts_nodes(text.split("\0")):
            die_with_parent(parent)
            return True
    return False


#: Order in which nodes are stopped, so that the voltage reaches its safe value while the plant runs; the recorder is
#: last.
STOP_ORDER = (
    "reference_generator",
    "inchworm_sequencer",
    "motion_controller",
    "hysteresis_compensator",
    "hysteresis_axis",
    "hysteresis_stage",
    "plant_simulator",
    "displacement_camera",
    "recorder",
)

#: Argument of a composed process that has no plant node.
EXTERNAL_PLANT = "--external-plant"

#: Time for a node to exit before it is killed [s].
PATIENCE = 10.0


def require_messages(stage: StageParameters) -> None:
    """Refuse a stage in real time whose rate is too high for messages between its nodes."""
    from hysteresis_ros.loop.parameters import HIGHEST_MESSAGE_RATE

    rate = stage.axes[0].plant_simulator.real_time_factor * stage.sample_rate
    if stage.stage.time_mode == "realtime" and rate > HIGHEST_MESSAGE_RATE:
        raise ConfigurationError(
            f"time_mode = 'realtime': {rate:g} samples/s are too many for the messages between the nodes of a stage, "
            f"whose limit is {HIGHEST_MESSAGE_RATE:g} Hz: run it fused (hysteresis up CONFIG --fused), in "
            "lockstep (--rate lockstep), or with a lower real-time factor (--factor)"
        )


def require_ros() -> None:
    """Raise HysteresisError if rclpy is not installed, without importing it."""
    if importlib.util.find_spec("rclpy") is None:
        raise HysteresisError('rclpy is not installed: pip install "hysteresis_ros[ros]" or source /opt/ros/jazzy')


def node_environment() -> dict[str, str]:
    """Return the environment of ``python -m`` processes, which must not import modules from the current folder.

    Otherwise a file ``yaml.py`` in the folder of a user's recordings would replace the library. The folder of this
    package stays in the path even if it is the current folder, as in a clone that is not installed.
    """
    environment = dict(os.environ, PYTHONSAFEPATH="1")
    home = pathlib.Path(__file__).resolve().parents[2]
    if home == pathlib.Path.cwd():
        paths = (str(home), environment.get("PYTHONPATH", ""))
        environment["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
    return environment


class GraphError(HysteresisError):
    """A node ended or refused to start; the other nodes of the graph were stopped."""

    def __init__(self, text: str, exit_code: int):
        super().__init__(text)
        self.exit_code = exit_code


def _print_warning(text: str) -> None:
    print(f"hysteresis: warning: {text}", file=sys.stderr)


@dataclass
class NodeProcess:
    """One running process of the graph."""

    name: str
    namespace: str
    process: subprocess.Popen = field(repr=False)

    @property
    def full_name(self) -> str:
        """Full node name for messages."""
        return f"{self.namespace}/{self.name}"


class Graph:
    """The processes of one or several axes, or of a stage of coupled axes."""

    def __init__(
        self,
        axes: list[AxisParameters],
        *,
        stage: StageParameters | None = None,
        composed: bool = False,
        record=None,
        log_level: str = "warn",
        environment: dict[str, str] | None = None,
        warn: Callable[[str], object] = _print_warning,
    ):
        self.composed = composed
        self.environment = node_environment() | (environment or {})
        self.record = pathlib.Path(record) if record is not None else None
        self.bags: list[pathlib.Path] = []
        self.log_level = log_level
        if stage is None:
            self.axes = [self._with_recorder(axis, len(axes) > 1) for axis in axes]
        else:
            self.axes = self._with_one_bag(axes)
        #: The stage of coupled axes, which share processes and one bag; None for independent axes.
        self.stage = stage
        self.processes: list[NodeProcess] = []
        #: Recorders that died or stopped recording while the axis continued.
        self.lost: list[NodeProcess] = []
        self._warn = warn
        self._stack = contextlib.ExitStack()
        self._first_left = 0.0

    def _with_recorder(self, axis: AxisParameters, several: bool) -> AxisParameters:
        if self.record is None:
            return axis
        bag = self.record / (axis.namespace.strip("/").replace("/", "_") or "axis") if several else self.record
        return axis.with_recorder(self._new_bag(bag))

    def _with_one_bag(self, axes: list[AxisParameters]) -> list[AxisParameters]:
        if self.record is None:
            return axes
        bag = self._new_bag(self.record)
        return [axis.with_recorder(bag) for axis in axes]

    def _new_bag(self, bag: pathlib.Path) -> str:
        """Return the path of a bag that the recorder can create."""
        if bag.exists():
            raise ConfigurationError(f"{bag}: exists already; choose another folder for the recording or remove it")
        _require_creatable(bag)
        self.bags.append(bag)
        return str(bag.resolve())

    def __enter__(self) -> Graph:
        try:
            self.start()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *exception) -> None:
        self.stop()

    def start(self) -> None:
        """Start all processes and return without waiting; DDS connects them."""
        folder = pathlib.Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="hysteresis_")))
        if self.stage is not None:
            self._start_stage(self.stage, folder / "stage.yaml")
        for number, axis in enumerate(self.axes if self.stage is None else ()):
            path = folder / f"axis{number}.yaml"
            axis = replace(axis, recorder=replace(axis.recorder, configuration=str(path)))
            path.write_text(axis.configuration_text(), encoding="utf-8")
            fused, external = axis.plant_simulator.time_mode == "fused", axis.plant_simulator.external_plant
            names = list(axis.kind.nodes)
            more = []
            if self.composed or fused:
                names = ["hysteresis_axis"]
                more = [EXTERNAL_PLANT] if external else []
            elif external:
                names.remove("plant_simulator")
            if axis.displacement_camera is not None:
                names.append("displacement_camera")
            if self.record is not None and fused:
                more.append("--recorder")
            elif self.record is not None:
                names.insert(0, "recorder")
            for name in names:
                own = more if name == "hysteresis_axis" else []
                self.processes.append(self._spawn(name, axis.namespace, path, own))
        steered = any(axis.plant_simulator.time_mode != "lockstep" for axis in self.axes)
        if steered:
            self._stack.enter_context(session(self.environment))

    def _start_stage(self, stage: StageParameters, path: pathlib.Path) -> None:
        """Start the nodes of all axes: one process per kind of node, or one in all, which a fused stage needs."""
        axes = [replace(axis, recorder=replace(axis.recorder, configuration=str(path))) for axis in self.axes]
        path.write_text(replace(stage, axes=tuple(axes)).configuration_text(), encoding="utf-8")
        fused = stage.stage.time_mode == "fused"
        names = ["hysteresis_stage"] if self.composed or fused else list(ACTUATOR.nodes)
        recorded = self.record is not None
        for name in ["recorder", *names] if recorded and not fused else names:
            own = [name] if name != "hysteresis_stage" else ["--recorder"] if recorded and fused else []
            options = {"log_level": self.log_level, "enclave": enclave_of(stage.namespace, name)}
            command = node_command("hysteresis_stage", stage.namespace, path, *own, **options)
            self.processes.append(NodeProcess(name, stage.namespace, started(command, self.environment)))

    def _spawn(self, name: str, namespace: str, path: pathlib.Path, more: list[str]) -> NodeProcess:
        command = node_command(name, namespace, path, *more, log_level=self.log_level)
        return NodeProcess(name, namespace, started(command, self.environment))

    def poll(self) -> bool:
        """Return True while the graph runs, False when every node has exited with code 0."""
        for node in [node for node in self.processes if self._is_lost_recorder(node)]:
            self.processes.remove(node)
            self.lost.append(node)
            self._warn(f"{node.full_name} {_how_it_ended(node)}: the recording has ended, the axis continues")
        codes = [node.process.poll() for node in self.processes]
        ended = [node for node, code in zip(self.processes, codes, strict=True) if code is not None]
        dead = [node for node in ended if node.process.returncode != 0]
        if dead:
            # one failed node soon ends other nodes; killed nodes and refused parameters are the probable causes, so
            # they are reported first
            first = min(dead, key=lambda node: (node.process.returncode > 0, node.process.returncode != 2))
            code = first.process.returncode
            self.stop()
            said = f"{first.full_name} {_how_it_ended(first)}; the other nodes were stopped"
            raise GraphError(said, 2 if code == 2 else 1)
        if ended and None in codes:
            self._first_left = self._first_left or time.monotonic()
            if time.monotonic() - self._first_left > PATIENCE:
                names = ", ".join(node.full_name for node in ended)
                self.stop()
                raise GraphError(f"{names} exited before the other nodes, which were stopped", 1)
        return None in codes

    def _is_lost_recorder(self, node: NodeProcess) -> bool:
        """Return whether a node is a recorder that died while its axis, in real time, continues without it.

        A recorder that fails to start ends the run; so does any lost node in lockstep.
        """
        if node.name != "recorder" or node.process.poll() in (None, 0, 2):
            return False
        axis = next(axis for axis in self.axes if self.stage is not None or axis.namespace == node.namespace)
        return axis.plant_simulator.time_mode != "lockstep"

    def wait(self, stop_requested=lambda: False) -> bool:
        """Wait until the run ends regularly (True) or ``stop_requested()`` becomes true (False)."""
        while self.poll():
            if stop_requested():
                return False
            time.sleep(0.05)
        return True

    def stop(self) -> None:
        """Stop all running processes; kill those that do not exit in time.

        In real time they stop in order. In lockstep all nodes stop together, because the loss of one node would make
        the others report an error. Signals take effect only when all processes have exited, because until then these
        write to the caller's folders.
        """
        with _signals_held_back():
            self._stop()
            self._stack.close()

    def _stop(self) -> None:
        lockstep = all(axis.plant_simulator.time_mode == "lockstep" for axis in self.axes)
        for names in [STOP_ORDER] if lockstep else [[name] for name in STOP_ORDER]:
            group = [node for node in self.processes if node.name in names and node.process.poll() is None]
            for node in group:
                node.process.send_signal(signal.SIGTERM)
            for node in group:
                try:
                    node.process.wait(PATIENCE)
                except subprocess.TimeoutExpired:
                    node.process.kill()
                    node.process.wait()
            self.lost += [node for node in group if self.record is not None and node.process.returncode == 1]


@contextlib.contextmanager
def _signals_held_back() -> Iterator[None]:
    """Delay Ctrl-C and SIGTERM until the block ends; only the main thread receives them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    before = {
        number: signal.signal(number, lambda number, frame: received.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if received:
        signal.raise_signal(received[0])


def node_command(
    name: str, namespace: str, path: pathlib.Path, *more: str, log_level: str = "warn", enclave: str = ""
) -> list[str]:
    """Return the command line of one node, or of all nodes of an axis; the default enclave depends on ``name``."""
    module = name.removeprefix("hysteresis_") if name in ("hysteresis_axis", "hysteresis_stage") else name
    command = [sys.executable, "-m", f"hysteresis_ros.nodes.{module}", *more, "--ros-args"]
    command += ["--params-file", str(path), "--log-level", log_level]
    command += ["--enclave", enclave or enclave_of(namespace, name)]
    # the nodes of a stage are in the namespaces of its axes
    return [*command, "-r", f"__ns:={namespace}"] if namespace and name != "hysteresis_stage" else command


@contextlib.contextmanager
def session(environment: dict[str, str]) -> Iterator[None]:
    """Keep a process in the graph that executes the user's commands, unless each command needs its own enclave."""
    if os.environ.get("ROS_SECURITY_ENABLE", "").lower() == "true":
        yield
        return
    words = [sys.executable, "-m", "hysteresis_ros.nodes.remote.session"]
    with started(words, environment, stderr=subprocess.DEVNULL) as process:
        try:
            yield
        finally:
            process.kill()  # it has no state to save


def started(command: list[str], environment: dict[str, str], **options) -> subprocess.Popen:
    """Start a process that ends when this process ends."""
    # in a session of its own, so that Ctrl-C in a terminal reaches only this process, which then stops the nodes in
    # order
    guard = partial(die_with_parent, os.getpid())
    return subprocess.Popen(command, env=environment, start_new_session=True, preexec_fn=guard, **options)


def _how_it_ended(node: NodeProcess) -> str:
    code = node.process.returncode
    return f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"


def _require_creatable(folder: pathlib.Path) -> None:
    """Raise ConfigurationError if a folder cannot be created; created parent folders are kept."""
    try:
        folder.mkdir(parents=True)
        folder.rmdir()
    except OSError as error:
        raise ConfigurationError(
            f"{folder}: cannot be created: {error.strerror}; choose another folder for the recording"
        ) from None


def run_apart(module: str, request: dict) -> int:
    """Run a module in an isolated ROS domain, and return its exit code."""
    require_ros()
    with Domain() as domain:
        # a separate process, because the pip wheels of ROS restart the interpreter on import
        command = [sys.executable, "-m", module, json.dumps(request)]
        return started(command, node_environment() | domain.environment).wait()
