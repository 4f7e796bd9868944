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
