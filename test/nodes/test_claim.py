# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One axis, one active publisher: a second node is refused before any motion, and the refusal names the first."""

from __future__ import annotations

import os
import pathlib
import signal
import sys

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from nodes_support import axis_parameters, until, write_axis  # noqa: E402

from hysteresis_ros.errors import HysteresisError  # noqa: E402
from hysteresis_ros.laboratory.campaign import actions  # noqa: E402
from hysteresis_ros.nodes.masters import claim, holder  # noqa: E402

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="claims are Linux's")


def test_a_claim_holds_for_one_name_of_one_domain_until_it_is_closed(domain):
    first = claim(domain, "/left/plant_simulator")
    # the words of the command line tell which program to end
    program = pathlib.Path("/proc/self/cmdline").read_bytes().split(b"\0")[0].decode()
    assert holder(domain, "/left/plant_simulator").startswith(f"process {os.getpid()} ({program}")
    with pytest.raises(HysteresisError, match=rf"/left/plant_simulator already runs in ROS domain {domain}: process"):
        claim(domain, "/left/plant_simulator", patience=0.0)
    for other in ((domain, "/right/plant_simulator"), (domain + 1000, "/left/plant_simulator")):
        assert holder(*other) == ""
        claim(*other, patience=0.0).close()
    first.close()
    claim(domain, "/left/plant_simulator", patience=0.0).close()
    assert holder(domain, "/left/plant_simulator") == ""


def test_the_fault_case_of_a_second_graph_recognises_the_message_of_a_refused_claim(domain):
    with claim(domain, "/left/plant_simulator"), pytest.raises(HysteresisError) as refused:
        claim(domain, "/left/plant_simulator", patience=0.0)
    assert str(refused.value).count(actions.RUNS_ONCE) == 1


def test_a_second_node_of_one_name_is_refused_and_one_that_follows_a_killed_one_is_not(processes, tmp_path):
    path = write_axis(tmp_path / "axis.yaml", axis_parameters(sample_rate=100.0))
    first = processes.node("reference_generator", path)
    until(lambda: "active" in first.output, what="the first node")
    second = processes.node("reference_generator", path)
    assert second.wait() == 2, second.output
    assert "/reference_generator already runs" in second.output and str(first.popen.pid) in second.output
    assert "active" not in second.output and "Traceback" not in second.output and len(second.output.splitlines()) == 1
    first.send(signal.SIGKILL)
    first.wait()
    third = processes.node("reference_generator", path)
    until(lambda: "active" in third.output, what="the node after the one that was killed")
