# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis benchmark`` as a user calls it."""

from __future__ import annotations

import csv
import json
import pathlib

import pytest
from click.testing import CliRunner
from manifest_support import entry, manifest, written

from hysteresis_ros.cli.main import main


def called(*words):
    """Return the result of the command."""
    return CliRunner().invoke(main, ["benchmark", *map(str, words)])


@pytest.mark.slow
def test_table_csv_json_and_page_hold_the_same_figures(tmp_path):
    """Two models on a recording and a synthetic plant."""
    path = manifest(tmp_path, entry(written(tmp_path)))
    outputs = [tmp_path / name for name in ("rows.csv", "all.json", "page.html")]
    result = called(
        *(path, "--synthetic", 1, "--model", "line", "--model", "classical_pi", "--workers", 1),
        *("--csv", outputs[0], "--json", outputs[1], "-o", outputs[2]),
    )
    assert result.exit_code == 0, result.output
    content = json.loads(outputs[1].read_text())
    assert [one["name"] for one in content["recordings"]] == ["shelf", "synthetic_1"]
    assert content["recordings"][1]["truth"]["hysteresis"]
    with outputs[0].open() as stream:
        table = list(csv.DictReader(stream))
    assert len(table) == len(content["rows"]) == 4
    page = outputs[2].read_text()
    for line, row in zip(table, content["rows"], strict=True):
        assert float(line["error"]) == row["error"] and row["low"] <= row["error"] <= row["high"]
        assert float(line["percent"]) == pytest.approx(100.0 * row["error"] / row["stroke"])
        for text in (result.output, page):
            assert f"{float(line['percent']):.3g} %" in text
    assert "<img" in page and "95 % interval" in page


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--model", "lines"), "did you mean line?"),
        (("--only", "shelves"), "did you mean shelf?"),
        (("--data", "nowhere"), "the folder does not exist"),
        (("-o", "page.pdf"), "unknown kind of report"),
        (("--noise", "5"), "of which unit"),
    ],
)
def test_wrong_input_is_refused_at_once(tmp_path, monkeypatch, words, told):
    """Exit code 2, one line, nothing written."""
    monkeypatch.chdir(tmp_path)
    path = manifest(tmp_path, entry(written(tmp_path)))
    before = sorted(tmp_path.iterdir())
    result = called(path, "--model", "line", *words)
    assert result.exit_code == 2 and told in result.output
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.slow
def test_missing_files_are_named_with_their_source(tmp_path):
    """Of the user's manifest they are an error; of the shipped one they are left out, and said."""
    path = manifest(tmp_path, entry("0" * 64))
    result = called(path, "--model", "line")
    assert result.exit_code == 2 and "run.csv not found" in result.output and "a shelf" in result.output
    result = called("--data", tmp_path, "--synthetic", 1, "--model", "line", "--workers", 1)
    assert result.exit_code == 0 and "left out: picma_micromanipulator" in result.output
    assert "https://" in result.output


def test_the_list_names_sources_licences_and_models():
    """Nothing is fitted."""
    result = called("--list")
    assert result.exit_code == 0
    for text in ("licence  MIT", "https://github.com/", "classical_pi", "prandtl_ishlinskii", "Model_Vi_Do.dat"):
        assert text in result.output


def test_the_model_of_the_page_is_a_model(tmp_path):
    """The class of docs/benchmark.md, from a file, beside a line."""
    page = (pathlib.Path(__file__).parents[2] / "docs" / "benchmark.md").read_text(encoding="utf-8")
    (tmp_path / "my_model.py").write_text(page.partition("```python\n")[2].partition("```")[0])
    path = manifest(tmp_path, entry(written(tmp_path)))
    models = ("--model", f"{tmp_path / 'my_model.py'}:Mine", "--model", "line")
    result = called(path, *models, "--workers", 1, "--json", "-")
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout)["rows"]
    assert {row["parameters"] for row in rows} == {1, 2} and all(row["error"] > 0.0 for row in rows)
