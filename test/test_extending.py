# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""docs/extending.md as printed: its files are written where it says, and its commands are run."""

from __future__ import annotations

import importlib.util
import os
import pathlib
import re
import shutil
import subprocess
import sys

import pytest
from stage_support import needs_compiler

import hysteresis_ros
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.hardware.device import Device
from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.hardware.registry import driver_of, options_of

ROOT = pathlib.Path(__file__).resolve().parents[1]
DOCUMENT = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
#: Values for the placeholders in the commands of the document; `make test` needs no tool of `make lint`.
RUFF = "-m ruff" if importlib.util.find_spec("ruff") else "-c pass"
TOOLS = {"hysteresis": "-m hysteresis_ros.cli.main", "pytest": "-m pytest", "ruff": RUFF, "python": ""}

CONTRACTS = ("test_registries", "test_registries_control", "test_registries_hardware")


def printed(chapter: str, language: str) -> str:
    """Return the only block of a language in a chapter."""
    text = re.search(rf"^## {chapter}\n(.*?)(?=^## |\Z)", DOCUMENT, re.MULTILINE | re.DOTALL).group(1)
    blocks = re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 1, f"{chapter}: {len(blocks)} blocks of {language}"
    return blocks[0]


def run(script: str, folder: pathlib.Path, *places: pathlib.Path, **environment) -> str:
    """Run a shell script in a folder, with packages from these places before all others."""
    tools = folder / "bin"
    tools.mkdir(exist_ok=True)
    for name, arguments in TOOLS.items():
        (tools / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {arguments} "$@"\n')
        (tools / name).chmod(0o755)
    path = os.pathsep.join([str(tools), os.environ["PATH"]])
    packages = os.pathsep.join([*map(str, places), *filter(None, sys.path)])
    environment = {**os.environ, "PATH": path, "PYTHONPATH": packages, "PYTHONSAFEPATH": "1", **environment}
    done = subprocess.run(
        ["sh", "-e", "-c", script], cwd=folder, env=environment, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


#: Where a chapter puts its file.
FILES = {
    "A hysteresis model": "models/hysteresis/dahl.py",
    "A controller": "control/laws/leaky_pi.py",
    "A reference": "references/waveforms/trapezoid.py",
    "A driver": "hardware/drivers/tcp_stage.py",
}


@pytest.fixture(scope="module")
def copy(tmp_path_factory) -> pathlib.Path:
    """A copy of the package with the file of each chapter, configurations, contract tests and tables of parameters."""
    folder, package = tmp_path_factory.mktemp("copy"), pathlib.Path(hysteresis_ros.__file__).parent
    shutil.copytree(package, folder / "hysteresis_ros", ignore=shutil.ignore_patterns("__pycache__"))
    tests = [f"test/{name}.py" for name in (*CONTRACTS, "stage_support")]
    for name in ("docs/parameters.md", *tests, "pyproject.toml"):
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, folder / name)
    shutil.copytree(ROOT / "config", folder / "config")
    for chapter, place in FILES.items():
        (folder / "hysteresis_ros" / place).write_text(printed(chapter, "python"))
    # the contract tests compare the tables of parameters with the declarations
    path = folder / "docs" / "parameters.md"
    head = path.read_text(encoding="utf-8").split("## Every node")[0]
    path.write_text(head + run("hysteresis parameters", folder, folder, NUMBA_DISABLE_JIT="1"), encoding="utf-8")
    return folder


def test_a_hysteresis_model_is_one_file(copy):
    output = run(printed("A hysteresis model", "sh"), copy, copy, NUMBA_DISABLE_JIT="1")
    assert output.startswith("dahl: Dahl's friction curve") and "width [V]" in output
    assert re.search(r"^rmse_percent_of_stroke +0\.0\d", output, re.MULTILINE)
    # the skipped test is the comparison with compiled kernels
    assert re.search(r"^=+ 17 passed, 1 skipped", output, re.MULTILINE), "the contract test missed the new model"
    found = load_configuration(copy / "found.yaml").node("plant_simulator")
    given = load_configuration(copy / "dahl.yaml").node("plant_simulator")
    for name in ("gain", "share"):
        wanted = given[f"hysteresis.dahl.{name}"]
        assert found[f"hysteresis.dahl.{name}"] == pytest.approx(wanted, rel=0.03)


@pytest.fixture(scope="module")
def outside(tmp_path_factory) -> pathlib.Path:
    """A separate package with the file of each chapter, and its entry points as printed."""
    folder = tmp_path_factory.mktemp("outside")
    package, information = folder / "my_package", folder / "my_package-1.0.dist-info"
    package.mkdir()
    information.mkdir()
    (package / "__init__.py").touch()
    entries = ""
    for chapter, place in FILES.items():
        group, entry = re.search(r'entry-points\."(.+)"\]\n(.+)\n', printed(chapter, "toml"), re.MULTILINE).groups()
        (package / pathlib.Path(place).name).write_text(printed(chapter, "python"))
        entries += f"[{group}]\n{entry}\n".replace('"', "")
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: my_package\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(entries)
    return folder


def test_models_controllers_references_and_drivers_may_be_in_a_package_of_their_own(outside):
    """With compiled kernels."""
    assert "type: dahl" in run("hysteresis models dahl --yaml", outside, outside)
    files = " ".join(f"{ROOT}/test/{name}.py" for name in CONTRACTS)
    chosen = (
        "(dahl and (plain_python or inverses or fitted)) or ((leaky_pi or trapezoid) and plain_python)"
        " or (tcp_stage and (moves or master))"
    )
    output = run(f"pytest -v {files} -k '{chosen}'", outside, outside)
    for name, count in {"dahl": 4, "leaky_pi": 1, "trapezoid": 1, "tcp_stage": 2}.items():
        assert len(re.findall(rf"^\S+\[{name}(-\w+)?\] PASSED", output, re.MULTILINE)) == count, output
    assert re.search(r"^=+ 8 passed", output, re.MULTILINE), output


def passed(output: str) -> int:
    """Return the number of passed tests if none failed; only the comparison with compiled code is skipped."""
    found = re.search(r"^=+ (\d+) passed, 1 skipped, \d+ deselected", output, re.MULTILINE)
    assert found, output
    return int(found.group(1))


def test_a_controller_is_one_file(copy):
    output = run(printed("A controller", "sh"), copy, copy, NUMBA_DISABLE_JIT="1")
    assert re.search(r"^bandwidth reached +10 Hz", output, re.MULTILINE) and "type leaky_pi" in output
    # alone, and in succession with every other controller
    assert passed(output) >= 16
    assert load_configuration(copy / "leaky.yaml").node("motion_controller")["type"] == "leaky_pi"


def test_a_reference_is_one_file(copy):
    output = run(printed("A reference", "sh"), copy, copy, NUMBA_DISABLE_JIT="1")
    assert "from 0.0 to 2e-05 m" in output
    assert passed(output) == 8


def test_a_driver_is_one_file(copy):
    """Its emulator is a device with its own clock, over TCP."""
    (copy / "stage.yaml").write_text(printed("A driver", "yaml"))
    output = run(printed("A driver", "sh"), copy, copy, NUMBA_DISABLE_JIT="1")
    assert "planned.npz: 50 samples at 100 Hz" in output
    assert re.search(r"^=+ 9 passed, \d+ deselected", output, re.MULTILINE), output


@needs_compiler
def test_a_driver_in_c_is_one_library(tmp_path):
    (tmp_path / "bench.c").write_text(printed("A driver in C", "c"))
    (tmp_path / "bench.yaml").write_text(printed("A driver in C", "yaml"))
    output = run(printed("A driver in C", "sh"), tmp_path, ROOT, NUMBA_DISABLE_JIT="1")
    assert "planned.npz: 2500 samples at 5000 Hz" in output
    declared = driver_of(str(tmp_path / "libbench.so"))
    device = Device(declared, options_of(declared, ()), 5000.0)
    assert device.capabilities.maximum == 100.0 and device.compiled() is not None
    for _ in range(100):
        device.write([50.0])
        position = device.read()[0]
    assert position == pytest.approx(5e-6)
    device.make_safe()
    device.close()
    with pytest.raises(DriverError, match="libbench.so: takes no options; leave driver_options out"):
        Device(declared, options_of(declared, ("name=bench",)), 5000.0)
