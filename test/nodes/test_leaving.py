# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""How nodes end: signals, wrong parameters, a dead partner, a killed recorder."""

from __future__ import annotations

import re
import signal
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import LEAVE, Processes, axis_parameters, until, write_axis  # noqa: E402

#: Reports the remaining threads after the exit of a node.
THREADS_LEFT = """
import pathlib
from hysteresis_ros.nodes.axis import main
code = main()
names = [path.read_text().strip() for path in pathlib.Path("/proc/self/task").glob("*/comm")]
print("left:", *sorted(name for name in names if name.startswith(("dds.ev", "dds.udp"))), flush=True)
raise SystemExit(code)
"""
NODES = ("plant_simulator", "hysteresis_compensator", "motion_controller", "reference_generator")
#: The axis holds 8 µm, at about 70 V.
HELD = {
    "reference_generator": {"initial_setpoint": 8.0e-6},
    "hysteresis_compensator": {"limits__slew_rate": 5.0e3, "safe_voltage": 1.5},
    "plant_simulator": {"late_limit": -1},  # the exit is tested, even on a machine too busy for the rate
}
WITHOUT_EVENTS_EXECUTOR = """
import sys
import rclpy
sys.modules["rclpy.experimental"] = None
from hysteresis_ros.nodes.axis import main
from hysteresis_ros.nodes.spin import make_executor
raise SystemExit(main())
"""
#: A node whose blocks run forever.
SLOW_START = """
from hysteresis_ros.nodes import reference_generator
def build(self, parameters):
    print("building", flush=True)
    while True:
        pass
reference_generator.ReferenceGeneratorNode.build = build
raise SystemExit(reference_generator.main())
"""
#: The same, in a callback of the compiler at the time of the signal, where exceptions are lost.
CALLED_BACK = """
import time
compiler = {"__name__": "llvmlite.binding.executionengine", "time": time}
exec('''
def notify(until):
    try:
        while time.monotonic() < until:
            pass
    except BaseException:
        print("lost")
''', compiler)
""" + SLOW_START.replace("    while True:", "    compiler['notify'](time.monotonic() + 1.0)\n    while True:")


def held_axis(mode: str, rate: float = 200.0, **more):
    return axis_parameters(overrides=HELD, time_mode=mode, sample_rate=rate if mode == "realtime" else 3000.0, **more)


def is_safe(voltage: float) -> bool:
    return abs(voltage - 1.5) <= 150.0 / 65535  # the converter has 16 bits


@pytest.mark.parametrize(
    ("mode", "how", "number"),
    [
        ("realtime", "processes", signal.SIGINT),
        ("lockstep", "processes", signal.SIGTERM),
        ("realtime", "composed", signal.SIGTERM),
        ("lockstep", "composed", signal.SIGINT),
        ("realtime", "without EventsExecutor", signal.SIGTERM),
    ],
)
def test_signal_ends_nodes_at_once_with_the_voltage_safe(processes, observer, tmp_path, mode, how, number):
    from std_msgs.msg import Float64

    # the default executor takes 0.4 ms per callback, ten times as long: 200 Hz would keep it busy all the time
    rate = 50.0 if how == "without EventsExecutor" else 200.0
    path = write_axis(tmp_path / "axis.yaml", held_axis(mode, rate))
    voltages = observer.listen(Float64, "/voltage")
    if how == "processes":
        nodes = [processes.node(name, path) for name in NODES]
    elif how == "composed":
        nodes = [processes.node("hysteresis_axis", path)]
    else:
        command = [sys.executable, "-c", WITHOUT_EVENTS_EXECUTOR, "--ros-args", "--params-file", path]
        nodes = [processes.start(command, "axis")]
    until(lambda: voltages and voltages[-1].data > 50.0, what="the axis to hold its position")
    start = time.monotonic()
    for node in nodes:
        node.send(number)
    codes = [node.wait() for node in nodes]
    assert time.monotonic() - start < LEAVE
    assert codes == [0] * len(nodes), "\n".join(node.output for node in nodes)
    assert not any("Traceback" in node.output or "ERROR" in node.output for node in nodes)
    until(lambda: is_safe(voltages[-1].data), what="the safe voltage")
    if mode == "realtime" and how == "composed":
        # it returned at safe_slew_rate, 1000 V/s at 200 samples per second
        assert len({v.data for v in voltages if 5.0 < v.data < 60.0}) >= 10
    assert "real-time factor" in "".join(node.output for node in nodes)


def test_memory_does_not_grow_over_many_samples(processes, observer, tmp_path):
    import psutil
    from diagnostic_msgs.msg import DiagnosticArray

    reports = observer.listen(DiagnosticArray, "/diagnostics")

    def samples() -> int:
        return max((int(v.value) for r in reports for v in r.status[0].values if v.key == "samples"), default=0)

    node = processes.node("hysteresis_axis", write_axis(tmp_path / "axis.yaml", held_axis("lockstep")))
    memory = psutil.Process(node.popen.pid).memory_info
    # earlier, queues fill and kernels are loaded from the cache
    until(lambda: samples() > 4_000, what="the first samples")
    before = memory().rss
    until(lambda: samples() > 11_000, what="many samples")
    assert memory().rss - before < 525_000  # 75 bytes per sample
    assert node.leave(signal.SIGTERM)[0] == 0


@pytest.mark.parametrize(("mode", "how"), [("realtime", "--processes"), ("lockstep", "--composed")])
def test_up_stopped_by_a_signal_leaves_a_whole_recording(processes, observer, tmp_path, mode, how):
    from std_msgs.msg import Float64

    from hysteresis_ros.loop.simulation import differences
    from hysteresis_ros.recordings.bag_reader import read_bag
    from hysteresis_ros.recordings.cdr import decode_float64s
    from hysteresis_ros.recordings.files import load_run

    axis = held_axis(mode)
    voltages = observer.listen(Float64, "/voltage")
    path = write_axis(tmp_path / "axis.yaml", axis)
    run = processes.command("up", path, how, "--record", str(tmp_path / "bag"))
    until(lambda: len(voltages) > 100 and voltages[-1].data > 50.0, what="the axis to hold its position")
    code, _ = run.leave(signal.SIGINT if mode == "realtime" else signal.SIGTERM)
    assert code == 0, run.output
    assert "Traceback" not in run.output and "ERROR" not in run.output
    bag = read_bag(tmp_path / "bag")
    assert bag.complete
    assert is_safe(decode_float64s(bag.topics["/voltage"].data, "/voltage")[-1])
    recorded = load_run(tmp_path / "bag")
    assert recorded.time.size > 50
    if mode == "lockstep":
        assert differences(recorded, axis) == {}


@pytest.mark.parametrize("program", [SLOW_START, CALLED_BACK], ids=["compiling", "called back"])
def test_signal_while_the_kernels_are_compiled_ends_a_node(processes, tmp_path, program):
    """A node before its first message, with an empty cache."""
    command = [sys.executable, "-c", program, "--ros-args"]
    node = processes.start(command, "slow")
    until(lambda: "building" in node.output)
    code, seconds = node.leave(signal.SIGINT)
    assert code == 0, node.output
    assert seconds < LEAVE
    assert "Traceback" not in node.output and "lost" not in node.output


@pytest.fixture(scope="module")
def refusals(tmp_path_factory, domain_of_module):
    """Start all processes that must be refused at once; return name → (exit code, output)."""
    folder = tmp_path_factory.mktemp("refused")
    started = Processes(folder, domain_of_module)
    common = "/**:\n  ros__parameters:\n    sample_rate: 100.0\n"
    files = {
        "unknown": common + "    maximun: 1.0e-5\n",
        "mistyped": common + "    waveform.type: hold\n    maximum: high\n",
        "out of range": common + "    partner_timeout: 0.0\n",
        "inconsistent": common + "    minimum: 1.0\n    maximum: 0.5\n    initial_setpoint: 0.7\n",
        "malformed": "/**: [unclosed\n  x: }\n",
        "missing": common + "    hysteresis:\n      type: polynomial\n",
    }
    running = {}
    for name, text in files.items():
        path = folder / f"{name.replace(' ', '_')}.yaml"
        path.write_text(text, encoding="utf-8")
        kind = "plant_simulator" if name == "missing" else "reference_generator"
        # all at once, and each node name is used once
        running[name] = started.node(kind, path, namespace=f"/{path.stem}")
    running["composed"] = started.node("hysteresis_axis", folder / "unknown.yaml")
    running["no file"] = started.node("reference_generator", folder / "nothing.yaml")
    running["bad name"] = started.node("reference_generator", folder / "missing.yaml", "-r", "__node:=bad-name")
    existing = folder / "bag"
    existing.mkdir()
    good = write_axis(folder / "good.yaml", held_axis("lockstep"))
    two = [axis_parameters(ns, {"plant_simulator": {"publish_clock": True}}) for ns in ("/left", "/right")]
    clocks = folder / "clocks.yaml"
    clocks.write_text("".join(axis.configuration_text() for axis in two), encoding="utf-8")
    running["up without file"] = started.command("up", "nothing.yaml")
    running["up malformed"] = started.command("up", str(folder / "malformed.yaml"))
    running["up existing"] = started.command("up", good, "--record", str(existing))
    running["up clocks"] = started.command("up", str(clocks))
    running["up factor"] = started.command("up", good, "--factor", "0")
    ended = {name: (process.wait(), process.output) for name, process in running.items()}
    started.close()
    return ended


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("unknown", ("maximun", "1e-05", "did you mean maximum?")),
        ("mistyped", ("maximum", "'high'", "double")),
        ("out of range", ("partner_timeout", "0.0", "0.1 … 3600 s")),
        ("inconsistent", ("maximum", "0.5", "must be > minimum = 1 m")),
        ("malformed", ("error:", "malformed.yaml")),
        ("missing", ("hysteresis.polynomial.virgin", "missing", "double array")),
        ("composed", ("maximun", "unknown parameter")),
        ("no file", ("error:", "nothing.yaml")),
        ("bad name", ("error:", "bad-name")),
        ("up without file", ("nothing.yaml", "no such file")),
        ("up malformed", ("malformed.yaml", "not readable as YAML")),
        ("up existing", ("bag", "exists already")),
        ("up clocks", ("/left and /right", "publish_clock")),
        ("up factor", ("real_time_factor", "1e-06")),
    ],
)
def test_wrong_input_is_refused_with_exit_code_2_and_says_what_is_allowed(refusals, name, words):
    code, output = refusals[name]
    assert code == 2, output
    assert all(word in output for word in words), output
    assert "Traceback" not in output
    lines = [line for line in output.splitlines() if line.strip()]
    if name.startswith("up") or name in ("malformed", "no file", "bad name"):
        assert len(lines) == 1, output


@pytest.mark.cold  # the node is found by its command line; forked processes do not free their objects at their end
def test_node_that_is_killed_brings_the_others_down(processes, observer, tmp_path):
    import psutil
    from std_msgs.msg import Float64

    voltages = observer.listen(Float64, "/voltage")
    run = processes.command("up", write_axis(tmp_path / "axis.yaml", held_axis("realtime")))
    until(lambda: len(voltages) > 20, what="the axis to run")
    children = psutil.Process(run.popen.pid).children(recursive=True)
    victim = next(c for c in children if "hysteresis_ros.nodes.motion_controller" in c.cmdline())
    victim.kill()
    assert run.wait() == 1
    assert "/motion_controller was killed by SIGKILL; the other nodes were stopped" in run.output
    assert not any(word in run.output for word in ("Traceback", "terminate called", "Segmentation", "Fatal Python"))
    assert not psutil.wait_procs(children, timeout=LEAVE)[1]
    assert is_safe(voltages[-1].data)


@pytest.fixture(scope="module")
def killed_recorder(tmp_path_factory, domain_of_module):
    """An endless lockstep run whose recorder is killed (SIGKILL)."""
    folder = tmp_path_factory.mktemp("killed")
    processes = Processes(folder, domain_of_module)
    try:
        axis = held_axis("lockstep", partner_timeout=5.0)
        plant = replace(axis.plant_simulator, wait_for_recorder=True)
        axis = replace(axis, plant_simulator=plant, recorder=replace(axis.recorder, path=str(folder / "bag")))
        path = write_axis(folder / "axis.yaml", axis)
        recorder, nodes = processes.node("recorder", path), processes.node("hysteresis_axis", path)
        file = folder / "bag" / "bag.mcap"
        until(lambda: file.exists() and file.stat().st_size > 300_000, what="some chunks on disk")
        recorder.send(signal.SIGKILL)
        code = nodes.wait()
        yield axis, folder / "bag", code, nodes.output
    finally:
        processes.close()


def test_sigkill_of_the_recorder_leaves_a_readable_bag(killed_recorder):
    from hysteresis_ros.loop.simulation import differences
    from hysteresis_ros.recordings.bag_writer import CHUNK_BYTES
    from hysteresis_ros.recordings.files import load_run

    axis, bag, _, output = killed_recorder
    recorded = load_run(bag)
    assert differences(recorded, axis) == {}
    assert recorded.metadata["missing_samples"] == 0
    # The plant is at most `lead` samples ahead of the received ones; an open chunk contains at most these samples of
    # nine messages, each with at least 12 bytes and 31 of its header.
    reached = int(re.search(r"(\d+) samples in", output).group(1))
    assert recorded.time.size >= max(reached - axis.plant_simulator.lead - CHUNK_BYTES / (9 * 43), 150)
    assert np.all(np.diff(recorded.time) > 0)


def test_lockstep_run_ends_when_its_recorder_is_gone(killed_recorder):
    _, _, code, output = killed_recorder
    assert code == 1
    assert "recorder" in output and ("silent" in output or "vanished" in output)
    assert "Traceback" not in output


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="names of threads come from /proc")
def test_no_participant_is_left_for_the_end_of_the_process(processes, tmp_path):
    """A participant that the C library destroys at exit, while its threads run, sometimes aborts the process."""
    axis = axis_parameters(time_mode="lockstep", exit_at_end=True)
    axis = replace(axis, plant_simulator=replace(axis.plant_simulator, samples=50))
    path = write_axis(tmp_path / "axis.yaml", axis)
    command = [sys.executable, "-c", THREADS_LEFT, "--ros-args", "--params-file", path]
    process = processes.start(command, "threads_left")
    assert process.wait() == 0, process.output
    assert process.output.splitlines()[-1] == "left:"


def test_a_recorder_that_leaves_takes_what_a_busy_machine_keeps_waiting(monkeypatch):
    """Its last messages show an axis that moves to its safe voltage; other nodes exit sooner."""
    from types import SimpleNamespace

    from hysteresis_ros.nodes import spin

    heard, left = [], {}

    def node(name, listens_for, waiting):
        runner = SimpleNamespace(leave=int, go_safe=int, exact=False)
        at_exit = {"listens_at_exit": True, "listens_for": listens_for}
        made = SimpleNamespace(active=True, is_fused=True, runner=runner, **at_exit)
        made.wait_acknowledged = lambda deadline: None
        made.tell_health = lambda: None
        made.drained = lambda: len(heard) >= waiting
        made.release = lambda: left.setdefault(name, len(heard))
        return made

    clock = [0.0]
    monkeypatch.setattr(spin, "time", SimpleNamespace(monotonic=lambda: clock[0]))

    def take(timeout_sec):
        clock[0] += timeout_sec  # like an executor that receives nothing
        heard.append(None)
        assert len(heard) < 1000, "the recorder does not exit"

    spin._leave(SimpleNamespace(spin_once=take), [node("recorder", 30.0, 60), node("plant", 0.2, 10**9)], False)
    assert left == {"plant": 60, "recorder": 60}


def test_a_run_is_over_when_one_node_has_failed_or_all_have_finished():
    from types import SimpleNamespace

    from hysteresis_ros.nodes.spin import _over

    def node(failure="", finished=False, parameters=1):
        return SimpleNamespace(failure=failure, finished=finished, parameters=parameters)

    assert not _over([node(), node(finished=True)])
    assert _over([node(finished=True), node(finished=True)])
    assert _over([node(), node("broken")])
    # a node that could not be configured waits for better parameters
    assert not _over([node("not configured", parameters=None), node()])
