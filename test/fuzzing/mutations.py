# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Random inputs: valid inputs with changed bytes, words or values; each follows from its number."""

from __future__ import annotations

import json
import re
from random import Random

#: Maximum number of bytes of an input, and of changes of a valid input.
LARGEST, CHANGES = 1 << 16, 4

#: Numbers at the limits of machine types, as sizes and offsets are written in file headers.
SIZES = [0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**40, 2**63 - 1, 2**64 - 1]

#: Words that are numbers, or nearly numbers, for some readers.
NUMBERS = (
    *("0", "-0", "-0.0", "1", "-1", "nan", "NaN", ".nan", "inf", "-inf", ".inf", "-.inf", "Infinity", "1e308", "1e309"),
    *(
        "-1e400",
        "5e-324",
        "1e-400",
        "1_000",
        "0x10",
        "0o17",
        "0b1",
        "1:30:00",
        "1,5",
        "1.5.2",
        "+",
        "-",
        ".",
        "e",
        "1e",
    ),
    *(
        "9" * 30,
        "9" * 400,
        "9" * 5000,
        "1e99999999",
        "2001-01-01",
        "2001-99-99",
        "0001-01-01 00:00:00 +99:99",
        "١٢٣",
        "½",
    ),
)

#: Words that are difficult for readers of any text format.
WORDS = (
    *(
        "",
        " ",
        "\t",
        "\n",
        "\r",
        "\r\n",
        "\0",
        "\ufeff",
        "\u2028",
        "\x85",
        "\x1b[2J",
        "é",
        "µ",
        "😀",
        "\ud7ff",
        "a" * 300,
    ),
    *(
        "true",
        "yes",
        "null",
        "~",
        "None",
        "on",
        "/",
        "..",
        "../..",
        "/dev/null",
        "~root",
        "%s",
        "{}",
        "$HOME",
        "`",
        "\\",
    ),
)

#: Words with a special meaning in YAML.
YAML_WORDS = (
    *(
        "*a",
        "&a ",
        "<<: *a",
        "!!python/object/apply:os.system [true]",
        "!!binary ab",
        "!!set {a}",
        "!!int x",
        "!!float x",
    ),
    *(
        "!!timestamp x",
        "!!bool x",
        "!!pairs [a]",
        "!!omap {a: 1}",
        "!x ",
        "---\n",
        "...\n",
        "? ",
        "? [a, b]\n: 1\n",
        "- ",
    ),
    *(
        "- - - ",
        "[" * 20,
        "{" * 20,
        "|\n",
        ">\n",
        "#",
        '"',
        "'",
        "''",
        "[]",
        "{}",
        "[1, a]",
        "{a: b}",
        "%YAML 9.9\n",
        "@",
    ),
    *(
        "a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n",
        ": ",
        ":",
        "ros__parameters:",
        "/**:",
        "/**/motion_controller:",
        "\n  ",
    ),
)

_TOKEN = re.compile(rb"[A-Za-z_]+|[0-9.eE+-]+|\s+|[^\sA-Za-z0-9]", re.ASCII)


def mutated_bytes(random: Random, data: bytes, others: list[bytes], words: tuple[str, ...] = ()) -> bytes:
    """Return bytes with some of them changed, lost, repeated or moved, or with false sizes among them."""
    changed = bytearray(data)
    for _ in range(random.randint(1, CHANGES)):
        random.choice(_BYTE_CHANGES)(random, changed, others)
    return bytes(changed[:LARGEST])


def mutated_text(random: Random, data: bytes, others: list[bytes], words: tuple[str, ...] = ()) -> bytes:
    """Return text with some words changed, lost, repeated or moved, and sometimes with bytes that are not text."""
    if random.random() < 0.1:
        return mutated_bytes(random, data, others)
    tokens = _TOKEN.findall(data)
    for _ in range(random.randint(1, CHANGES)):
        place = random.randrange(len(tokens) + 1)
        change = random.randrange(7)
        if change <= 2 or not tokens:
            word = random.choice(random.choice((NUMBERS, WORDS, words or NUMBERS))).encode("utf-8", "surrogatepass")
            tokens[place : place + (change > 0)] = [word]
        elif change == 3:
            del tokens[place : place + random.choice((1, 1, 2, 8, len(tokens)))]
        elif change == 4:
            piece = tokens[place : place + random.choice((1, 4, 16))]
            tokens[place:place] = piece * random.choice((1, 1, 2, 50))
        elif change == 5:
            other = _TOKEN.findall(random.choice(others))
            begin = random.randrange(len(other) + 1)
            tokens[place:place] = other[begin : begin + random.choice((1, 8, 64))]
        else:
            first, second = random.randrange(len(tokens)), random.randrange(len(tokens))
            tokens[first], tokens[second] = tokens[second], tokens[first]
    return b"".join(tokens)[:LARGEST]


def mutated_value(random: Random, data: bytes, others: list[bytes], words: tuple[str, ...] = ()) -> bytes:
    """Return JSON with some values replaced by another type or size, lost or repeated."""
    whole = [json.loads(data)]
    for _ in range(random.randint(1, CHANGES)):
        places = list(_places(whole))
        if not places:
            break
        holder, key = random.choice(places)
        old, change = holder[key], random.randrange(8)
        if change == 0 and isinstance(holder, list) and holder is not whole:
            del holder[key]
        elif change == 1 and isinstance(holder, list) and holder is not whole:
            holder[key:key] = [old] * random.choice((1, 3, 100))
        elif change == 2 and isinstance(holder, dict) and len(holder) > 1:
            del holder[key]
        elif change == 3 and isinstance(holder, dict):
            holder[random.choice((*holder, *(words or WORDS)))] = old
        else:
            holder[key] = _other_value(random, old, words)
    return json.dumps(whole[0]).encode()


def _other_value(random: Random, old, words):
    """Return another value, usually of the same type."""
    if random.random() < 0.2:
        old = random.choice((None, True, 0, 0.0, "", [], {}))
    if isinstance(old, bool) or old is None:
        return random.choice((True, False, None))
    if isinstance(old, int):
        return random.choice((old + 1, old - 1, -old, random.choice(SIZES), -random.choice(SIZES), 10**30, 10**400))
    if isinstance(old, float):
        return random.choice((old * random.gauss(0.0, 3.0), *_FLOATS))
    if isinstance(old, str):
        return random.choice(random.choice((words or WORDS, WORDS, NUMBERS)))
    if isinstance(old, list):
        return random.choice(([], old * 2, [old], [*_FLOATS], ["a"], old[::-1]))
    return random.choice(({}, {"a": old}, [old]))


_FLOATS = (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 5e-324, -0.0, 0.0, 1.0, -1.0, 1e-6, 1e-3, 1e18)


def _places(holder):
    """Yield every position in a value, as its container and the key there."""
    keys = list(holder) if isinstance(holder, dict) else range(len(holder))
    for key in keys:
        yield holder, key
        if isinstance(holder[key], (dict, list)):
            yield from _places(holder[key])


def _flip(random, data, others) -> None:
    if data:
        data[random.randrange(len(data))] ^= 1 << random.randrange(8)


def _set(random, data, others) -> None:
    if data:
        data[random.randrange(len(data))] = random.choice((0, 0xFF, 0x7F, 0x80, 0x20, 0x0A, random.randrange(256)))


def _lie(random, data, others) -> None:
    """Overwrite some bytes with a false size."""
    size = random.choice((1, 2, 4, 8))
    place = random.randrange(max(len(data) - size, 0) + 1)
    number = random.choice((*SIZES, random.getrandbits(8 * size), len(data), len(data) - place)) % (1 << 8 * size)
    data[place : place + size] = number.to_bytes(size, random.choice(("little", "big")))


def _cut(random, data, others) -> None:
    place = random.randrange(len(data) + 1)
    del data[place : place + random.choice((1, 2, 8, 64, len(data)))]


def _repeat(random, data, others) -> None:
    place = random.randrange(len(data) + 1)
    data[place:place] = data[place : place + random.choice((1, 4, 32, 256))] * random.choice((1, 1, 2, 20))


def _splice(random, data, others) -> None:
    other = random.choice(others)
    begin, place = random.randrange(len(other) + 1), random.randrange(len(data) + 1)
    data[place:place] = other[begin : begin + random.choice((1, 8, 64, 512))]


def _insert(random, data, others) -> None:
    place = random.randrange(len(data) + 1)
    data[place:place] = random.randbytes(random.choice((1, 2, 4, 16)))


_BYTE_CHANGES = (_flip, _flip, _set, _set, _lie, _lie, _cut, _repeat, _splice, _insert)
