# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Drivers in C: a shared library with the functions of ``hysteresis_driver.h``, loaded only from trusted folders.

The file and every folder on its path are checked, including the targets of symbolic links, as sshd does for keys. They
must belong to root, to the user of this process, or to the owner of this package, and no other user may write to them.
A folder with the sticky bit, such as ``/tmp``, may be writable for all users, because only the owner of an entry can
remove or rename it, and the entry is checked next. A group may have write permission if it has no other members, such
as the private group of a user on many systems. Access control lists are not checked.
"""

from __future__ import annotations

import ctypes
import grp
import math
import os
import pathlib
import pwd
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from hysteresis_ros.configuration import Parameters, parameter
from hysteresis_ros.hardware.driver import (
    NOTHING_NEW,
    Capabilities,
    Compiled,
    Driver,
    DriverError,
    HardwareDriver,
    Reading,
)
from hysteresis_ros.signals import Edge

#: Environment variable with the only folders from which drivers are loaded; if it is not set, any folder.
FOLDERS = "HYSTERESIS_DRIVERS"


def require_trusted(path: pathlib.Path) -> pathlib.Path:
    """Return the real path of an existing file; refuse a file that another user can change.

    DriverError: other users can change the file or a folder on its path, or it is outside the folders of
    ``HYSTERESIS_DRIVERS``; the message names the file or folder, the user, and the remedy.
    """
    name = f"driver {path}"
    real = path.resolve()
    folders = os.environ.get(FOLDERS)
    if folders is not None and not any(
        real.is_relative_to(pathlib.Path(folder).expanduser().resolve())
        for folder in folders.split(os.pathsep)
        if folder
    ):
        remedy = f"move it to one of these folders, or add its folder to {FOLDERS}"
        raise DriverError(name, f"is not loaded: it is outside the folders {FOLDERS}={folders}", remedy)
    trusted = {0, os.geteuid(), pathlib.Path(__file__).stat().st_uid}
    for place in _on_the_way(path.absolute()):
        problem, remedy = _alterable(place, trusted)
        if problem:
            raise DriverError(name, f"is not loaded: {problem}; another user could replace the code", remedy)
    return real


def _on_the_way(path: pathlib.Path) -> Iterator[pathlib.Path]:
    """Yield all folders and symbolic links on the path of an existing file, then the file."""
    ahead, here = list(reversed(path.parts[1:])), pathlib.Path(path.anchor)
    yield here
    while ahead:
        part = ahead.pop()
        place = here.parent if part == ".." else here / part
        yield place
        if place.is_symlink():
            target = place.readlink()
            here = pathlib.Path(target.anchor) if target.is_absolute() else here
            ahead += reversed(target.parts[1:] if target.is_absolute() else target.parts)
        else:
            here = place


def _alterable(place: pathlib.Path, trusted: set[int]) -> tuple[str, str]:
    """Return how another user can change a file, a folder or a link, and the remedy; empty texts if none can."""
    found = place.lstat()
    if found.st_uid not in trusted:
        whose = f"{place} belongs to {_user(found.st_uid)}"
        return whose, f"make it yours (chown {_user(os.geteuid())} {place}), or copy the driver to a folder of your own"
    if stat.S_ISLNK(found.st_mode):
        return "", ""  # only its owner, or a user with write access to its folder, can change the target of a link
    mode = f"{place} (mode {stat.S_IMODE(found.st_mode):04o})"
    sticky = stat.S_ISDIR(found.st_mode) and found.st_mode & stat.S_ISVTX
    if found.st_mode & stat.S_IWOTH and not sticky:
        return f"{mode} can be written by all users", f"chmod o-w {place}"
    if found.st_mode & stat.S_IWGRP and not sticky:
        others = _members(found.st_gid) - trusted
        if others:
            users = ", ".join(sorted(map(_user, others)))
            return f"{mode} can be written by its group, and so by {users}", f"chmod g-w {place}"
    return "", ""


def _members(group: int) -> set[int]:
    """Return the users of a group: its members, and users whose primary group it is."""
    users = pwd.getpwall()
    try:
        named = set(grp.getgrgid(group).gr_mem)
    except KeyError:  # the group does not exist on this machine, so it has no members
        named = set()
    return {user.pw_uid for user in users if user.pw_gid == group or user.pw_name in named}


def _user(number: int) -> str:
    """Return the name of a user; without a name, the number."""
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return f"user {number}"


#: Functions that a driver must have; the first two are called in each sample.
FUNCTIONS = ("hysteresis_read", "hysteresis_write", "hysteresis_open", "hysteresis_make_safe", "hysteresis_close")
#: Optional functions.
DESCRIBE, CLOCK = "hysteresis_describe", "hysteresis_clock"
TRIGGER, PULSES = "hysteresis_trigger", "hysteresis_pulses"

#: Suffixes of shared libraries.
SUFFIXES = (".so", ".dylib")


class _Capabilities(ctypes.Structure):
    """``struct hysteresis_capabilities``."""

    _fields_ = (
        *((name, ctypes.c_int32) for name in ("joints", "voltages", "keeps_time", "reserved")),
        *((name, ctypes.c_double) for name in ("minimum", "maximum", "highest_rate", "watchdog")),
        *((name, ctypes.c_char * 8) for name in ("position_unit", "voltage_unit")),
    )


@dataclass(frozen=True)
class LibraryParameters(Parameters):
    """Parameters of a shared library without a Python class of its own."""

    options: tuple[str, ...] = parameter((), description="options for hysteresis_open, each NAME=VALUE")


def loaded(path: str | pathlib.Path) -> ctypes.CDLL:
    """Return a shared library that has all functions of a driver.

    Parameters
    ----------
    path : path-like

    Raises
    ------
    DriverError
        The library does not exist, another user could replace it, or functions are missing; the message names them.
    """
    path = pathlib.Path(path).expanduser()
    name = f"library {path}"
    if not path.is_file():
        raise DriverError(name, "does not exist", "build it, or correct its path")
    try:
        library = ctypes.CDLL(str(require_trusted(path)))
    except OSError as error:
        raise DriverError(
            name, f"cannot be loaded ({error})", "build it for this machine as a shared library"
        ) from None
    missing = [function for function in FUNCTIONS if not hasattr(library, function)]
    if missing:
        raise DriverError(
            name, f"has no function {', '.join(missing)}", "a driver in C needs the functions of hysteresis_driver.h"
        )
    pointer, code = ctypes.c_void_p, ctypes.c_int32
    library.hysteresis_read.argtypes = library.hysteresis_write.argtypes = pointer, pointer
    library.hysteresis_open.argtypes = pointer, ctypes.c_double, pointer, pointer
    library.hysteresis_make_safe.argtypes = library.hysteresis_close.argtypes = (pointer,)
    for function in FUNCTIONS:
        getattr(library, function).restype = code
    library.hysteresis_close.restype = None
    if hasattr(library, DESCRIBE):
        library.hysteresis_describe.argtypes, library.hysteresis_describe.restype = (code,), ctypes.c_char_p
    if hasattr(library, CLOCK):
        library.hysteresis_clock.argtypes, library.hysteresis_clock.restype = (pointer, ctypes.c_int64), code
    if hasattr(library, TRIGGER):
        arguments = pointer, ctypes.c_int64, ctypes.c_double
        library.hysteresis_trigger.argtypes, library.hysteresis_trigger.restype = arguments, code
    if hasattr(library, PULSES):
        library.hysteresis_pulses.argtypes, library.hysteresis_pulses.restype = (pointer, pointer), code
    return library


def option_texts(parameters: Parameters) -> list[str]:
    """Return parameters as the options ``NAME=VALUE`` of a library."""
    if isinstance(parameters, LibraryParameters):
        return list(parameters.options)
    texts = []
    for name, value in parameters.to_mapping().items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        texts.append(f"{name}={text}")
    return texts


class SharedLibrary(Driver):
    """A driver in C; a subclass for each library states its path.

    The functions of the library are called by their addresses, or through ctypes, which releases the interpreter lock.
    """

    #: The library.
    path: str | pathlib.Path

    _device: ctypes.c_void_p | None = None

    def open(self, parameters: Parameters, sample_rate: float) -> Capabilities:
        """Load the library and open its device.

        Parameters
        ----------
        parameters : Parameters
            Options for ``hysteresis_open``: the entries, or the texts in an instance of :class:`LibraryParameters`.
        sample_rate : float
            [Hz]

        Raises
        ------
        DriverError
            The library is not a driver, or its device cannot be opened.
        """
        self._library = loaded(self.path)
        texts = [text.encode() for text in option_texts(parameters)]
        options, can, device = (ctypes.c_char_p * (len(texts) + 1))(*texts), _Capabilities(), ctypes.c_void_p()
        code = self._library.hysteresis_open(options, sample_rate, ctypes.byref(can), ctypes.byref(device))
        if code:
            raise self._error(code)
        self._device = device
        self._positions = (ctypes.c_double * max(can.joints, 1))()
        self._voltages = (ctypes.c_double * max(can.voltages, 1))()
        watchdog = can.watchdog if can.watchdog > 0.0 else None
        units = can.position_unit.decode(errors="replace"), can.voltage_unit.decode(errors="replace")
        limits = can.minimum, can.maximum, can.highest_rate
        given = self._library
        extras: dict[str, Any] = {"clock": hasattr(given, CLOCK), "trigger_input": hasattr(given, PULSES)}
        extras["trigger_rate"] = can.highest_rate if hasattr(given, TRIGGER) else 0.0
        return Capabilities(can.joints, can.voltages, *limits, watchdog, bool(can.keeps_time), *units, **extras)

    def _error(self, code: int) -> DriverError:
        """Return the exception for an error code."""
        text = f"reports error {code}"
        if hasattr(self._library, DESCRIBE):
            text = (self._library.hysteresis_describe(code) or text.encode()).decode(errors="replace")
        problem, _, remedy = text.partition(";")
        name = f"{pathlib.Path(self.path).name}:"
        return DriverError(name, problem.strip(), remedy.strip() or "check the device and its driver")

    def read(self) -> Reading:
        """Return the positions; NaN without a new measurement.

        Raises
        ------
        DriverError
            The library reports an error, or a position is not a number.
        """
        code = self._library.hysteresis_read(self._device, self._positions)
        if code == NOTHING_NEW:
            return Reading((math.nan,) * len(self._positions))
        if code:
            raise self._error(code)
        if not all(map(math.isfinite, self._positions)):
            raise nonsense(pathlib.Path(self.path).name)
        return Reading(tuple(self._positions))

    def write(self, voltages: Sequence[float]) -> None:
        """Output the voltages.

        Parameters
        ----------
        voltages : sequence of float
            [V]

        Raises
        ------
        DriverError
            The library reports an error.
        """
        for place, voltage in enumerate(voltages):
            self._voltages[place] = voltage
        self._check(self._library.hysteresis_write(self._device, self._voltages))

    def output_clock(self, edges: Edge) -> None:
        """Output the scan edges of this sample: the beginnings of frames, lines and pixels.

        Parameters
        ----------
        edges : Edge

        Raises
        ------
        DriverError
            The library has no such function, or reports an error.
        """
        if not hasattr(self._library, CLOCK):
            super().output_clock(edges)
        self._check(self._library.hysteresis_clock(self._device, int(edges)))

    def output_trigger(self, number: int, delay: float) -> None:
        """Output a trigger.

        Parameters
        ----------
        number : int
        delay : float
            Time from the trigger to the sample [s].

        Raises
        ------
        DriverError
            The library has no such function, or reports an error.
        """
        if not hasattr(self._library, TRIGGER):
            super().output_trigger(number, delay)
        self._check(self._library.hysteresis_trigger(self._device, number, delay))

    def pulses(self) -> int:
        """Return the number of pulses at the trigger input since the last call.

        Raises
        ------
        DriverError
            The library has no such function, or reports an error.
        """
        if not hasattr(self._library, PULSES):
            return super().pulses()
        count = ctypes.c_int64()
        self._check(self._library.hysteresis_pulses(self._device, ctypes.byref(count)))
        return count.value

    def make_safe(self) -> None:
        """Bring the device to its safe state.

        Raises
        ------
        DriverError
            The library reports an error.
        """
        self._check(self._library.hysteresis_make_safe(self._device))

    def _check(self, code: int) -> None:
        if code:
            raise self._error(code)

    def compiled(self) -> Compiled:
        """Return the addresses of the functions that are called in each sample."""
        library = self._library

        def address(name: str) -> int:
            return ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0 if hasattr(library, name) else 0

        names = "hysteresis_read", "hysteresis_write", "hysteresis_make_safe", CLOCK, TRIGGER, PULSES
        read, write, make_safe, clock, trigger, pulses = map(address, names)
        device = self._device.value if self._device is not None else None
        return Compiled(read, write, make_safe, device or 0, self._error, clock, trigger, pulses)

    def close(self) -> None:
        """Release the device."""
        if self._device is not None:
            device, self._device = self._device, None
            self._library.hysteresis_close(device)


def nonsense(name: str) -> DriverError:
    """Return the error for the device ``name`` if it returns a position that is not a number."""
    return DriverError(f"{name}:", "returns a position that is not a number", "check the sensor and its scaling")


def library_driver(path: pathlib.Path) -> HardwareDriver:
    """Return the driver in a shared library, which ``driver_options`` configure; DriverError: not a driver."""
    loaded(path)
    driver = type("SharedLibrary", (SharedLibrary,), {"path": path})
    return HardwareDriver(name=str(path), title="a shared library", parameters=LibraryParameters, driver=driver)
