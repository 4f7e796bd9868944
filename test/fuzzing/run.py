# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Fuzz every reader for a long time: ``python test/fuzzing/run.py --inputs 1000000``; the tests run a part of it.

Each reader runs in a separate process with limited memory and limited time per input; an input that ends or hangs the
process is found, too. Each input at fault is written to a file, and all are listed at the end with the figures of
docs/fuzzing.md.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import mmap
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

from judging import LONGEST, Fault, judged, limited  # noqa: E402
from mutations import LARGEST  # noqa: E402
from targets import TARGETS  # noqa: E402

#: Wall time in which an input must be done, even if the process waits or others keep the processor busy [s].
PATIENCE = 12.0 * LONGEST
#: Number of faults of one reader after which further faults are probably the same.
ENOUGH = 40


def work(name: str, first: int, inputs: int, seed: int, seconds: float, share: Path) -> dict:
    """Give inputs to a reader; the number and the bytes of the current input are in a shared file.

    Parameters
    ----------
    name : str
        Name of the reader.
    first, inputs : int
        Number of the first input, and of the one after the last input.
    seed : int
    seconds : float
        Processor time after which it ends [s].
    share : Path
    """
    target = TARGETS[name]
    with share.open("r+b") as file, mmap.mmap(file.fileno(), 0) as shared, tempfile.TemporaryDirectory() as folder:
        taken, number = 0, first
        faults: dict[str, list] = {}
        next(iter(target.inputs(0, 1)))
        begun = time.process_time()  # preparation and compilation before do not count
        with limited():
            for number, data in enumerate(target.inputs(first, inputs - first, seed), first):
                shared[:16] = number.to_bytes(8, "little") + len(data).to_bytes(8, "little")
                shared[16 : 16 + len(data)] = data
                try:
                    taken += judged(target, data, Path(folder))
                except Fault as fault:
                    faults.setdefault(fault.kind, [data.hex(), str(fault), 0])[2] += 1
                    if len(faults) >= ENOUGH:
                        break
                if not number % 64 and time.process_time() - begun > seconds:
                    return {"next": number + 1, "taken": taken, "faults": list(faults.values()), "over": True}
    return {"next": number + 1, "taken": taken, "faults": list(faults.values()), "over": len(faults) >= ENOUGH}


def supervised(name: str, options: argparse.Namespace) -> tuple[dict, list[tuple[bytes, str]]]:
    """Return the figures of a reader, and the inputs at fault with their results."""
    faults: list[tuple[bytes, str]] = []
    first, taken, before = 0, 0, resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        share = Path(folder) / "share"
        while first < options.inputs and len(faults) < ENOUGH:
            share.write_bytes(bytes(16 + 2 * LARGEST))
            used = _used(before)
            if used >= options.seconds:
                break
            words = [name, first, options.inputs, options.seed, options.seconds - used, share]
            command = [sys.executable, __file__, "--worker", *map(str, words)]
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            found = _answer(process, share)
            faults += [(bytes.fromhex(data), f"{count} inputs\n{text}") for data, text, count in found["faults"]]
            first, taken = found["next"], taken + found["taken"]
            if found.get("over"):
                break
    return {
        "reader": name,
        "inputs": first,
        "taken": taken,
        "cpu_s": round(_used(before)),
        "faults": len(faults),
    }, faults


def _used(before) -> float:
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    return now.ru_utime + now.ru_stime - before.ru_utime - before.ru_stime


def _answer(process: subprocess.Popen, share: Path) -> dict:
    """Return the answer of a worker, or the input at which the worker ended or hung."""
    number, since = -1, time.monotonic()
    while True:
        try:
            said, errors = process.communicate(timeout=1.0)
            break
        except subprocess.TimeoutExpired:
            now = int.from_bytes(share.read_bytes()[:8], "little")
            if now != number:
                number, since = now, time.monotonic()
            elif time.monotonic() - since > PATIENCE:
                process.kill()
                said, errors = process.communicate()
                return _ended(share, f"stands still for {PATIENCE:g} s")
    lines = said.splitlines()
    if process.returncode == 0 and lines:
        return json.loads(lines[-1])
    return _ended(share, f"ended the process with {process.returncode}: {errors[-2000:]}")


def _ended(share: Path, text: str) -> dict:
    """Return the known figures of a worker that has ended; its earlier findings are found again with another seed."""
    content = share.read_bytes()
    number, size = (int.from_bytes(content[place : place + 8], "little") for place in (0, 8))
    return {"next": number + 1, "taken": 0, "faults": [[content[16 : 16 + size].hex(), text, 1]]}


def main() -> int:
    """Fuzz; return 1 if a fault was found."""
    if sys.argv[1:2] == ["--worker"]:
        name, first, inputs, seed, seconds, share = sys.argv[2:]
        answer = work(name, int(first), int(inputs), int(seed), float(seconds), Path(share))
        sys.stdout.write("\n" + json.dumps(answer) + "\n")
        sys.stdout.flush()
        os._exit(0)  # without waiting for threads of libraries
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1_000_000, help="of each reader")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="on the processor for each reader at most")
    parser.add_argument("--target", action="append", choices=sorted(TARGETS), help="only these readers; repeatable")
    parser.add_argument("--seed", type=int, default=0, help="another one gives other inputs")
    parser.add_argument("--crashers", type=Path, default=Path("crashers"), help="folder for what is found")
    options = parser.parse_args()
    found = 0
    print("| reader | inputs | of them valid | processor | faults |\n|---|---|---|---|---|", flush=True)
    for name in options.target or TARGETS:
        figures, faults = supervised(name, options)
        part = 100.0 * figures["taken"] / max(figures["inputs"], 1)
        print(f"| {name} | {figures['inputs']} | {part:.0f} % | {figures['cpu_s']} s | {len(faults)} |", flush=True)
        found += len(faults)
        for data, text in faults:
            folder = options.crashers / re.sub(r"\W+", "_", name)
            folder.mkdir(parents=True, exist_ok=True)
            stem = hashlib.sha256(data).hexdigest()[:12]
            (folder / stem).write_bytes(data)
            (folder / f"{stem}.txt").write_text(text)
    return 1 if found else 0


if __name__ == "__main__":
    raise SystemExit(main())
