# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Registries: entries from a folder and from entry points, and entries that are refused or omitted."""

from __future__ import annotations

import importlib
import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.registry import discover, resolved, samples

GROUP = "hysteresis_ros.things_of_a_test"
numbers = itertools.count()


@pytest.fixture
def found(tmp_path, monkeypatch):
    """Return a function that writes modules and entry points and returns the discovered entries."""
    monkeypatch.syspath_prepend(tmp_path)

    def discovered(modules: dict[str, str], entries: str = "") -> dict[str, SimpleNamespace]:
        name = f"things_{next(numbers)}"
        folder = tmp_path / name
        folder.mkdir()
        for module, text in {"__init__": "", **modules}.items():
            (folder / f"{module}.py").write_text(f"from types import SimpleNamespace as Thing\n{text}\n")
        information = tmp_path / "others-1.0.dist-info"
        information.mkdir()
        (information / "METADATA").write_text("Metadata-Version: 2.1\nName: others\nVersion: 1.0\n")
        (information / "entry_points.txt").write_text(f"[{GROUP}]\n{entries}".format(name=name))
        importlib.invalidate_caches()
        importlib.import_module(name)
        return discover(name, "THING", SimpleNamespace, GROUP)

    return discovered


def test_modules_and_entry_points_are_found_in_alphabetical_order(found):
    modules = {
        "b": 'THING = (Thing(name="b"), Thing(name="c"))',
        "a": 'THING = Thing(name="z")',
        "_kept_out": "OTHER = Thing(name='o')",
    }
    things = found(modules, "other = {name}._kept_out:OTHER\n")
    assert list(things) == ["b", "c", "o", "z"] and things["z"].name == "z"


@pytest.mark.parametrize(
    ("modules", "words"),
    [
        ({"a": ""}, r"a\.THING must be a SimpleNamespace, it is None"),
        ({"a": 'THING = Thing(name="x")', "b": 'THING = Thing(name="x")'}, r"b\.THING: the name 'x' is taken"),
        ({"a": 'THING = (Thing(name="x"), 1)'}, r"a\.THING must be a SimpleNamespace, it is 1"),
    ],
)
def test_a_module_that_declares_nothing_or_the_same_again_is_a_mistake(found, modules, words):
    with pytest.raises(TypeError, match=words):
        found(modules)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("nowhere_at_all:THING", "ModuleNotFoundError"),
        ("math:pi", "must be"),
        ("{name}.a:THING", "is taken"),
    ],
)
def test_an_entry_point_that_does_not_serve_is_left_out_with_a_warning(found, entry, words):
    with pytest.warns(RuntimeWarning, match=rf"entry point wrong = .*{words}"):
        things = found({"a": 'THING = Thing(name="a")'}, f"wrong = {entry}\n")
    assert list(things) == ["a"]


@pytest.mark.parametrize("given", [np.broadcast_to(2.0, 3), np.frombuffer(np.full(3, 2.0).tobytes()), [2, 2, 2]])
def test_samples_can_be_written_also_if_those_given_cannot(given):
    found = samples("voltage", given)
    assert found.flags.writeable and found.flags.c_contiguous and found.dtype == np.float64
    np.testing.assert_array_equal(found, [2.0, 2.0, 2.0])
    own = np.ones(3)
    assert samples("voltage", own) is own


def test_masked_samples_are_missing():
    np.testing.assert_array_equal(samples("voltage", np.ma.array([1, 5, 2], mask=[0, 1, 0])), [1.0, np.nan, 2.0])


@pytest.mark.parametrize("given", [np.ones(2) * 1j, [1.0, 2j], [[1.0], [1.0, 2.0]], "much", ["much"]])
def test_samples_that_are_no_real_numbers_are_refused(given):
    with pytest.raises(HysteresisError, match="voltage: must be an array of real numbers"):
        samples("voltage", given)


def test_a_function_is_found_by_its_dotted_path():
    assert resolved("hysteresis_ros.registry:discover") is discover
