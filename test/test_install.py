# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The package installs with pip and with colcon: executables, shares and modules are where ROS 2 expects them."""

from __future__ import annotations

import importlib.util
import os
import pathlib
import shutil
import subprocess
import sys
import zipfile

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
EXECUTABLES = {
    "plant_simulator",
    "hysteresis_compensator",
    "motion_controller",
    "reference_generator",
    "inchworm_sequencer",
    "recorder",
    "displacement_camera",
    "hysteresis_axis",
    "hysteresis_stage",
    "hysteresis_array",
    "hysteresis",
}
SHARES = {
    "share/ament_index/resource_index/packages/hysteresis_ros",
    "share/hysteresis_ros/package.xml",
    "share/hysteresis_ros/launch/axis.launch.py",
    *(f"share/hysteresis_ros/{path.relative_to(ROOT)}" for path in (ROOT / "config").rglob("*.*")),
}
#: Modules, templates and assets of pages, and the marker for type information.
MODULES = {
    str(path.relative_to(ROOT))
    for path in (ROOT / "hysteresis_ros").rglob("*")
    if path.suffix in (".py", ".j2", ".typed") or path.parent.name in ("assets", "page")
}


def run(*command, cwd, **variables) -> str:
    """Run a command that must succeed, and return its output."""
    answer = subprocess.run(
        [str(word) for word in command], cwd=cwd, env={**os.environ, **variables}, capture_output=True, text=True
    )
    assert answer.returncode == 0, f"{command} ended with {answer.returncode}:\n{answer.stdout}\n{answer.stderr}"
    return answer.stdout


def relative_files(folder: pathlib.Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def modules_folder(prefix: pathlib.Path) -> pathlib.Path:
    """Return the folder of the package under a prefix."""
    (found,) = prefix.glob("lib/python*/*-packages")
    return found


def check_prefix(prefix: pathlib.Path) -> None:
    """Check an installation as ROS 2 uses it, and start its executable from there."""
    files = relative_files(prefix)
    assert files >= SHARES
    assert files >= {f"lib/hysteresis_ros/{name}" for name in EXECUTABLES}
    assert all(os.access(prefix / "lib/hysteresis_ros" / name, os.X_OK) for name in EXECUTABLES)
    packages = modules_folder(prefix)
    assert relative_files(packages) >= MODULES
    path = os.pathsep.join(filter(None, [str(packages), os.environ.get("PYTHONPATH")]))
    # the sourced environment is this one
    sourced = {"PYTHONPATH": path, "PATH": os.pathsep.join([f"{sys.prefix}/bin", os.environ["PATH"]])}
    text = run(prefix / "lib/hysteresis_ros/hysteresis", "--help", cwd=prefix, **sourced)
    assert "simulate" in text and "report" in text


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> pathlib.Path:
    """A copy of the sources, so that builds leave no files in them."""
    folder = tmp_path_factory.mktemp("workspace") / "hysteresis_ros"
    ignored = shutil.ignore_patterns(".*", "build", "install", "log", "dist", "demo", "__pycache__", "*.egg-info")
    shutil.copytree(ROOT, folder, ignore=ignored)
    return folder


@pytest.fixture(scope="module")
def wheel(tree, tmp_path_factory) -> pathlib.Path:
    """The wheel that pip builds of the tree."""
    for name in ("pip", "setuptools", "wheel"):
        # found without import: setuptools refuses to be imported after Python's own distutils
        if importlib.util.find_spec(name) is None:
            pytest.skip(f"{name} is needed to build the wheel")
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-w", folder, tree, cwd=folder)
    (found,) = folder.glob("*.whl")
    return found


def test_wheel_holds_modules_shares_and_executables(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
    data = wheel.name.split("-py3")[0] + ".data/data/"
    executables = {f"lib/hysteresis_ros/{name}" for name in EXECUTABLES}
    others = {"hysteresis_ros/hardware/hysteresis_driver.h", "hysteresis_ros/laboratory/benchmark/recordings.yaml"}
    assert names == MODULES | others | {data + name for name in SHARES | executables}


def test_pip_installs_what_ros_2_looks_for(wheel, tmp_path):
    options = ["--no-deps", "--no-index", "--no-compile", "--ignore-installed", "--prefix", tmp_path]
    run(sys.executable, "-m", "pip", "install", *options, wheel, cwd=tmp_path)
    check_prefix(tmp_path)
    for name in EXECUTABLES:
        first = (tmp_path / "bin" / name).read_text(encoding="utf-8").splitlines()[0]
        assert first == f"#!{sys.executable}", "the executable runs with the Python it was installed by"


@pytest.mark.parametrize("options", [[], ["--symlink-install"]], ids=["copies", "symlinks"])
def test_colcon_builds_the_package(tree, tmp_path, options):
    # `make ci` installs it into a separate environment; with apt it is on the path
    colcon = shutil.which("colcon", path=f"{sys.prefix}/colcon/bin") or shutil.which("colcon")
    if colcon is None:
        pytest.skip("colcon with its ROS extensions is not installed")
    bases = ["--base-paths", tree, "--build-base", tmp_path / "build", "--install-base", tmp_path / "install"]
    command = [colcon, "--log-base", tmp_path / "log", "build", *bases, *options]
    run(*command, cwd=tmp_path, COLCON_HOME=str(tmp_path), PYTHONDONTWRITEBYTECODE="1")  # no test of bytecode
    prefix = tmp_path / "install" / "hysteresis_ros"
    if options:
        assert relative_files(prefix) >= SHARES | {f"lib/hysteresis_ros/{name}" for name in EXECUTABLES}
        assert (prefix / "share/hysteresis_ros/package.xml").resolve() == tree / "package.xml"
    else:
        check_prefix(prefix)
    for name in EXECUTABLES:
        first = (prefix / "lib" / "hysteresis_ros" / name).read_text(encoding="utf-8").splitlines()[0]
        assert first == "#!/usr/bin/env python3", "the Python of the environment that is sourced, not colcon's own"
