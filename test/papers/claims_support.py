# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Comparison of the table of a repeated paper with its page."""

from __future__ import annotations

import math
import pathlib

from hysteresis_ros.laboratory.papers.claims import Reproduction, format_claims

#: Relative difference of a figure on another processor, where libraries of identifications add in another order.
LAST_DIGITS = 1e-4


def assert_shown(found: Reproduction, page: pathlib.Path) -> None:
    """Check that a page shows the table, with figures that differ at most in their last digits.

    The remarks below the table may be shown in other words.
    """
    printed = format_claims(found).splitlines()
    blocks = page.read_text(encoding="utf-8").split("```text\n")[1:]
    [shown] = [lines for block in blocks if (lines := block.split("```")[0].rstrip().splitlines())[0] == printed[0]]
    if "Remarks" not in shown:
        printed = printed[: printed.index("Remarks") - 1]
    assert len(shown) == len(printed)
    differing = [(one, other) for one, other in zip(shown, printed, strict=True) if not _same(one, other)]
    assert not differing


def _same(line: str, other: str) -> bool:
    words, others = line.split(), other.split()
    return len(words) == len(others) and all(map(_same_word, words, others))


def _same_word(word: str, other: str) -> bool:
    try:
        return word == other or math.isclose(float(word), float(other), rel_tol=LAST_DIGITS)
    except ValueError:
        return False
