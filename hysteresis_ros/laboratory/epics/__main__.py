# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Process of ``hysteresis ioc``; its argument is the JSON of :mod:`hysteresis_ros.laboratory.epics.server_process`."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import threading
import time

import rclpy
from rclpy.signals import SignalHandlerOptions

from hysteresis_ros.laboratory.epics.link import AxisLink
from hysteresis_ros.laboratory.epics.record import SILENT, MotorSettings
from hysteresis_ros.laboratory.epics.server import Motor, serve
from hysteresis_ros.nodes.domain import stay_on_this_machine
from hysteresis_ros.nodes.security.policy import RECORDS, enclave_of
from hysteresis_ros.nodes.spin import LOOK, make_executor


def main() -> int:
    """Serve the records that the only argument describes until a signal arrives; return the exit code."""
    request = json.loads(sys.argv[1])
    over = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda signum, frame: over.set())
    stay_on_this_machine()
    rclpy.init(
        args=["--ros-args", "--enclave", enclave_of("", RECORDS)], signal_handler_options=SignalHandlerOptions.NO
    )
    node = rclpy.create_node(RECORDS, start_parameter_services=False)
    executor = make_executor()
    executor.add_node(node)
    settings = [MotorSettings(**motor) for motor in request["motors"]]
    links = [AxisLink(node, motor) for motor in settings]
    hearing = threading.Thread(target=_hear, args=(executor, over), daemon=True)
    hearing.start()
    while request["wait"] and not over.is_set() and any(link.look(time.monotonic()).alarm == SILENT for link in links):
        time.sleep(LOOK)
    try:
        motors = [Motor(motor, link) for motor, link in zip(settings, links, strict=True)]
        names = ", ".join(motor.name for motor in settings)
        asyncio.run(serve(motors, request["interfaces"], over.is_set, lambda: print(f"serving {names}", flush=True)))
    except OSError as error:
        print(f"hysteresis: {' '.join(request['interfaces'])}: cannot listen on it: {error}", file=sys.stderr)
        return 2
    finally:
        over.set()
        hearing.join()
        executor.remove_node(node)
        node.destroy_node()
        rclpy.shutdown()
    return 0


def _hear(executor, over: threading.Event) -> None:
    """Process messages until ``over`` is set; the main function of a thread."""
    while not over.is_set():
        executor.spin_once(timeout_sec=LOOK)


if __name__ == "__main__":
    raise SystemExit(main())
