# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One process whose memory bench_memory.py measures: a node, all four nodes composed, or an empty node.

The process answers every line on its standard input with one line of JSON, and exits when the input ends.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import threading

import common


def bare(arguments) -> None:
    """Run a node without lifecycle, topics or work, with the same messages imported."""
    import diagnostic_msgs.msg  # noqa: F401
    import rcl_interfaces.msg  # noqa: F401
    import rclpy
    import rosgraph_msgs.msg  # noqa: F401
    import sensor_msgs.msg  # noqa: F401
    import std_msgs.msg  # noqa: F401
    import std_srvs.srv  # noqa: F401
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions

    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    node = Node("bare")
    STATE["sample"] = lambda: sys.maxsize
    while not LEAVING.is_set():
        rclpy.spin_once(node, timeout_sec=0.05)
    node.destroy_node()
    rclpy.shutdown()


def nodes(name: str, arguments) -> int:
    """Run one node of the axis, or all of them in this process."""
    from importlib import import_module

    from hysteresis_ros.configuration import NODE_NAMES
    from hysteresis_ros.nodes.spin import run

    def factory(node_name):
        words = "".join(word.title() for word in node_name.split("_"))
        made = getattr(import_module(f"hysteresis_ros.nodes.{node_name}"), f"{words}Node")()
        STATE["sample"] = lambda: made.sample if made.active else -1
        return made

    names = NODE_NAMES if name == "all" else (name,)
    return run([lambda node_name=node_name: factory(node_name) for node_name in names], arguments)


#: Function that returns the number of finished samples; -1 before the first.
STATE = {"sample": lambda: -1}
LEAVING = threading.Event()


def answer() -> None:
    """Answer lines until the input ends, then exit as after Ctrl-C."""
    for _ in sys.stdin:
        found = {
            "sample": STATE["sample"](),
            "megabytes": common.resident_megabytes(),
            "modules": sorted(name for name, module in list(sys.modules.items()) if module is not None),
        }
        print(json.dumps(found), flush=True)
    LEAVING.set()
    os.kill(os.getpid(), signal.SIGINT)


def main() -> int:
    """Run the process; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("node")
    parser.add_argument("--without-numba", action="store_true")
    options, ros_arguments = parser.parse_known_args()
    if options.without_numba:
        sys.modules["numba"] = None  # imports then fail as if Numba were not installed
    signal.signal(signal.SIGINT, lambda number, frame: None)
    threading.Thread(target=answer, daemon=True).start()
    arguments = ["benchmark", *ros_arguments]
    if options.node == "bare":
        bare(arguments)
        return 0
    return nodes(options.node, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
