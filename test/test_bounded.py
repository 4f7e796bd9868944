# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""External inputs are read safely and within bounds: texts, YAML, parameters, messages."""

from __future__ import annotations

import ast
import contextlib
import pathlib
import re

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from yaml.constructor import FullConstructor, SafeConstructor, UnsafeConstructor

from hysteresis_ros.configuration import (
    LONGEST_TEXT,
    MOST_ITEMS,
    _Loader,
    load_configuration,
    parse_configuration,
    parse_value,
)
from hysteresis_ros.control.learning import read_learned
from hysteresis_ros.errors import LONGEST, ConfigurationError, HysteresisError, ParameterError, shortened
from hysteresis_ros.files import DEEPEST, FAST_LOADER, LARGEST, MOST_VALUES, BoundsError, read_text, read_yaml
from hysteresis_ros.hardware.tracker import MOST_PIXELS, FrameError, grey_image
from hysteresis_ros.loop.parameters import NODE_PARAMETERS
from hysteresis_ros.references.inchworm_sequencer import read_walk

ROOT = pathlib.Path(__file__).resolve().parents[1]
SOURCES = [
    path for name in ("hysteresis_ros", "launch", "examples", "benchmarks") for path in (ROOT / name).rglob("*.py")
]

#: 10 lists of 10 of 10 …: half a kilobyte that represents a thousand million values.
BOMB = "a0: &a0 [1, 1]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 10))


def deep(levels: int) -> str:
    return "a: " + "[" * levels + "]" * levels


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BOMB, "line 2: ROS 2 does not read YAML aliases"),
        (deep(DEEPEST), f"mappings or lists are nested more than {DEEPEST} deep"),
        (deep(100_000), "are nested more than|exceeded maximum nesting depth"),  # PyYAML 6.0.4 has a limit of its own
        ("a:\n" + "- 1\n" * MOST_VALUES, f"more than {MOST_VALUES} values"),
        ("a: '" + "x" * LARGEST + "'", "larger than 16 MiB"),
        ("a: !!python/object/apply:os.system ['true']", "not readable as YAML"),
        ("a: !!python/name:os.system", "not readable as YAML"),
        ("a: 2001-99-99", "not readable as YAML"),
        ("a: " + "9" * 5000, "not readable as YAML"),
        ("a: !!int x", "not readable as YAML"),
        ("? {a: b}\n: c", "not readable as YAML"),
    ],
    ids=range(11),
)
def test_more_than_it_looks_is_refused_with_words(text, said):
    with pytest.raises(BoundsError, match=said):
        read_yaml(text)
    with pytest.raises(ConfigurationError, match=rf"^f\.yaml: .*(?:{said})"):
        parse_configuration(text, "f.yaml")


def test_what_is_allowed_is_read():
    assert read_yaml(deep(DEEPEST - 1))
    assert read_yaml("[1, [2], {a: b}]", most=7) == [1, [2], {"a": "b"}]
    with pytest.raises(BoundsError, match="more than 6 values"):
        read_yaml("[1, [2], {a: b}]", most=6)


@given(st.text(st.characters(codec="utf-8") | st.sampled_from("[]{}:,&*!?|>-%@ \n\"'#0123456789ei.x_"), max_size=60))
@settings(max_examples=50)
@example("!!timestamp x")
@example("<<: 3")
@example("!!omap 3")
@example("=")
@example("\x00")
def test_no_text_ends_in_anything_but_words(text):
    for read in (read_yaml, lambda text: parse_configuration(text, "f")):
        with contextlib.suppress(HysteresisError):
            read(text)
    parse_value(text)


@pytest.mark.parametrize("content", [BOMB, deep(200), "{", "learned_correction: 3", "inchworm_walk: []"])
def test_files_that_nodes_load_are_read_within_bounds(tmp_path, content):
    path = tmp_path / "learned.yaml"
    path.write_text(content)
    with pytest.raises(ParameterError, match="is not a file of a learned correction"):
        read_learned(path)
    with pytest.raises(ParameterError, match="is not a file of a learned walk"):
        read_walk(path, 8, 1e-6, 1e-6)


def test_a_file_without_end_is_not_read_to_its_end():
    zero = pathlib.Path("/dev/zero")
    if not zero.exists():
        pytest.skip("no /dev/zero here")
    with pytest.raises(BoundsError, match="larger than 16 MiB"):
        read_text(zero)
    with pytest.raises(ConfigurationError, match="/dev/zero: cannot be read: is larger"):
        load_configuration(zero)


@pytest.mark.parametrize(
    ("node", "name", "value", "said"),
    [
        ("recorder", "topics", ["a"] * (MOST_ITEMS + 1), f"too long, allowed: {MOST_ITEMS} elements"),
        ("recorder", "path", "x" * (LONGEST_TEXT + 1), f"of {LONGEST_TEXT} characters"),
        ("recorder", "topics", ["x" * (LONGEST_TEXT + 1)], f"of {LONGEST_TEXT} characters"),
    ],
)
def test_parameters_have_a_longest_list_and_a_longest_text(node, name, value, said):
    row = next(row for row in NODE_PARAMETERS[node].table() if row.name == name)
    with pytest.raises(ParameterError, match=said) as refusal:
        row.convert(value)
    assert len(str(refusal.value)) < 2 * LONGEST
    assert row.convert(value[:-1] if isinstance(value, str) or len(value) > 1 else ["x"])


def test_messages_have_no_room_for_everything():
    assert shortened([1, "a"]) == "[1, 'a']"
    text = shortened("x" * 10**6)
    assert (
        len(text) < LONGEST + 50 and "(1000002 characters)" in text and text.startswith("'xx") and text.endswith("xx'")
    )


def test_an_image_of_more_pixels_than_any_camera_has_is_refused():
    with pytest.raises(FrameError, match=f"more than {MOST_PIXELS}"):
        grey_image(b"", "mono8", (2**20, 2**20), 2**20)


#: Modules and functions that create arbitrary objects from a file.
PICKLES = {"pickle", "cPickle", "dill", "marshal", "shelve", "joblib", "cloudpickle"}
NEVER = {"eval", "os.system", "os.popen", "yaml.unsafe_load", "yaml.full_load", "yaml.load_all", "yaml.unsafe_load_all"}
#: Files that read YAML without bounds: the launch file, which imports nothing of the package, and internal scripts.
UNBOUNDED = {"yaml.safe_load", "yaml.safe_load_all"}


#: Sources without any of these words need no further check.
SUSPECT = re.compile("|".join([*PICKLES, "eval|popen|system|shell|np.load|numpy.load|yaml"]))


def unsafe(source: str, bounded: bool) -> list[str]:
    """Return uses in a source, with lines, that create more than plain values; ``bounded``: without any YAML."""
    if not SUSPECT.search(source):
        return []
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            names = {alias.name for alias in node.names} | {getattr(node, "module", "") or ""}
            found += [f"{node.lineno}: {name}" for name in names & PICKLES]
        elif isinstance(node, ast.Call):
            called, given = ast.unparse(node.func), {item.arg: ast.unparse(item.value) for item in node.keywords}
            wrong = called in NEVER | (UNBOUNDED | {"yaml.load"} if bounded else {"yaml.load"})
            wrong |= called in ("np.load", "numpy.load") and given.get("allow_pickle") != "False"
            wrong |= given.get("shell", "False") != "False"
            found += [f"{node.lineno}: {called}"] * wrong
    return found


@pytest.mark.slow
def test_files_are_read_as_plain_values_everywhere():
    own = ROOT / "hysteresis_ros" / "files.py"
    found = {
        str(path.relative_to(ROOT)): unsafe(path.read_text(encoding="utf-8"), path.is_relative_to(own.parent))
        for path in SOURCES
        if path != own
    }
    assert {path: lines for path, lines in found.items() if lines} == {}
    for loader in (FAST_LOADER, _Loader):
        assert issubclass(loader, SafeConstructor)
        assert not issubclass(loader, (UnsafeConstructor, FullConstructor))


@pytest.mark.parametrize(
    "line",
    [
        "import pickle",
        "from joblib import load",
        "yaml.load(text, Loader=yaml.SafeLoader)",
        "yaml.safe_load(text)",
        "yaml.unsafe_load(text)",
        "np.load(path)",
        "np.load(path, allow_pickle=True)",
        "subprocess.run(words, shell=True)",
        "eval(text)",
    ],
)
def test_the_rule_sees_what_it_forbids(line):
    assert unsafe(line, True)
    assert not unsafe("np.load(path, allow_pickle=False)\nimport yaml\nyaml.safe_dump(1)", True)
