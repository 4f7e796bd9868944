# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Install hysteresis_ros: with pip, with colcon (ament_python), or with pip on top of an apt-installed ROS 2."""

import pathlib
import re

import setuptools
from setuptools import find_packages, setup
from setuptools.command.develop import develop

try:
    from setuptools.command.bdist_wheel import bdist_wheel
except ImportError:  # setuptools < 70.1, as on Ubuntu 24.04
    try:
        from wheel.bdist_wheel import bdist_wheel
    except ImportError:  # colcon builds no wheel
        bdist_wheel = None

NAME = "hysteresis_ros"
ROOT = pathlib.Path(__file__).resolve().parent
SHARE = f"share/{NAME}"

#: Executables that `ros2 run` and launch files start, and where their main function is.
NODES = {
    "plant_simulator": "hysteresis_ros.nodes.plant_simulator:main",
    "hysteresis_compensator": "hysteresis_ros.nodes.hysteresis_compensator:main",
    "motion_controller": "hysteresis_ros.nodes.motion_controller:main",
    "reference_generator": "hysteresis_ros.nodes.reference_generator:main",
    "inchworm_sequencer": "hysteresis_ros.nodes.inchworm_sequencer:main",
    "recorder": "hysteresis_ros.nodes.recorder:main",
    "displacement_camera": "hysteresis_ros.nodes.displacement_camera:main",
    "hysteresis_axis": "hysteresis_ros.nodes.axis:main",
    "hysteresis_stage": "hysteresis_ros.nodes.stage:main",
    "hysteresis_array": "hysteresis_ros.nodes.axis_array:main",
}
#: SPDX expression: the package itself, and uPlot, which its pages carry in themselves.
LICENCE = "Apache-2.0 AND MIT"
#: Metadata 2.4 has a field for SPDX expressions (setuptools 77); Ubuntu 24.04 has setuptools 68.
LICENCE_FIELD = "license_expression" if int(setuptools.__version__.split(".")[0]) >= 77 else "license"
COMMANDS = {"hysteresis": "hysteresis_ros.cli.entry:main"}

EXTRAS = {
    # The real rclpy and Fast DDS of Jazzy as wheels, for machines without apt ROS (Linux, CPython 3.11 to 3.13).
    "ros": ["ros-jazzy-rclpy", "ros-jazzy-common-interfaces", "ros-rclpy[fastrtps]==7.1.6"],
    "fast": ["numba"],
    "report": ["matplotlib", "jinja2"],
    # reading pictures and videos; the images of a topic need nothing of it
    "camera": ["opencv-python-headless"],
    # bars on terminals; without it commands say in lines how far they are
    "progress": ["rich"],
    # results of sweeps as Parquet, sensitivities of Sobol and Morris
    "sweep": ["pyarrow", "SALib"],
    # the same sweep on many machines
    "cluster": ["distributed"],
    # the live page
    "watch": ["aiohttp"],
    "notebook": ["pandas"],
    # exchange of linear systems with python-control
    "control": ["control"],
    # the makers' package has wheels for 3.12 and 3.13 only
    "nv200": ["nv200>=1.6,<2; python_version >= '3.12'"],
    # EPICS motor records, in pure Python
    "epics": ["caproto"],
    # an axis as a device of bluesky
    "bluesky": ["ophyd-async>=0.13", "bluesky"],
}
EXTRAS["all"] = sorted({requirement for requirements in EXTRAS.values() for requirement in requirements})
# Not part of "all": what makes the pages and runs the notebooks, for those who change them.
EXTRAS["docs"] = [
    *("sphinx", "myst-nb", "myst-parser", "numpydoc>=1.8", "furo", "latex2mathml"),
    *("nbclient", "nbformat", "ipykernel"),
]
# The last two are here because the tests build and install the package, as colcon does, which needs setuptools below 80
# (`make ci` gives colcon itself an environment of its own).
EXTRAS["test"] = [
    *("pytest", "pytest-rerunfailures", "pytest-xdist", "hypothesis", "psutil"),
    *("setuptools<80", "wheel"),
]
# Checks of the sources. Their verdict hangs on their version and on that of what they look at: see constraints.txt.
EXTRAS["lint"] = ["ruff", "mypy", "numpydoc>=1.8", "codespell"]
# `make coverage` has it in a folder of its own: Numba imports it wherever it finds it, in every node.
EXTRAS["coverage"] = ["coverage"]

#: pip puts executables into bin/, with the Python of the environment in their first line, and never into lib/; only
#: colcon obeys setup.cfg. This file stands in lib/hysteresis_ros of a wheel under each name and hands over to bin/.
HAND_OVER = """\
#!/bin/sh
# ros2 run and launch look for executables here; pip installs them in bin/.
exec "$(dirname "$0")/../../bin/$(basename "$0")" "$@"
"""


def version():
    """Return ``hysteresis_ros.__version__`` without importing the package."""
    text = (ROOT / NAME / "__init__.py").read_text(encoding="utf-8")
    return re.search(r'^__version__ = "(.+)"$', text, re.MULTILINE).group(1)


def files(pattern):
    """Return the paths that match, relative to this file as data_files wants them."""
    return sorted(str(path.relative_to(ROOT)) for path in ROOT.glob(pattern))


def command_classes():
    """Return the wheel command that adds the files of lib/hysteresis_ros."""
    if bdist_wheel is None:
        return {}

    class BuildWheel(bdist_wheel):
        """Build a wheel whose executables are found by ``ros2 run`` too."""

        def run(self):
            """Write the files that hand over to bin/, then build the wheel with them."""
            folder = pathlib.Path(self.get_finalized_command("build").build_temp) / "executables"
            folder.mkdir(parents=True, exist_ok=True)
            paths = [folder / name for name in [*NODES, *COMMANDS]]
            for path in paths:
                path.write_text(HAND_OVER, encoding="utf-8")
                path.chmod(0o755)
            self.distribution.data_files.append((f"lib/{NAME}", [str(path) for path in paths]))
            super().run()

    return {"bdist_wheel": BuildWheel}


class Develop(develop):
    """What ``colcon build --symlink-install`` runs: executables for the Python of the environment that is sourced.

    ``[build_scripts]`` in setup.cfg says the same of a build with copies, and is not asked here.
    """

    def write_script(self, script_name, contents, *options):
        """Write an executable with another first line."""
        super().write_script(script_name, "#!/usr/bin/env python3\n" + contents.partition("\n")[2], *options)


setup(
    name=NAME,
    version=version(),
    description="Hysteretic piezo positioning on ROS 2: identify, simulate, compensate, control, analyse",
    maintainer="hysteresis_ros maintainers",
    maintainer_email="hysteresis-ros@users.noreply.github.com",
    python_requires=">=3.11",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={
        NAME: ["py.typed"],
        f"{NAME}.analysis": ["templates/*.j2", "assets/*"],
        f"{NAME}.hardware": ["*.h"],
        f"{NAME}.laboratory.benchmark": ["*.yaml"],
        f"{NAME}.laboratory.watch": ["page/*"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (SHARE, ["package.xml"]),
        (f"{SHARE}/config", files("config/*.yaml")),
        (f"{SHARE}/config/diagnostics", files("config/diagnostics/*.yaml")),
        (f"{SHARE}/config/layouts", files("config/layouts/*")),
        (f"{SHARE}/launch", files("launch/*.launch.py")),
    ],
    install_requires=["numpy>=1.26", "scipy>=1.11", "pyyaml", "click", "rosbags>=0.11,<0.12", "mcap"],
    extras_require=EXTRAS,
    zip_safe=False,
    entry_points={"console_scripts": [f"{name} = {main}" for name, main in {**NODES, **COMMANDS}.items()]},
    **{LICENCE_FIELD: LICENCE},
    cmdclass={**command_classes(), "develop": Develop},
)
