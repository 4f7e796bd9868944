# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Experiments with the nodes: the same bits as offline, and errors that name the run."""

from __future__ import annotations

import contextlib
import gc
import importlib.util
import itertools
import json
import os
import pathlib
import signal
import socket
import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner

from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.laboratory.papers import runs
from hysteresis_ros.laboratory.papers.claims import Claim, Reproduction
from hysteresis_ros.laboratory.papers.kim2009 import axis as kim
from hysteresis_ros.laboratory.papers.kim2009 import reproduction as kim2009
from hysteresis_ros.laboratory.papers.runs import step_figures, through
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.nodes import domain as domains
from hysteresis_ros.nodes.domain import OWN, Domain, entered, require_admission
from hysteresis_ros.nodes.launcher import Graph, GraphError, node_environment

HOLD = 0.02  # s


def small_axis():
    return kim.estimating(kim.real(load_configuration("kim2009"), kim.MISMATCH))


def small_experiment() -> Reproduction:
    """Two rows of one short run."""
    figures = step_figures(kim.run_steps(small_axis(), HOLD))
    rows = [
        Claim(name, "g", "q", getattr(figures, name), "m", assumptions=("a",), high=1e-8)
        for name in ("peak", "residual")
    ]
    return Reproduction("small", "t", tuple(rows), {})


@pytest.fixture
def ros():
    pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")


def test_a_run_through_the_nodes_has_every_signal_of_a_simulation_bit_for_bit(ros):
    offline = kim.run_steps(small_axis(), HOLD)
    seen = []
    runner = runs.GraphRunner(lambda number, known, axis: seen.append((number, known)))
    with through(runner):
        online = kim.run_steps(small_axis(), HOLD)
        again = kim.run_steps(small_axis(), HOLD)
    assert seen == [(1, 1)] and again is online
    assert online.signals.keys() == offline.signals.keys()
    assert np.array_equal(online.time, offline.time)
    different = [name for name in offline.signals if offline[name].tobytes() != online[name].tobytes()]
    assert not different
    assert online.metadata["configuration"] == offline.metadata["configuration"]


def test_runs_side_by_side_keep_their_own_numbers(ros):
    axes = [single_axis(kim.open_loop(small_axis())).with_duration(0.01 * count) for count in (1, 2)]
    runner = runs.GraphRunner()
    runner.prepare([*axes, axes[0]], jobs=2)
    assert runner.runs == 2
    for axis in axes:
        assert runner(axis)["displacement"].tobytes() == simulate(axis)["displacement"].tobytes()
    assert runner.runs == 2


def test_both_ways_write_the_same_json_but_for_the_way(ros, monkeypatch):
    monkeypatch.setattr(kim2009, "reproduce", small_experiment)
    found = {}
    for way in ("offline", "ros"):
        result = CliRunner().invoke(main, ["reproduce", "kim2009", "--through", way, "--json", "-"])
        assert result.exit_code == 0, result.output
        found[way] = json.loads(result.stdout)
        assert found[way].pop("through") == way
    assert found["offline"] == found["ros"]


def test_an_error_names_the_run(monkeypatch):
    class Broken:
        def __init__(self, *arguments, **options):
            raise GraphError("/plant_simulator was killed by SIGKILL; the other nodes were stopped", 1)

    monkeypatch.setattr(runs, "require_ros", lambda: None)
    monkeypatch.setattr(runs, "Graph", Broken)
    monkeypatch.setattr(kim2009, "reproduce", small_experiment)
    result = CliRunner().invoke(main, ["reproduce", "kim2009", "--through", "ros"])
    assert result.exit_code == 1
    line = result.output.splitlines()[-1]
    assert "run 1 (controller sliding_mode, inverse exact, waveform steps, 270 samples)" in line
    assert "killed by SIGKILL" in line


@pytest.fixture
def started(monkeypatch):
    """The graphs that a command started, without their processes."""
    graphs = []
    monkeypatch.setattr(Graph, "start", lambda self: graphs.append(self))
    monkeypatch.setattr(Graph, "stop", lambda self: None)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield graphs
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize(
    ("name", "words", "mode"),
    [
        ("kim2009", (), "fused"),
        ("steering_mirror", (), "fused"),
        ("kim2009", ("--factor", "0.1"), "realtime"),
        ("kim2009", ("--processes",), "realtime"),
        ("kim2009", ("--rate", "lockstep"), "lockstep"),
        ("picma_stage", (), "realtime"),
    ],
)
def test_what_is_too_fast_for_messages_is_started_fused_unless_another_way_is_asked_for(started, name, words, mode):
    result = CliRunner().invoke(main, ["up", name, *words])
    assert result.exit_code == 0, result.output
    (graph,) = started
    assert {axis.plant_simulator.time_mode for axis in graph.axes} == {mode}
    assert ("fused, one process: " in result.output) == (mode == "fused")


def test_without_ros_one_line_says_what_to_install(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "rclpy" else find(name))
    result = CliRunner().invoke(main, ["reproduce", "kim2009", "--through", "ros"])
    assert result.exit_code == 2
    assert 'pip install "hysteresis_ros[ros]"' in result.output and "Traceback" not in result.output


@pytest.mark.parametrize("number", [0, 10, 119])
def test_a_domain_with_a_participant_is_left_alone(monkeypatch, number):
    with Domain() as claimed:
        first = claimed.number
    turn = domains.DOMAINS.index(first)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("", 7400 + 250 * first + 10 + 2 * number))
        monkeypatch.setattr(domains, "_turns", itertools.count(turn - os.getpid()))
        with Domain() as claimed:
            assert claimed.number != first


def test_no_two_claim_a_domain_and_nobody_that_of_the_caller(monkeypatch):
    script = "from hysteresis_ros.nodes.domain import Domain; made = Domain(); print(made.number, flush=True); input()"
    gc.collect()  # nodes of earlier tests
    with contextlib.ExitStack() as stack:
        others = []
        for _ in range(2):
            command = [sys.executable, "-c", script]
            pipes = dict(stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            others.append(stack.enter_context(subprocess.Popen(command, env=node_environment(), **pipes)))
        found = [int(other.stdout.readline()) for other in others]
        found += [stack.enter_context(Domain()).number for _ in range(2)]
        assert len(set(found)) == 4 and 0 not in found
        with Domain() as free:
            monkeypatch.setenv("ROS_DOMAIN_ID", str(free.number))
        assert Domain().number != free.number
        for other in others:
            other.communicate("")


def test_nobody_joins_a_graph_of_its_own_and_no_user_has_such_a_domain(monkeypatch):
    with Domain() as claimed:
        assert not 0 <= claimed.number <= 101
        ports = pathlib.Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()
        assert 7400 + 250 * claimed.number > int(ports[1])
        monkeypatch.delenv(OWN, raising=False)
        with pytest.raises(HysteresisError, match=f"ROS domain {claimed.number} is in use by a demonstration"):
            require_admission(claimed.number)
        require_admission(7)
        monkeypatch.setenv(OWN, claimed.environment[OWN])
        require_admission(claimed.number)
        monkeypatch.delenv(OWN)
    require_admission(claimed.number)


def test_a_graph_of_its_own_has_its_domain_only_as_long_as_it_runs(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE", raising=False)
    with entered() as domain:
        assert os.environ["ROS_DOMAIN_ID"] == str(domain.number) != "7"
    assert os.environ["ROS_DOMAIN_ID"] == "7" and "ROS_AUTOMATIC_DISCOVERY_RANGE" not in os.environ


def test_nodes_import_nothing_from_the_current_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert node_environment()["PYTHONSAFEPATH"] == "1"
    assert str(tmp_path) not in node_environment().get("PYTHONPATH", "")
