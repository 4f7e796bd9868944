# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Layouts for other tools use topics that an axis has, and fields that match their legends."""

from __future__ import annotations

import json
import pathlib
import re
import xml.etree.ElementTree

import pytest

from hysteresis_ros import signals
from hysteresis_ros.recordings.run_bag import AxisTopics

LAYOUTS = pathlib.Path(__file__).resolve().parents[2] / "config" / "layouts"
FIELD = re.compile(r"(?P<topic>/[\w/]+)(?P<field>\.data|\.position\[(?P<index>\d+)\])")


@pytest.fixture(scope="module")
def known() -> dict[str, list[str]]:
    """Topics of an axis, and the names in them."""
    axis = AxisTopics()
    names = {topic: list(found) for topic, found in axis.states().items()}
    return names | {topic: [] for topic in axis.floats()} | {"/joint_states": ["measured"]}


def values(tree, key: str):
    """Yield all values of a key, at any depth."""
    for name, value in tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ():
        if name == key:
            yield value
        yield from values(value, key)


def test_foxglove_shows_what_its_legends_say(known):
    layout = json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))
    plots = {name: panel for name, panel in layout["configById"].items() if name.startswith("Plot!")}
    shown = [(path["value"], path["label"]) for plot in plots.values() for path in plot["paths"]]
    shown += [
        (plot["xAxisPath"]["value"], plot["title"].split(" over ")[1]) for plot in plots.values() if "xAxisPath" in plot
    ]
    assert len(shown) >= 9
    for value, label in shown:
        found = FIELD.fullmatch(value)
        names = known[found["topic"]]
        assert (names[int(found["index"])] if found["index"] else found["topic"].strip("/")) == label, value
    assert {*values(layout, "topicToRender")} == {"/diagnostics"}
    placed = {word for key in ("first", "second") for word in values(layout["layout"], key) if isinstance(word, str)}
    assert placed == set(layout["configById"]), "every panel has a position, and every position a panel"


def test_plotjuggler_shows_curves_of_topics_that_there_are(known):
    root = xml.etree.ElementTree.parse(LAYOUTS / "plotjuggler.xml").getroot()
    own = {snippet.get("name") for snippet in root.iter("snippet")}
    curves = list(root.iter("curve"))
    named = [curve.get("name") for curve in curves if "curve_x" not in curve.attrib]
    named += [curve.get(key) for curve in curves for key in ("curve_x", "curve_y") if key in curve.attrib]
    named += [source.text for tag in ("linked_source", "v1") for source in root.iter(tag)]
    assert len(named) >= 15
    for name in set(named) - own:
        topic, _, field = name.rpartition("/")
        if field == "position":
            topic, _, of = topic.rpartition("/")
            assert of in known[topic], name
        else:
            assert field == "data" and topic in known, name
    assert {topic.get("name") for topic in root.iter("topic")} <= set(known)
    assert {signals.CONTROLLER, signals.COMPENSATOR, signals.PLANT} <= {
        name.split("/")[1] for name in named if name not in own
    }
