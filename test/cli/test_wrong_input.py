# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Any error in the arguments of a command or in the named files gives one line, exit code 2 and no traceback."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest
from command_support import refusal, run

from hysteresis_ros.cli.main import COMMANDS
from hysteresis_ros.configuration import config_path, load_configuration
from hysteresis_ros.loop.axis import Axis
from hysteresis_ros.loop.stage import Stage


@pytest.mark.parametrize(
    "words, expected",
    [
        (["simulat", "kim2009"], "did you mean simulate?"),
        (["identfy"], "did you mean identify?"),
        (["xyzzy"], "there are up, simulate"),
        (["--versoin"], "'--version'"),
        (["simulate", "kim2009", "--durati", "1"], "'--duration'"),
        (["compare", "kim2009", "--mismach", "1"], "'--mismatch'"),
        (["simulate"], "missing argument 'CONFIG'"),
        (["simulate", "kim2009", "one-too-many", "-o", "a.npz"], "one-too-many"),
        (["reproduce", "kim209"], "did you mean kim2009?"),
        (["design", "kim2009", "--controller", "offsetfree", "-o", "a.yaml"], "did you mean offset_free?"),
        (["compare", "kim2009", "--draws", "many"], "'many'"),
    ],
)
def test_mistyped_words_are_answered_with_the_nearest(words, expected):
    line = refusal(*words)
    assert expected in line
    assert "--help" in line or "there are: " in line, "the message names neither --help nor the possible values"


def test_without_a_word_the_help_is_shown():
    assert all(name in run().output for name in COMMANDS)


@pytest.mark.parametrize("duration", ["nan", "inf", "-1", "0"])
def test_a_duration_that_is_none_is_refused(tmp_path, duration):
    assert "duration" in refusal("simulate", "kim2009", "-o", tmp_path / "a.npz", "--duration", duration)


def test_a_run_that_no_memory_holds_is_refused(tmp_path):
    assert "memory" in refusal("simulate", "kim2009", "-o", tmp_path / "a.npz", "--duration", "1e12")
    assert "too many samples" in refusal("simulate", "kim2009", "-o", tmp_path / "a.npz", "--duration", "1e300")


def test_a_file_that_is_laid_over_and_a_drift_are_refused_by_name(tmp_path):
    words = "simulate", "kim2009", "-o", tmp_path / "a.npz", "--duration", "0.02"
    assert "nowhere.yaml: no such file" in refusal(*words, "--params-file", tmp_path / "nowhere.yaml")
    assert "drift gain = 0.7: must be within" in refusal(*words, "--drift", "0.7", "0")
    (tmp_path / "adapt.yaml").write_text(
        "/**/hysteresis_compensator: {ros__parameters: {adaptation: {type: recursive}}}", encoding="utf-8"
    )
    said = refusal(*words, "--params-file", tmp_path / "adapt.yaml")
    assert "adaptation.type = 'recursive': polynomial is not linear in its weights" in said


@pytest.fixture
def wrong(tmp_path) -> dict[str, pathlib.Path]:
    """Paths that can be neither read nor written."""
    (tmp_path / "folder").mkdir()
    rng = np.random.default_rng(1)
    for suffix in ("yaml", "csv", "npz", "mcap", "db3", "txt"):
        (tmp_path / f"binary.{suffix}").write_bytes(rng.bytes(2000))
        (tmp_path / f"empty.{suffix}").write_bytes(b"")
    return {path.name: path for path in tmp_path.iterdir()} | {
        "missing.csv": tmp_path / "missing.csv",
        "missing.yaml": tmp_path / "no" / "missing.yaml",
        "missing": tmp_path / "no" / "missing",
    }


CONFIGURATIONS = ("missing.yaml", "folder", "binary.yaml", "empty.yaml", "empty.csv")
RECORDINGS = (
    *("missing.csv", "missing", "folder", "binary.csv", "empty.csv", "binary.npz", "empty.npz"),
    *("binary.mcap", "empty.mcap", "binary.db3", "empty.db3", "binary.txt", "empty.txt"),
)


@pytest.mark.parametrize("name", CONFIGURATIONS)
@pytest.mark.parametrize(
    "words",
    [
        ["simulate", "{}", "-o", "{out}.npz"],
        ["design", "{}", "--controller", "pid", "-o", "{out}.yaml"],
        ["compare", "{}"],
        ["validate", "{}", "{recording}"],
        ["excite", "{}", "--recipe", "steps", "--record", "{out}"],
        ["up", "{}"],
    ],
    ids=lambda words: words[0],
)
def test_a_file_that_is_no_configuration_is_refused_by_name(tmp_path, wrong, recording, name, words):
    path = wrong[name]
    assert path.name in refusal(*[word.format(path, out=tmp_path / "out", recording=recording) for word in words])


@pytest.mark.parametrize("name", RECORDINGS)
@pytest.mark.parametrize(
    "words",
    [
        ["report", "{}"],
        ["export", "{}", "-o", "{out}.npz"],
        ["identify", "{}", "-o", "{out}.yaml"],
        ["simulate", "kim2009", "-o", "{out}.npz", "--setpoints", "{}"],
        ["validate", "kim2009", "{}"],
    ],
    ids=lambda words: words[0],
)
def test_a_file_that_is_no_recording_is_refused_by_name(tmp_path, wrong, name, words):
    path = wrong[name]
    assert path.name in refusal(*[word.format(path, out=tmp_path / "out") for word in words])


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> pathlib.Path:
    path = tmp_path_factory.mktemp("recording") / "run.npz"
    assert run("simulate", "kim2009", "-o", path, "--duration", "0.02").exit_code == 0
    return path


@pytest.mark.parametrize("place", ["folder.{}", "no/such/folder/file.{}", "file/below.{}"])
@pytest.mark.parametrize(
    "suffix, words",
    [
        ("npz", ["simulate", "kim2009", "--duration", "0.02", "-o", "{place}"]),
        ("mcap", ["simulate", "kim2009", "--duration", "0.02", "-o", "{place}"]),
        ("csv", ["export", "{recording}", "-o", "{place}"]),
        ("json", ["report", "{recording}", "--json", "{place}"]),
        ("html", ["report", "{recording}", "-o", "{place}"]),
        ("yaml", ["design", "kim2009", "--controller", "offset_free", "-o", "{place}"]),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else value,
)
def test_a_place_that_cannot_be_written_is_refused_by_name(tmp_path, recording, place, suffix, words):
    if suffix == "html":
        pytest.importorskip("matplotlib")
    path = tmp_path / place.format(suffix)
    (tmp_path / f"folder.{suffix}").mkdir()
    (tmp_path / "file").write_text("")
    result = run(*[word.format(recording=recording, place=path) for word in words])
    assert isinstance(result.exception, SystemExit), result.exception
    assert result.exit_code == 2
    assert path.name in result.output.splitlines()[-1]


@pytest.mark.parametrize(
    "words, expected",
    [
        (["identify", "{}", "-o", "a.yaml", "-p", "play_count=0"], "play_count = '0': must be 1 or more"),
        (["identify", "{}", "-o", "a.yaml", "--model", "bouc_wen", "-p", "exponent=99"], "must be 20 or less"),
        (["identify", "{}", "-o", "a.yaml", "--model", "bouc_wn"], "did you mean bouc_wen?"),
        (["identify", "{}", "-o", "a.yaml", "--range", "a:b"], "--range a:b"),
        (["identify", "{}", "-o", "a.yaml", "--resample", "nan"], "sample time nan"),
        (["validate", "kim2009", "{}", "--skip", "100000"], "skip = 100000"),
        (
            ["design", "kim2009", "--controller", "pid", "--bandwidth", "nan", "-o", "a.yaml"],
            "'nan': must be",
        ),
        (["design", "picma_stage", "--controller", "pid", "--damping", "irc", "-o", "a.yaml"], "nothing to damp"),
        (["design", "kim2009", "--controller", "pid", "--damping", "iff", "-o", "a.yaml"], "missing force joint"),
        (["design", "stage700", "--controller", "pid", "--damping", "notches", "-o", "a.yaml"], "did you mean notch"),
        (["parameters", "plant_simulater"], "did you mean plant_simulator?"),
        (["setpoint", "nan"], "finite"),
        (["setpoint", "1um", "--timeout", "nan"], "'--timeout': 'nan': must be a finite number"),
        (["setpoint", "1um", "--timeout", "-500ms"], "--timeout -0.5: must be a positive"),
        (["camera", "frames", "--scale", "60", "-o", "a.csv"], "--scale 60: of which unit? Write 60um or 60nm"),
        (["setpoint", "5.0e-6"], "of which unit? Write 5.0e-6m or 5.0e-6mm"),
        (["design", "kim2009", "--controller", "pid", "--noise", "2", "-o", "a.yaml"], "Write 2um or 2mm"),
        (["simulate", "kim2009", "--duration", "2um"], "is in m, must be in s"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_values_that_mean_nothing_are_refused_by_name(recording, words, expected):
    assert expected in refusal(*[word.format(recording) for word in words])


@pytest.mark.parametrize("page", ["page.pdf", "no/such/folder/page.html"])
@pytest.mark.parametrize("words", [["compare", "kim2009"], ["reproduce", "kim2009"]], ids=lambda words: words[0])
def test_a_page_that_cannot_be_written_is_refused_before_the_long_run(tmp_path, words, page):
    assert page in refusal(*words, "-o", tmp_path / page)


def test_a_key_that_stands_twice_is_refused_with_file_line_and_name(tmp_path):
    path = tmp_path / "twice.yaml"
    text = config_path("kim2009").read_text(encoding="utf-8")
    lines = text.splitlines()
    number = next(k for k, line in enumerate(lines) if "sample_rate:" in line)
    path.write_text("\n".join([*lines[: number + 1], lines[number], *lines[number + 1 :]]))
    line = refusal("simulate", path, "-o", tmp_path / "a.npz")
    assert f"twice.yaml: line {number + 2}: 'sample_rate' is already in line {number + 1}" in line
    path.write_text(f"{text}\n/**:\n  ros__parameters:\n    plain: 1\n/**:\n  ros__parameters:\n    plain: 2\n")
    assert "'/**' is already in line" in refusal("simulate", path, "-o", tmp_path / "a.npz")
    path.write_text(f"{text}\n/**/recorder:\n  ros__parameters:\n    a.b: 1\n    a: {{b: 2}}\n")
    assert "'a.b' occurs twice" in refusal("simulate", path, "-o", tmp_path / "a.npz")


@pytest.mark.parametrize(
    "words",
    [
        ("simulate", "kim2009", "-o", "run.txt"),
        ("frf", "kim2009", "--offline", "--record", "run.txt"),
        ("excite", "xy_scanner", "--recipe", "multisine", "--offline", "--record", "run.txt"),
    ],
    ids=lambda words: words[0],
)
def test_a_kind_of_file_that_no_run_has_is_refused_before_the_run(words, tmp_path, monkeypatch):
    for runs in (Axis, Stage):
        monkeypatch.setattr(runs, "run", lambda *given, **named: pytest.fail("it ran"))
    monkeypatch.chdir(tmp_path)
    line = refusal(*words)
    assert "run.txt: unknown kind of file '.txt'; write .npz, .csv or .mcap" in line and "samples" not in line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("report", "rec.npz", "--json", "rec.npz"), "--json 'rec.npz': the command reads this file and would lose it"),
        (("export", "rec.npz", "-o", "./rec.npz"), "-o 'rec.npz': the command reads this file and would lose it"),
        (("identify", "rec.npz", "-o", "rec.npz"), "-o 'rec.npz': the command reads this file and would lose it"),
        (("report", "rec.npz", "-o", "p.html", "--json", "p.html"), "-o and --json name the same file 'p.html'"),
    ],
)
def test_results_never_overwrite_the_recording_or_each_other(tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rec.npz").write_bytes(b"kept")
    line = refusal(*words)
    assert said in line
    assert (tmp_path / "rec.npz").read_bytes() == b"kept" and len(list(tmp_path.iterdir())) == 1


def test_a_relative_driver_is_looked_for_beside_its_file_only(tmp_path, monkeypatch):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "stage.py").write_text("raise SystemExit(99)")
    monkeypatch.chdir(elsewhere)
    (tmp_path / "axis.yaml").write_text("/plant_simulator:\n  ros__parameters: {driver: ./stage.py}\n")
    entry = load_configuration(tmp_path / "axis.yaml").entries[0]
    assert entry[1]["driver"] == str(tmp_path / "stage.py")
