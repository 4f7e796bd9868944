# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a machine has that an axis in real time needs, and what to do where something is missing."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import pathlib
import platform
import subprocess
import sys

#: Libraries, and the extra of this package that brings each, empty: always.
LIBRARIES = {
    "numpy": "",
    "scipy": "",
    "numba": "fast",
    "rosbags": "",
    "mcap": "",
    "ros-jazzy-rclpy": "ros",
    "ros-jazzy-common-interfaces": "ros",
    "matplotlib": "report",
    "jinja2": "report",
    "rich": "progress",
}
#: Modules of those that also come without a wheel, with ROS 2 from apt.
MODULES = {"ros-jazzy-rclpy": "rclpy", "ros-jazzy-common-interfaces": "sensor_msgs"}
#: Priority that a fused loop asks for by default.
PRIORITY = 80
#: Longest wait for the name of the middleware [s].
PATIENCE = 10.0
#: Asks rclpy in a process of its own: it is loaded nowhere but in nodes.
ASK_MIDDLEWARE = "from rclpy.utilities import get_rmw_implementation_identifier as name; print(name())"


def versions() -> dict[str, str]:
    """Return the version of each library; 'not installed' where there is none."""
    found = {}
    for name in LIBRARIES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            there = importlib.util.find_spec(MODULES.get(name, name)) is not None
            found[name] = "from ROS 2" if there else "not installed"
    found |= {
        name: distribution.version
        for distribution in importlib.metadata.distributions()
        if "rmw" in (name := distribution.metadata["Name"] or "") and name.endswith("cpp")
    }
    return found


def middleware() -> str:
    """Return what carries the messages, such as rmw_fastrtps_cpp; empty without ROS."""
    if importlib.util.find_spec("rclpy") is None:
        return ""
    try:
        command = [sys.executable, "-c", ASK_MIDDLEWARE]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip()


def _limit(name: str) -> int | None:
    """Return the soft limit of this process; -1: none, None: unknown here."""
    try:
        import resource
    except ImportError:  # no Unix
        return None
    kind = getattr(resource, name, None)
    if kind is None:
        return None
    soft = resource.getrlimit(kind)[0]
    return -1 if soft == resource.RLIM_INFINITY else soft


def _text(path: str) -> str:
    try:
        return pathlib.Path(path).read_text(encoding="utf-8").strip()
    except OSError:
        return ""


def system() -> dict:
    """Return what the operating system is and permits."""
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)
    return {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
        "preempt_rt": _text("/sys/kernel/realtime") == "1",
        "cores": len(cores),
        "load": os.getloadavg()[0],
        "governor": _text("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor") or "unknown",
        "rtprio": _limit("RLIMIT_RTPRIO"),
        "memlock_bytes": _limit("RLIMIT_MEMLOCK"),
    }


def kernel_cache() -> dict:
    """Return where machine code is kept, and how many bytes it takes."""
    from hysteresis_ros.block import COMPILED, cache_folder

    if not COMPILED:
        return {"folder": None, "bytes": 0}
    folder = pathlib.Path(os.environ.get("NUMBA_CACHE_DIR") or cache_folder())
    return {"folder": str(folder), "bytes": sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())}


def advice(found: dict, permitted: bool) -> list[str]:
    """Return a line for each thing that is missing: what it is for, and what to do.

    Parameters
    ----------
    found : dict
        With ``libraries``, ``system`` and ``middleware``.
    permitted : bool
        Whether a thread got its priority.
    """
    lines, system_ = [], found["system"]
    extras: dict[str, list[str]] = {}
    for name, version in found["libraries"].items():
        if version == "not installed":
            extras.setdefault(LIBRARIES[name], []).append(name)
    for extra, names in extras.items():
        what = f"hysteresis_ros[{extra}]" if extra else "hysteresis_ros"
        lines.append(f'{" and ".join(names)} missing: pip install "{what}"')
    if not permitted:
        lines.append(
            f"no priority for the loop: a line '@GROUP - rtprio {PRIORITY}' in /etc/security/limits.conf and a new "
            "login, or CAP_SYS_NICE"
        )
    if system_["cores"] < 2:
        lines.append("one core: whatever else runs keeps the loop waiting; give it a second one (realtime.cpu)")
    if system_["governor"] not in ("performance", "unknown"):
        lines.append(
            f"governor {system_['governor']}: cores sleep deeply; choose 'performance' (cpupower frequency-set)"
        )
    return lines
