# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Other processors, simulated in separate processes."""

from __future__ import annotations

import os
import pathlib
import re
import subprocess
import sys

import hysteresis_ros

#: Settings with which libraries use their code for another processor: for OpenBLAS a core type, for the C library and
#: NumPy no vector extensions and no fused multiply-add. Names that a library does not know have no effect.
NO_FUSED = {
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX2_Usable,-FMA_Usable,-FMA4_Usable",
    "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 X86_V3 X86_V4 AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL "
    "AVX512_SPR",
}
#: Instructions that the code for a processor needs; a machine without them ends the process.
NEEDED = {"SkylakeX": {"avx512f", "avx512bw", "avx512vl"}}
ALL_PROCESSORS = {
    "Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "SkylakeX": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "Prescott, nothing fused": {"OPENBLAS_CORETYPE": "Prescott", **NO_FUSED},
}


def _has(name: str) -> bool:
    """Return whether this machine can execute the code for a processor; another architecture ignores the setting."""
    flags = re.search(r"^flags\s*:(.*)$", pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8"), re.MULTILINE)
    return flags is None or NEEDED.get(name, set()) <= set(flags.group(1).split())


#: The processors that this machine can simulate.
PROCESSORS = {name: settings for name, settings in ALL_PROCESSORS.items() if _has(name)}


def environment_on(name: str) -> dict[str, str]:
    """Return the environment in which libraries detect another processor."""
    kept = {key: value for key, value in os.environ.items() if key not in {"OPENBLAS_CORETYPE", *NO_FUSED}}
    root = str(pathlib.Path(hysteresis_ros.__file__).parents[1])
    return kept | {"PYTHONPATH": root} | PROCESSORS[name]


def on_processor(name: str, script: str, *arguments: str, **environment) -> str:
    """Return the output of a Python script on another processor."""
    command = [sys.executable, "-c", script, *arguments]
    done = subprocess.run(command, env=environment_on(name) | environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout
