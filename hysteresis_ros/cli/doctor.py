# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis doctor``: measure the real-time rates of this machine, and report missing software and remedies."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import pathlib
import platform
import subprocess
import sys
import time
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import click

from hysteresis_ros.cli.progress import Progress

if TYPE_CHECKING:
    from hysteresis_ros.loop.pacing import Lateness
    from hysteresis_ros.nodes.trial import Answers

#: Libraries, and the extra of this package that installs each; empty: always installed.
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
#: Libraries that a ROS 2 installation from apt also provides: library → module.
MODULES = {"ros-jazzy-rclpy": "rclpy", "ros-jazzy-common-interfaces": "sensor_msgs"}
#: Priority that a fused loop requests by default.
PRIORITY = 80
#: Longest wait for the name of the middleware [s].
PATIENCE = 10.0
#: Program that asks rclpy for the middleware, in a separate process because only nodes import rclpy.
ASK_MIDDLEWARE = "from rclpy.utilities import get_rmw_implementation_identifier as name; print(name())"


def versions() -> dict[str, str]:
    """Return the version of each library, or 'not installed'."""
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
    """Return the middleware, such as rmw_fastrtps_cpp; empty without ROS."""
    if importlib.util.find_spec("rclpy") is None:
        return ""
    try:
        command = [sys.executable, "-c", ASK_MIDDLEWARE]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip()


def _limit(name: str) -> int | None:
    """Return a soft limit of this process; -1: unlimited; None: unknown on this system."""
    try:
        import resource
    except ImportError:  # not a Unix system
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
    """Return the operating system and its limits."""
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
    """Return the folder and the size [bytes] of the machine code cache."""
    from hysteresis_ros.models.block import COMPILED, cache_folder

    if not COMPILED:
        return {"folder": None, "bytes": 0}
    folder = pathlib.Path(os.environ.get("NUMBA_CACHE_DIR") or cache_folder())
    return {"folder": str(folder), "bytes": sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())}


def advice(found: dict, permitted: bool) -> list[str]:
    """Return a line for each missing item: its purpose, and the remedy."""
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
            f"no priority for the loop: add a line '@GROUP - rtprio {PRIORITY}' to /etc/security/limits.conf and log "
            "in again, or grant CAP_SYS_NICE"
        )
    if system_["cores"] < 2:
        lines.append("one core: any other process delays the loop; add a second core (realtime.cpu)")
    if system_["governor"] not in ("performance", "unknown"):
        lines.append(
            f"governor {system_['governor']}: cores sleep deeply; choose 'performance' (cpupower frequency-set)"
        )
    return lines


#: Rates of the fused loop that are tested [Hz].
RATES = (1e3, 3e3, 1e4, 2e4, 5e4)
#: Duration of the test of one rate [s].
SECONDS = 0.8
#: Number of samples of the lockstep run of nodes that exchange messages, if they are composed in one process.
COMPOSED = 1000
#: Number of samples of the same run if each node is a process.
PROCESSES = 600
#: Rate of the real-time run of nodes that exchange messages [Hz].
MESSAGE_RATE = 300.0
#: Number of samples of this real-time run.
ANSWERED = 300
#: Fraction of skipped samples above which higher rates are not tested.
HOPELESS = 0.1
#: Time after which no further measurement of nodes starts [s]; the first run of a version takes long, because kernels
#: are compiled.
BUDGET = 35.0


@click.command(short_help="Measure the rates of this machine, and list missing software and permissions.")
@click.option(
    "--json", "path", metavar="FILE", type=click.Path(path_type=pathlib.Path), help="JSON file for all results."
)
def doctor(path: pathlib.Path | None) -> None:
    """Measure the rates at which this machine runs an axis and how late samples begin; list versions and limits.

    A fused axis runs at 1, 3, 10, 20 and 50 kHz, with priority and without; a rate is held when 99 % of the samples
    begin within half a period and fewer than 0.5 % are skipped. For each setting of the machine that delays a loop, it
    prints the state, the cost, and the command that changes it. For nodes, composed and as processes, it prints the
    samples per second in lockstep and, in real time at 300 Hz, the time from a measurement to its voltage and the
    number of late voltages.
    """
    if path is not None and not path.absolute().parent.is_dir():
        raise click.UsageError(f"--json {path}: the folder does not exist; choose another one")
    begun = time.monotonic()
    progress = Progress(steady=True)
    progress.say("rates that this machine achieves (Kim's axis, simulated); the measurement takes up to a minute")
    with progress.during("checking the installation"):
        found: dict = {"system": system(), "libraries": versions(), "middleware": middleware()}
    for line in _installed(found):
        progress.say(line)
    found["fused"] = _fused(progress)
    found["messages"] = _messages(progress, found["libraries"], begun + BUDGET)
    found["delays"] = _delays(progress) if found["fused"] else []
    found["kernel_cache"] = kernel_cache()
    cache = found["kernel_cache"]
    if cache["folder"]:
        progress.say(f"machine code: {cache['folder']}, {cache['bytes'] / 1e6:.1f} MB")
    permitted = not any(entry["priority"] and entry["warning"] for entry in found["fused"])
    found["advice"] = advice(found, permitted)
    for line in found["advice"] or ["nothing is missing"]:
        progress.say(line)
    if path is not None:
        _write(found, path)
        progress.say(f"figures: {path}")


def _installed(found: dict):
    """Yield lines on versions and limits."""
    system = found["system"]
    yield f"Python {system['python']}, {system['system']}{', PREEMPT_RT' if system['preempt_rt'] else ''}"
    yield ", ".join(f"{name} {version}" for name, version in found["libraries"].items())
    yield f"DDS: {found['middleware'] or 'none: no ROS is installed'}"
    limits = {"rtprio": system["rtprio"], "memlock": system["memlock_bytes"]}
    words = {None: "unknown", -1: "unlimited"}
    shown = ", ".join(f"{name} {words.get(value, value)}" for name, value in limits.items())
    yield f"{system['cores']} cores, load {system['load']:.1f}, governor {system['governor']}, {shown}"


def _axis(rate: float):
    """Return Kim's axis at another rate; its dynamics do not affect the computing time."""
    from hysteresis_ros.configuration import config_path, load_configuration
    from hysteresis_ros.loop.reach import axes

    configuration = load_configuration(config_path("kim2009")).override("", sample_rate=rate, exit_at_end=True)
    configuration = configuration.override("plant_simulator", dynamics__sample_time=0.0)
    configuration = configuration.override("motion_controller", model__dynamics__sample_time=0.0)
    return axes(configuration)[0]


# -- one compiled loop -------------------------------------------------------------------------------------------


def _fused(progress: Progress) -> list[dict]:
    """Return the results of a fused loop at each rate, with priority and without."""
    from hysteresis_ros.models.block import COMPILED

    if not COMPILED:
        from hysteresis_ros.loop.fused import INTERPRETED_RATE

        progress.say(f"fused: {INTERPRETED_RATE:g} Hz at most without Numba; nothing was measured")
        return []
    from hysteresis_ros.loop.fused import LATEST, MOST_SKIPPED, tick_cost

    with progress.during("compiling the loop, once for this version"):
        cost = tick_cost(_axis(RATES[0]))
    progress.say(
        f"fused, a sample takes {1e6 * cost:.2f} µs; held: 99 % of them begin within {LATEST:g} of a period, "
        f"fewer than {100.0 * MOST_SKIPPED:g} % are skipped"
    )
    rows = []
    for priority in (PRIORITY, 0):
        made = []
        how = f"with SCHED_FIFO {priority}" if priority else "with normal priority"
        progress.say(f"fused {how}")
        for rate in RATES:
            with progress.during(f"{rate:g} Hz"):
                made.append(_trial(rate, priority))
            progress.say(_row(made[-1]))
            if made[-1]["warning"]:
                break  # the priority was not granted; this round would repeat the round with normal priority
            if made[-1]["skipped"] > HOPELESS * made[-1]["samples"]:
                break
        held = max((row["rate_hz"] for row in made if row["held"]), default=0.0)
        words = f"holds {held:g} Hz" if held else "holds none of these rates at present"
        if made[-1]["warning"]:
            words = f"not permitted: {made[-1]['warning']}"
        progress.say(f"  = {words}")
        rows += made
    return rows


def _trial(rate: float, priority: int) -> dict:
    from hysteresis_ros.loop.fused import trial

    done = trial(_axis(rate), SECONDS, priority)
    late = done.lateness
    return {
        "rate_hz": rate,
        "priority": priority,
        "held": done.is_held and not done.warning,
        "warning": done.warning,
        "samples": late.samples,
        "skipped": late.missed,
        "lateness_s": {"p50": late.p50, "p99": late.p99, "p99.9": late.p999, "max": late.max},
        "cost_s": late.cost,
        "spin_s": late.ahead,
        "spin_of_a_core": late.looked * rate,
    }


def _row(row: dict) -> str:
    late = ", ".join(f"{name} {1e6 * value:.0f}" for name, value in row["lateness_s"].items())
    part = 100.0 * row["skipped"] / row["samples"]
    verdict = "held" if row["held"] else "not held"
    if row["spin_s"]:
        verdict += f"; polls from {1e6 * row['spin_s']:.0f} µs before, {100.0 * row['spin_of_a_core']:.2g} % of a core"
    return f"  {row['rate_hz']:>6g} Hz: late {late} µs; {row['skipped']} skipped ({part:.2g} %): {verdict}"


def _delays(progress: Progress) -> list[dict]:
    """Return the settings of this machine that delay a loop."""
    from hysteresis_ros.cli import delays

    progress.say(
        "what delays a loop here: state, cost, → change (lateness p50 / p99 at "
        f"{delays.RATE:g} Hz, {delays.SECONDS:g} s each, load {os.getloadavg()[0]:.1f})"
    )
    rows: list[dict] = []
    settings = delays.delays(_delayed)
    while True:
        with progress.during("what delays a loop"):
            delay = next(settings, None)
        if delay is None:
            return rows
        rows.append(asdict(delay))
        for line in delays.lines_of(delay):
            progress.say(line)


def _delayed(spin: float = -1.0, cpu: int = -1, whole: bool = False) -> Lateness:
    """Run the loop for a short time, and return its lateness; ``spin`` [s]."""
    from hysteresis_ros.cli import delays
    from hysteresis_ros.loop.fused import trial

    rate, seconds = (delays.WHOLE_RATE, delays.WHOLE_SECONDS) if whole else (delays.RATE, delays.SECONDS)
    axis = _axis(rate)
    plant = axis.plant_simulator
    realtime = replace(plant.realtime, spin=1.0 / rate if whole else spin, cpu=cpu)
    axis = replace(axis, plant_simulator=replace(plant, realtime=realtime))
    return trial(axis, seconds, PRIORITY).lateness


# -- nodes that exchange messages --------------------------------------------------------------------------------


def _messages(progress: Progress, libraries: dict, latest: float) -> dict:
    """Return rates in lockstep and response times in real time, of composed nodes and of processes."""
    import importlib.util

    if importlib.util.find_spec("rclpy") is None or libraries["rosbags"] == "not installed":
        progress.say("nodes: not measured, rclpy or rosbags is not installed")
        return {}
    from hysteresis_ros.nodes.trial import Trial

    axis = _axis(3e3)
    found: dict[str, dict] = {}
    for name, samples, composed in (("composed", COMPOSED, True), ("processes", PROCESSES, False)):
        if time.monotonic() > latest:
            progress.say(f"nodes, {name}: not measured, because compilation took too long; run the command again")
            continue
        with progress.during(f"nodes, {name}"):
            found[name] = {"lockstep_hz": Trial(axis, samples, composed).message_rate()}
        progress.say(f"nodes, {name}: {found[name]['lockstep_hz']:.0f} samples a second in lockstep, recorded")
        with progress.during(f"nodes, {name}, in real time"):
            took = Trial(_axis(MESSAGE_RATE), ANSWERED, composed).answers()
        found[name]["realtime"] = asdict(took)
        progress.say(f"nodes, {name}, in real time at {took.rate:g} Hz: {_answered(took)}")
    return found


def _answered(took: Answers) -> str:
    """Return a line about the response times of nodes."""
    if took.p50 is None or took.p99 is None or took.max is None:
        return f"none of {took.samples} measurements was answered; the machine is too slow or too busy"
    late = f"{took.late} of {took.samples} voltages late ({100.0 * took.late / max(took.samples, 1):.2g} %)"
    return f"answered after p50 {1e3 * took.p50:.2g}, p99 {1e3 * took.p99:.2g}, max {1e3 * took.max:.2g} ms; {late}"


def _write(found: dict, path: pathlib.Path) -> None:
    import json

    from hysteresis_ros.errors import ConfigurationError

    text = json.dumps(found, indent=2, ensure_ascii=False, allow_nan=False)
    try:
        path.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}; choose another place") from None
