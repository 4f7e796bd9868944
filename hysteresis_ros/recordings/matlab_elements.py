# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What the elements of a MATLAB file (level 5) say of themselves, looked through before SciPy believes it.

SciPy's reader takes types, sizes and dimensions as they stand there; of a damaged file it reads memory that is none and
ends the process. Source: The MathWorks, MAT-File Format, "Level 5 MAT-Files", tables 1-1 and 1-3.
"""

from __future__ import annotations

import math
import struct
import zlib

#: Bytes before the first element; the last four are version and order of bytes.
HEADER = 128
#: Version and order of bytes by how they stand there; of HDF5, since MATLAB 7.3.
ORDERS, HDF5 = {b"\0\1IM": "<", b"\1\0MI": ">"}, (b"\0\2IM", b"\2\0MI")
#: Types of elements.
INT32, UINT32, MATRIX, COMPRESSED, TYPES = 5, 6, 14, 15, (*range(1, 8), 9, *range(12, 19))
#: Classes of arrays: of cells, structures, objects, texts, sparse, functions, opaque ones; the others are of numbers.
CELL, STRUCT, OBJECT, CHAR, SPARSE, FUNCTION, OPAQUE = 1, 2, 3, 4, 5, 16, 17
#: Elements within each other, what an element may unpack to in any case [bytes], and else in parts of its own size.
DEEPEST, SMALL, RATIO = 20, 1 << 26, 100


def is_hdf5(content: bytes) -> bool:
    """Tell whether this is HDF5 with the header of MATLAB, as since 7.3."""
    return 0 not in content[:4] and content[HEADER - 4 : HEADER] in HDF5


def require_sound(content: bytes) -> None:
    """Refuse a file of level 5 whose elements do not fit into each other; level 4 is let through.

    Parameters
    ----------
    content : bytes

    Raises
    ------
    ValueError
        It is damaged; the message says what is.
    """
    mark = content[HEADER - 4 : HEADER]
    if 0 in content[:4]:
        return
    if mark not in ORDERS:
        raise ValueError("no header of a MATLAB file")
    order = ORDERS[mark]
    for kind, data in _elements(content[HEADER:], order, padded=False):
        if kind == COMPRESSED:
            unpacker = zlib.decompressobj()
            data = unpacker.decompress(data, max(SMALL, RATIO * len(data)))
            if unpacker.unconsumed_tail:
                raise ValueError("an element unpacks to more than measurements do")
            inner = list(_elements(data, order, padded=False))
            kind, data = inner[0] if len(inner) == 1 else (0, b"")
        if kind != MATRIX:
            raise ValueError("holds something else than arrays")
        _require_array(data, order, 0)


def _elements(data: bytes, order: str, padded: bool = True):
    """Yield type and content of the elements that lie one behind the other."""
    place = 0
    while place < len(data):
        (first,) = struct.unpack_from(order + "I", data, place)
        small = first >> 16
        size = small or struct.unpack_from(order + "I", data, place + 4)[0]
        kind, begin = first & 0xFFFF, place + (4 if small else 8)
        if kind not in TYPES or size > (4 if small else len(data) - begin):
            raise ValueError(f"an element of type {kind} and {size} bytes at byte {place} of {len(data)}")
        yield kind, data[begin : begin + size]
        place = begin + (4 if small else size + (-size % 8 if padded else 0))


def _require_array(data: bytes, order: str, depth: int) -> None:
    """Refuse an array whose class and dimensions do not fit its elements."""
    parts = list(_elements(data, order))
    if not parts and depth:
        return  # an empty cell
    (flags_kind, flags), (dimensions_kind, dimensions) = parts[:2] if len(parts) > 2 else ((0, b""), (0, b""))
    if flags_kind != UINT32 or len(flags) != 8 or depth > DEEPEST:
        raise ValueError("an array without class, or too deep")
    array_class, is_complex = flags[0 if order == "<" else 3], flags[1 if order == "<" else 2] & 8
    if not 1 <= array_class <= OPAQUE:
        raise ValueError(f"an array of class {array_class}, which there is not")
    if array_class == OPAQUE:  # three names stand in the place of dimensions
        _require_content(CELL, 1, parts[4:], False, (order, depth))
        return
    if dimensions_kind != INT32 or not dimensions or len(dimensions) % 4 or len(dimensions) > 4 * 32:
        raise ValueError("an array without dimensions")
    shape = struct.unpack(f"{order}{len(dimensions) // 4}i", dimensions)
    if min(shape) < 0:
        raise ValueError(f"an array of dimensions {shape}")
    _require_content(array_class, math.prod(shape), parts[3:], bool(is_complex), (order, depth))


def _require_content(array_class: int, count: int, parts: list, is_complex: bool, where: tuple[str, int]) -> None:
    """Refuse content that is not that of so many elements of an array."""
    order, depth = where
    if array_class in (CELL, STRUCT, OBJECT, FUNCTION):
        if array_class == FUNCTION:
            count = 1
        elif array_class != CELL:
            count, parts = _fields(count, parts[array_class == OBJECT :], order)
        if len(parts) != count or any(kind != MATRIX for kind, _ in parts):
            raise ValueError(f"{len(parts)} arrays where {count} should be")
        for _, inner in parts:
            _require_array(inner, order, depth + 1)
        return
    if not count:
        return
    numbers = (3 if array_class == SPARSE else 1) + is_complex
    if len(parts) != numbers or any(kind in (MATRIX, COMPRESSED) for kind, _ in parts):
        raise ValueError(f"{len(parts)} parts of an array that has {numbers}")
    if array_class != SPARSE and any(len(content) < count for _, content in parts):
        raise ValueError(f"{count} elements in fewer bytes")


def _fields(count: int, parts: list, order: str) -> tuple[int, list]:
    """Return of so many structures how many arrays they have, and the parts that should be these."""
    if len(parts) < 2 or parts[0][0] != INT32 or len(parts[0][1]) != 4:
        raise ValueError("a structure without names")
    (length,) = struct.unpack(order + "i", parts[0][1])
    if not 0 < length <= len(parts[1][1]) or len(parts[1][1]) % length:
        raise ValueError(f"names of {length} characters in {len(parts[1][1])}")
    return count * (len(parts[1][1]) // length), parts[2:]
