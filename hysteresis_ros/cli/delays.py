# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Settings of this machine that delay a loop: the state of each setting, the delay it costs, the command to change it.

The cost is measured with the fused loop at :data:`RATE`, a rate at which a short run shows the delay.
"""

from __future__ import annotations

import contextlib
import os
import pathlib
import platform
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.loop.fused import shallow_sleep
from hysteresis_ros.loop.pacing import Lateness

#: Rate of the loop in the measurements [Hz].
RATE = 3e3
#: Duration of a run of this loop [s].
SECONDS = 0.5
#: Rate of the run that polls the clock all the time [Hz].
WHOLE_RATE = 1e4
#: Duration of the run that polls the clock all the time [s]; longer than a period of throttling.
WHOLE_SECONDS = 1.5
#: Largest number of cores that are measured individually.
MOST_CORES = 4
#: Folder of the system with the settings of the processors.
PROCESSORS = pathlib.Path("/sys/devices/system/cpu")
#: Folder of the system with all other settings.
PROC = pathlib.Path("/proc")

NOT_MEASURED = "not measured"

#: Function that runs the loop and returns its lateness. Arguments: ``spin`` [s], ``cpu`` (-1: any core), ``whole``
#: (whether the loop polls the clock all the time).
Run = Callable[..., Lateness]


@dataclass(frozen=True)
class Delay:
    """A setting of the machine that delays a loop."""

    name: str
    state: str  #: Present value of the setting.
    cost: str  #: Cost of the setting, as measured on this machine, or :data:`NOT_MEASURED` with the reason.
    change: str  #: The command that changes the setting; empty if no change is needed.


def _text(path: pathlib.Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return ""


def _late(found: Lateness) -> str:
    return f"{1e6 * found.p50:.0f} / {1e6 * found.p99:.0f} µs"


def cores_of(text: str) -> list[int]:
    """Return the cores in a core list of the kernel, such as ``0,2-3``."""
    found: list[int] = []
    for part in filter(None, text.split(",")):
        first, _, last = part.partition("-")
        found += range(int(first), int(last or first) + 1)
    return found


def _usable() -> list[int]:
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []


def _interrupts() -> dict[int, int]:
    """Return the number of interrupts since boot, by core."""
    head, *lines = _text(PROC / "interrupts").splitlines() or [""]
    cores = [int(name.removeprefix("CPU")) for name in head.split()]
    counts = dict.fromkeys(cores, 0)
    for line in lines:
        for core, word in zip(cores, line.partition(":")[2].split(), strict=False):
            counts[core] += int(word) if word.isdigit() else 0
    return counts


def delays(run: Run) -> Iterator[Delay]:
    """Yield all settings, each as soon as its cost is measured."""
    yield _looking(run)
    by_core, rates = _by_core(run)
    yield _isolated(by_core)
    yield _interrupted(by_core, rates)
    yield _sleep_states(run)
    yield _governor()
    yield _siblings(run)
    yield _throttling(run)
    yield _preemption(by_core)


def _looking(run: Run) -> Delay:
    """Return the setting for polling the clock ahead of deadlines, with its measured effect."""
    without, with_it = run(spin=0.0), run(spin=-1.0)
    state = "off: no priority, or no core to spare"
    if with_it.ahead:
        state = f"from {1e6 * with_it.ahead:.0f} µs before a deadline, {100.0 * with_it.looked * RATE:.2g} % of a core"
    cost = f"lateness {_late(without)} without it, {_late(with_it)} with it"
    return Delay("polls the clock", state, cost, "" if with_it.ahead else "see the advice at the end")


def _by_core(run: Run) -> tuple[dict[int, Lateness], dict[int, float]]:
    """Return the lateness of a run on each core, and the interrupts per second on this core meanwhile."""
    by_core, rates = {}, {}
    for core in _usable()[:MOST_CORES]:
        before = _interrupts().get(core)
        by_core[core] = run(spin=0.0, cpu=core)
        if before is not None:
            rates[core] = (_interrupts()[core] - before) / SECONDS
    return by_core, rates


def _isolated(by_core: dict[int, Lateness]) -> Delay:
    isolated = _text(PROCESSORS / "isolated")
    cost = ", ".join(f"core {core} {_late(late)}" for core, late in by_core.items())
    last = max(_usable(), default=0)
    change = ""
    if not isolated:
        rest = f"0-{last - 1}" if last > 1 else "0"
        change = f"kernel command line: isolcpus={last} nohz_full={last} irqaffinity={rest}; then realtime.cpu: {last}"
        if last < 1:
            change = "a second core is needed"
    return Delay("isolated cores", isolated or "none", f"lateness on {cost}" if cost else NOT_MEASURED, change)


def _interrupted(by_core: dict[int, Lateness], rates: dict[int, float]) -> Delay:
    lists = {path.parent.name: _text(path) for path in PROC.glob("irq/[0-9]*/smp_affinity_list")}
    last = max(_usable(), default=0)
    there = sorted(int(number) for number, cores in lists.items() if last in cores_of(cores))
    state = f"{len(there)} of {len(lists)} may go to core {last}"
    cost = ", ".join(f"core {core} {rate:.0f} per s" for core, rate in rates.items())
    change = ""
    if there and last:
        tee = f"echo 0 | tee {PROC}/irq/*/smp_affinity_list"
        change = f"as root: {tee}, and stop irqbalance; then set realtime.cpu: {last}"
    measured = f"{cost}; for the lateness see the row 'isolated cores'" if cost else NOT_MEASURED
    return Delay("interrupts", state, measured, change)


def _sleep_states(run: Run) -> Delay:
    states = [
        f"{_text(path / 'name')} {_text(path / 'latency')} µs"
        for path in sorted(PROCESSORS.glob("cpu0/cpuidle/state*"))
        if _text(path / "disable") != "1"
    ]
    driver = _text(PROCESSORS / "cpuidle" / "current_driver")
    state = f"{', '.join(states)} ({driver})" if states else "not known (a virtual machine?)"
    change = "realtime.spin holds /dev/cpu_dma_latency at 0 while a loop runs; for all programs: cpupower idle-set -D 1"
    before = run(spin=0.0)
    with shallow_sleep() as held:
        cost = f"{NOT_MEASURED}: /dev/cpu_dma_latency is not permitted"
        if held:
            cost = f"lateness {_late(before)}, with deep states off {_late(run(spin=0.0))}"
        else:
            change = (
                'a udev rule, KERNEL=="cpu_dma_latency", GROUP="realtime", MODE="0660"; then realtime.spin holds '
                "/dev/cpu_dma_latency at 0 while a loop runs"
            )
    return Delay("sleep states", state, cost, change if states else "")


def _governor() -> Delay:
    governor = _text(PROCESSORS / "cpu0" / "cpufreq" / "scaling_governor")
    change = "" if governor in ("", "performance") else "as root: cpupower frequency-set -g performance"
    why = f"{NOT_MEASURED}: this would require a change of the governor" if change else "nothing"
    return Delay("frequency governor", governor or "none (the host decides)", why, change)


def _siblings(run: Run) -> Delay:
    lists = {_text(path) for path in PROCESSORS.glob("cpu[0-9]*/topology/thread_siblings_list")}
    pairs = sorted((cores_of(text) for text in lists if len(cores_of(text)) > 1), key=lambda pair: pair[0])
    if not pairs:
        return Delay("SMT siblings", "none", "nothing", "")
    state = ", ".join("+".join(map(str, pair)) for pair in pairs)
    core, other = pairs[-1][:2]
    if not {core, other} <= {*_usable()}:
        return Delay("SMT siblings", state, f"{NOT_MEASURED}: this process may not use both", "")
    alone = run(spin=0.0, cpu=core)
    with _busy(other):
        beside = run(spin=0.0, cpu=core)
    cost = f"a sample takes {1e6 * alone.cost:.2f} µs, with a busy sibling {1e6 * beside.cost:.2f} µs"
    change = f"as root: echo 0 > {PROCESSORS}/cpu{other}/online; then realtime.cpu: {core}"
    return Delay("SMT siblings", state, cost, change)


@contextlib.contextmanager
def _busy(core: int):
    """Keep a core busy with another process."""
    work = f"import os\nos.sched_setaffinity(0, {{{core}}})\nwhile True: pass"
    with subprocess.Popen([sys.executable, "-c", work]) as process:
        try:
            yield
        finally:
            process.kill()


def _throttling(run: Run) -> Delay:
    runtime, period = (_text(PROC / "sys" / "kernel" / f"sched_rt_{name}_us") for name in ("runtime", "period"))
    if not runtime:
        return Delay("real-time throttling", "not known", NOT_MEASURED, "")
    if runtime == "-1":
        return Delay("real-time throttling", "off", "nothing", "")
    change = "only for a loop that uses an isolated core all the time, as root: sysctl kernel.sched_rt_runtime_us=-1"
    state = f"{runtime} of {period} µs"
    try:
        whole = run(whole=True)
    except ConfigurationError:  # a running axis already uses the only spare core
        return Delay("real-time throttling", state, f"{NOT_MEASURED}: another loop polls the clock", change)
    cost = (
        f"a loop that never sleeps was interrupted for {1e3 * whole.max:.1f} ms at most, "
        f"{100.0 * whole.missed / whole.samples:.1f} % of its samples skipped"
    )
    if not whole.looked:
        cost = f"{NOT_MEASURED}: no priority, or no core to spare"
    return Delay("real-time throttling", state, cost, change)


def _preemption(by_core: dict[int, Lateness]) -> Delay:
    if _text(pathlib.Path("/sys/kernel/realtime")) == "1" or re.search("PREEMPT_RT", platform.version()):
        return Delay("PREEMPT_RT", "yes", "nothing", "")
    cost = f"{NOT_MEASURED}: it needs another kernel"
    if by_core:
        cost += f"; largest lateness here {1e6 * max(late.max for late in by_core.values()):.0f} µs"
    return Delay(
        "PREEMPT_RT", "no", cost, "Ubuntu: pro enable realtime-kernel; Debian: apt install linux-image-rt-amd64"
    )


def lines_of(delay: Delay) -> Iterator[str]:
    """Yield the lines about a setting; its name is in the first column."""
    width = 22
    yield f"  {delay.name:{width}}{delay.state}"
    yield f"  {'':{width}}{delay.cost}"
    if delay.change:
        yield f"  {'':{width}}→ {delay.change}"
