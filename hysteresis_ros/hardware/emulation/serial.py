# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An emulated device behind a serial port: a pseudo terminal, whose other end any program opens as a port."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator

from hysteresis_ros.hardware.emulation.faults import DeviceFaults, Garbler
from hysteresis_ros.hardware.emulation.server import TICK, Session


@contextlib.contextmanager
def serving_serial(session: Session, tick: Callable[[], None], faults: DeviceFaults) -> Iterator[str]:
    """Serve an emulated device from a thread of its own, as long as the context lasts; give the path of its port.

    Parameters
    ----------
    session : Session
        What is said to whoever opens the port.
    tick : callable
        Lets the device's time go on.
    faults : DeviceFaults
    """
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    leaving, garbler = threading.Event(), Garbler(faults)

    def serve() -> None:
        while not leaving.is_set():
            tick()
            if not select.select([ours], [], [], TICK)[0]:
                continue
            data = os.read(ours, 65536)
            if "cut" in faults:
                continue
            answer, late = session.feed(data), faults.value("slow")
            if late is not None and answer:
                time.sleep(late)
            if answer and "silent" not in faults:
                os.write(ours, garbler.garble(answer))  # a port has no link that could be closed

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield os.ttyname(theirs)
    finally:
        leaving.set()
        thread.join()
        os.close(ours)
        os.close(theirs)
