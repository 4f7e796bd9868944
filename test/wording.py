# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Phrases that we do not use: `make lint` counts them in code and pages, and this list says what to write instead.

``python test/wording.py`` prints every phrase that occurs more often than its allowance and ends with exit code 1. An
allowance is the number of occurrences when the phrase was listed; it may only become smaller, and 0 forbids the phrase.
"""

from __future__ import annotations

import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parents[1]
FOLDERS = ("hysteresis_ros", "docs", "examples", "benchmarks", "config", "launch", "test")
SUFFIXES = (".py", ".md", ".yaml", ".ipynb", ".j2", ".js", ".c", ".h")

#: Phrase (a regular expression, case-sensitive): replacement, and allowed number of occurrences.
NOT_OURS = {
    r"is none": ("say what the thing is or lacks: 'the file is not a recording'", 22),
    r"are none": ("'there are no …', or what they are", 3),
    r"laid over": ("overlaid", 2),
    r"for whoever": ("name the person or the program", 0),
    r"so long for": ("'waits for …', 'time to wait for … [s]'", 0),
    r"who comes first": ("'the first to …'", 0),
    r"for want of": ("'because there is no …'", 0),
    r"bears": ("tolerates", 3),
    r"doubts": ("warnings; 'questions' as a verb", 31),
    r"doubted|doubtful": ("uncertain, not reliable", 2),
    r"all the same": ("nevertheless; identical", 7),
    r"makes samples": ("runs the loop", 1),
    r"free weights": ("non-parametric density", 3),
    r"mishaps?": ("fault case", 177),
    r"rivals?": ("competing model, competing publisher", 10),
}


def pages() -> list[pathlib.Path]:
    """Return the source files and pages, except this file, third-party files and generated files."""
    found = [path for name in FOLDERS for path in (ROOT / name).rglob("*") if path.suffix in SUFFIXES]
    made = ("docs/reference/", "hysteresis_ros/analysis/assets/", "test/wording.py")
    kept = [path for path in found if not path.relative_to(ROOT).as_posix().startswith(made)]
    return sorted([*kept, *ROOT.glob("*.md"), ROOT / "setup.py"])


def in_one_line(text: str) -> str:
    """Return a text without line ends and comment marks."""
    return re.sub(r"\s+(?:(?:#:?|//|\*|>)\s+)?", " ", text)


def occurrences(phrase: str, line: str) -> int:
    """Count a phrase in a text in one line."""
    # a search that begins with a letter is ten times as fast, and most texts do not contain the phrase
    return len(re.findall(rf"\b(?:{phrase})\b", line)) if re.search(phrase, line) else 0


def too_many(counts: dict[str, dict[str, int]]) -> list[str]:
    """Return a line for each phrase that occurs more often than allowed, with the files that contain it."""
    lines = []
    for phrase, (instead, allowed) in NOT_OURS.items():
        total = sum(counts[phrase].values())
        if total > allowed:
            places = ", ".join(f"{name} ({number})" for name, number in sorted(counts[phrase].items()))
            lines.append(f"'{phrase}' stands {total} times, {allowed} are allowed. Write: {instead}. Found in {places}")
    return lines


def counted() -> dict[str, dict[str, int]]:
    """Return for each phrase the files that contain it, with numbers of occurrences."""
    texts = {path.relative_to(ROOT).as_posix(): in_one_line(path.read_text(encoding="utf-8")) for path in pages()}
    found = {phrase: {name: occurrences(phrase, text) for name, text in texts.items()} for phrase in NOT_OURS}
    return {phrase: {name: number for name, number in places.items() if number} for phrase, places in found.items()}


if __name__ == "__main__":
    lines = too_many(counted())
    print(*lines, sep="\n", end="\n" if lines else "")
    sys.exit(bool(lines))
