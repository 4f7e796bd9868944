# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The stage of examples/c_stage for tests: built once with the C compiler of this machine, if it exists."""

from __future__ import annotations

import contextlib
import functools
import os
import pathlib
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples" / "c_stage"
HEADERS = ROOT / "hysteresis_ros" / "hardware"
COMPILER = shutil.which(os.environ.get("CC", "gcc")) or shutil.which("cc")

needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (gcc or cc): the driver in C is not built")


def compile_c(source: pathlib.Path, target: pathlib.Path, *options: str) -> pathlib.Path:
    """Compile a file; warnings are errors."""
    strict = ["-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", f"-I{HEADERS}", f"-I{EXAMPLE}"]
    subprocess.run([COMPILER, *strict, *options, str(source), "-o", str(target), "-lm", "-lrt"], check=True)
    return target


def listed_library(folder: pathlib.Path) -> pathlib.Path:
    """Build the driver without a device."""
    return compile_c(ROOT / "test/hardware/listed_driver.c", folder / "liblisted.so", "-fPIC", "-shared")


@functools.cache
def built() -> pathlib.Path:
    """Return a folder with the built example."""
    keeper = tempfile.TemporaryDirectory(prefix="stage_")
    built.keeper = keeper  # removed when the tests end
    folder = pathlib.Path(keeper.name)
    shutil.copy(EXAMPLE / "stage.py", folder)
    compile_c(EXAMPLE / "stage_device.c", folder / "stage_device")
    compile_c(EXAMPLE / "stage_driver.c", folder / "libstage.so", "-fPIC", "-shared")
    return folder


@dataclass
class RunningStage:
    """A stage's process and the name of its shared memory."""

    name: str
    process: subprocess.Popen


@contextlib.contextmanager
def running_stage(*options: str) -> Iterator[RunningStage]:
    """Start a stage; its remaining files are removed afterwards."""
    name = f"/stage_{os.getpid()}_{os.urandom(4).hex()}"
    with subprocess.Popen([str(built() / "stage_device"), name, *options], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout.readline() == b"ready\n"
            yield RunningStage(name, process)
        finally:
            process.kill()
            process.wait()
            pathlib.Path(f"/dev/shm{name}").unlink(missing_ok=True)
