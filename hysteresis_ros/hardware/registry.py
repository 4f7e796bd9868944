# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Registry of the drivers in the folder ``drivers`` and in other packages (entry points); drivers at a given path."""

from __future__ import annotations

import functools
import hashlib
import importlib.machinery
import importlib.util
import pathlib
import sys
from dataclasses import replace
from typing import Any

import hysteresis_ros.hardware.drivers  # noqa: F401  (the registry searches its folder)
from hysteresis_ros.configuration import ParameterRow, Parameters
from hysteresis_ros.errors import ParameterError, Problem, did_you_mean
from hysteresis_ros.hardware.driver import DriverError, HardwareDriver
from hysteresis_ros.hardware.library import SUFFIXES, LibraryParameters, library_driver, require_trusted
from hysteresis_ros.registry import discover

#: Group of entry points with which a package adds a driver: ``my_stage = my_package.my_stage:DRIVER``.
GROUP = "hysteresis_ros.drivers"

#: The declaration of each driver, by name.
DRIVERS: dict[str, HardwareDriver] = discover("hysteresis_ros.hardware.drivers", "DRIVER", HardwareDriver, GROUP)


_TRUTHS = {"true": True, "false": False}


class _FromSource(importlib.machinery.SourceFileLoader):
    """Loader that compiles a file each time; it ignores cached bytecode, which another user might have changed."""

    def get_code(self, fullname: str):
        """Return the code of the file."""
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)


def driver_of(name: str) -> HardwareDriver:
    """Return the driver that a parameter file names; a name with a slash is a path, any other is in the registry.

    DriverError: the driver does not exist, or the file is not a driver.
    """
    if name in DRIVERS:
        return DRIVERS[name]
    if "/" not in name:
        known = ", ".join(DRIVERS)
        remedy = f"choose one of {known} or give a path that contains a /{did_you_mean(name, DRIVERS)}"
        raise DriverError(f"driver {name}", "is not known", remedy)
    return _driver_at(str(pathlib.Path(name).expanduser().absolute()))


@functools.cache
def _driver_at(path: str) -> HardwareDriver:
    if path.endswith(SUFFIXES):
        return library_driver(pathlib.Path(path))
    if not path.endswith(".py"):
        remedy = f"give a Python file that declares DRIVER, or a shared library ({' or '.join(SUFFIXES)})"
        raise DriverError(f"driver {path}", "is neither a Python file nor a shared library", remedy)
    return _declared_in(pathlib.Path(path))


def _declared_in(path: pathlib.Path) -> HardwareDriver:
    """Return the driver that a Python file declares."""
    where = f"driver {path}"
    if not path.is_file():
        raise DriverError(where, "does not exist", "give the path of a Python file that declares DRIVER")
    require_trusted(path)
    # pickling, dataclasses and cached machine code look the module up by this name, also in other processes
    name = f"hysteresis_driver_{hashlib.sha256(str(path).encode()).hexdigest()[:16]}"
    specification: Any = importlib.util.spec_from_file_location(name, path, loader=_FromSource(name, str(path)))
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module
    try:
        specification.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        if isinstance(error, DriverError):
            raise
        raise DriverError(where, f"cannot be loaded: {type(error).__name__}: {error}", "correct the file") from error
    declared = getattr(module, "DRIVER", None)
    if not isinstance(declared, HardwareDriver):
        remedy = "DRIVER = HardwareDriver(…), see docs/extending.md"
        raise DriverError(where, f"declares no driver: DRIVER is {declared!r}", remedy)
    return replace(declared, name=str(path))


def options_of(declared: HardwareDriver, options: tuple[str, ...]) -> Parameters:
    """Return the parameters in the options ``NAME=VALUE`` of a parameter file, for a driver at a path.

    ParameterError: an option has another form, or the driver refuses it.
    """
    if declared.parameters is LibraryParameters:
        return LibraryParameters(options)
    rows = {row.name: row for row in declared.parameters.table()}
    values, problems = {}, []
    for option in options:
        name, mark, text = option.partition("=")
        try:
            if not mark:
                raise ValueError
            values[name] = _value_of(rows.get(name), text)
        except ValueError:
            remedy = "write NAME=VALUE"
            if name in rows:
                remedy += f" with a {rows[name].allowed()}"
            problems.append(Problem("driver_options", option, remedy))
    if problems:
        raise ParameterError(problems)
    return declared.parameters.from_mapping(values, prefix="driver_options: ")


def _value_of(row: ParameterRow | None, text: str):
    """Return the value in a text, with the type that the parameter's row declares."""
    if row is None or row.type is str:
        return text
    if row.type is bool:
        if text not in _TRUTHS:
            raise ValueError
        return _TRUTHS[text]
    if row.type in (int, float):
        return row.type(text)
    item = float if row.type == tuple[float, ...] else str
    return tuple(item(part) for part in text.split(",") if part)
