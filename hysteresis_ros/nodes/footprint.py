# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Keep the memory of a node small: Numba brings a compiler along, which a running node does not use."""

from __future__ import annotations

import ctypes
import pathlib

from hysteresis_ros.block import COMPILED

#: ``madvise``: these pages are not needed for now.
_MADV_DONTNEED = 4


def release_compiler() -> None:
    """Give the code pages of LLVM back once all kernels are loaded; should it be used again, they come back.

    Only pages that are mapped from the file for execution, which nobody writes: Linux reads them again on demand.
    """
    maps = pathlib.Path("/proc/self/maps")
    if not COMPILED or not maps.exists():
        return
    madvise = ctypes.CDLL(None).madvise
    madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    for line in maps.read_text().splitlines():
        span, rights, *_, path = line.split(maxsplit=5)
        if "libllvmlite" in path and rights == "r-xp":
            start, end = (int(address, 16) for address in span.split("-"))
            madvise(start, end - start, _MADV_DONTNEED)
