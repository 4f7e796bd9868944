# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The command line for users: exit codes, one line for an error, no traceback."""

import json
import subprocess
import sys

import numpy as np
import pytest

import hysteresis_ros as hr
from hysteresis_ros.recordings import COLUMNS, Recording, load_run
from hysteresis_ros.recordings.bag_writer import BagWriter
from hysteresis_ros.recordings.run_bag import write_recording


def hysteresis(*arguments, code=None):
    command = [sys.executable, "-c", code] if code else [sys.executable, "-m", "hysteresis_ros.cli.main"]
    return subprocess.run([*command, *map(str, arguments)], capture_output=True, text=True, timeout=120)


def refused(result):
    """One line on stderr, nothing on stdout, exit code 2."""
    assert result.returncode == 2, result
    assert result.stdout == ""
    assert len(result.stderr.splitlines()) == 1, result.stderr
    assert "Traceback" not in result.stderr
    return result.stderr


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    time = np.arange(600) / 1000.0
    reference = np.repeat([0.0, 2e-6, 0.0], 200)
    columns = {name: reference + 1e-9 for name in COLUMNS} | {"reference": reference, "setpoint": reference}
    path = tmp_path_factory.mktemp("bags") / "run"
    write_recording(Recording.from_columns({"time": time, **columns}), path, namespace="stage")
    return path


def test_report_prints_a_table_and_writes_html_and_json(bag, tmp_path):
    result = hysteresis("report", bag, "-o", tmp_path / "report.html", "--json", tmp_path / "metrics.json")
    assert result.returncode == 0, result.stderr
    assert "RMS error" in result.stdout and "1 nm" in result.stdout
    assert (tmp_path / "report.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    figures = json.loads((tmp_path / "metrics.json").read_text(encoding="utf-8"))
    assert figures["rms_error_m"] == pytest.approx(1e-9)
    assert figures["residual_m"] == pytest.approx(1e-9)
    assert figures["samples"] == 600 and figures["loop_width_percent"] is None


def test_json_can_be_piped(bag):
    result = hysteresis("report", bag, "--json", "-")
    assert json.loads(result.stdout)["missing_samples"] == 0


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_export_gives_the_eight_columns_and_report_reads_them(bag, tmp_path, suffix):
    output = tmp_path / f"run{suffix}"
    result = hysteresis("export", bag, "-o", output, "--namespace", "stage")
    assert result.returncode == 0, result.stderr
    run = load_run(output)
    assert list(run.signals)[: len(COLUMNS)] == list(COLUMNS) and len(run) == 600
    again = hysteresis("report", output, "--json", "-")
    assert json.loads(again.stdout)["max_error_m"] == pytest.approx(1e-9)


def test_export_gives_every_signal_of_a_run(tmp_path):
    run = hr.simulate("kim2009", duration=0.02)
    run.save(tmp_path / "run.mcap")
    assert hysteresis("export", tmp_path / "run.mcap", "-o", tmp_path / "run.npz").returncode == 0
    exported = load_run(tmp_path / "run.npz")
    assert set(exported.signals) == set(run.signals)
    for name in ("applied", "saturated", "switching", "skipped"):
        np.testing.assert_array_equal(exported[name], run[name])


def test_missing_bag(tmp_path):
    for command in (["report"], ["export", "-o", tmp_path / "run.npz"]):
        assert "no such file or folder" in refused(hysteresis(*command, tmp_path / "absent"))


def test_bag_without_the_topics(tmp_path):
    with BagWriter(tmp_path / "chat") as writer:
        writer.write_string("/chatter", "hello", 0)
    assert "no axis in it" in refused(hysteresis("report", tmp_path / "chat"))


def test_unreadable_bag(tmp_path):
    (tmp_path / "bag.mcap").write_bytes(b"\x00" * 100)
    assert "not an MCAP file" in refused(hysteresis("report", tmp_path / "bag.mcap"))


def test_wrong_namespace_and_wrong_outputs(bag, tmp_path):
    assert "there is /stage" in refused(hysteresis("report", bag, "--namespace", "left"))
    assert "export writes .npz or .csv" in refused(hysteresis("export", bag, "-o", tmp_path / "run.txt"))
    assert "cannot be written" in refused(hysteresis("export", bag, "-o", tmp_path / "absent" / "run.npz"))


def test_wrong_usage_exits_2_without_traceback():
    for arguments in (["nonsense"], ["report"], ["export", "bag"], ["report", "bag", "--nonsense"]):
        result = hysteresis(*arguments)
        assert "--help" in refused(result)


def test_version():
    from hysteresis_ros import __version__

    assert hysteresis("--version").stdout.strip() == f"hysteresis {__version__}"


def test_help_lists_all_commands_and_imports_none_of_their_libraries():
    code = (
        "import sys; from click.testing import CliRunner; from hysteresis_ros.cli.main import COMMANDS, main\n"
        "text = CliRunner().invoke(main, ['--help']).output\n"
        "assert all(name in text for name in COMMANDS), text\n"
        "heavy = {'numpy', 'rosbags', 'mcap', 'matplotlib', 'scipy', 'numba', 'rclpy'} & set(sys.modules)\n"
        "sys.exit(f'imported: {heavy}' if heavy else 0)"
    )
    result = hysteresis(code=code)
    assert result.returncode == 0, result.stderr


def test_a_table_alone_needs_neither_plots_nor_bags(bag, tmp_path):
    hysteresis("export", bag, "-o", tmp_path / "run.npz")
    code = (
        "import sys; from hysteresis_ros.cli.main import main\n"
        "main(['report', sys.argv[1]], standalone_mode=False)\n"
        "heavy = {'rosbags', 'mcap', 'matplotlib', 'jinja2', 'rclpy'} & set(sys.modules)\n"
        "sys.exit(f'imported: {heavy}' if heavy else 0)"
    )
    result = hysteresis(tmp_path / "run.npz", code=code)
    assert result.returncode == 0, result.stderr
