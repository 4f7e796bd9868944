# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Code that is loaded by its path: only where nobody else can put another file in its place.

As sshd does with keys, the file and every folder on the way to it are looked at, those behind symbolic links too. They
must belong to root, to the user of this process, or to whom this package belongs, who could change that as well; and no
others may write them. A folder with the sticky bit, such as ``/tmp``, may be written by all: what lies in it can be
taken away or renamed only by its owner, who is looked at next. A group may write when it has no members but those, as
the group of one's own that many systems give each user. Access control lists are not looked at.
"""

from __future__ import annotations

import grp
import os
import pathlib
import pwd
import stat
from collections.abc import Iterator

from hysteresis_ros.hardware.driver import DriverError

#: Environment variable: folders beside which no driver is loaded from; not set: from wherever a parameter file says.
FOLDERS = "HYSTERESIS_DRIVERS"


def require_trusted(path: pathlib.Path) -> pathlib.Path:
    """Return where a file really is, if nobody else can change what stands there.

    Parameters
    ----------
    path : pathlib.Path
        Of a file that is there.

    Raises
    ------
    DriverError
        Others can change it, or a folder on the way to it, or it lies outside of the folders of ``HYSTERESIS_DRIVERS``;
        the message names which, who, and what to do.
    """
    name = f"driver {path}"
    real = path.resolve()
    folders = os.environ.get(FOLDERS)
    if folders is not None and not any(
        real.is_relative_to(pathlib.Path(folder).expanduser().resolve())
        for folder in folders.split(os.pathsep)
        if folder
    ):
        remedy = f"put it there, or add its folder to {FOLDERS}"
        raise DriverError(name, f"is not loaded: it lies in none of the folders {FOLDERS}={folders}", remedy)
    trusted = {0, os.geteuid(), pathlib.Path(__file__).stat().st_uid}
    for place in _on_the_way(path.absolute()):
        problem, remedy = _alterable(place, trusted)
        if problem:
            raise DriverError(name, f"is not loaded: {problem}, who could put other code there", remedy)
    return real


def _on_the_way(path: pathlib.Path) -> Iterator[pathlib.Path]:
    """Yield the folders and symbolic links that are passed on the way to a file that is there, and the file."""
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
    """Return who else can change a file, a folder or a link, and what to do about it; empty texts when nobody can."""
    found = place.lstat()
    if found.st_uid not in trusted:
        whose = f"{place} belongs to {_user(found.st_uid)}"
        return whose, f"make it yours (chown {_user(os.geteuid())} {place}), or copy the driver to a folder of your own"
    if stat.S_ISLNK(found.st_mode):
        return "", ""  # what a link says can be changed by its owner and in its folder only
    mode = f"{place} (mode {stat.S_IMODE(found.st_mode):04o})"
    sticky = stat.S_ISDIR(found.st_mode) and found.st_mode & stat.S_ISVTX
    if found.st_mode & stat.S_IWOTH and not sticky:
        return f"{mode} can be written by everybody", f"chmod o-w {place}"
    if found.st_mode & stat.S_IWGRP and not sticky:
        others = _members(found.st_gid) - trusted
        if others:
            who = ", ".join(sorted(map(_user, others)))
            return f"{mode} can be written by its group, and so by {who}", f"chmod g-w {place}"
    return "", ""


def _members(group: int) -> set[int]:
    """Return the users of a group: those it names, and those whose own group it is."""
    users = pwd.getpwall()
    try:
        named = set(grp.getgrgid(group).gr_mem)
    except KeyError:  # no such group here, and so nobody in it
        named = set()
    return {user.pw_uid for user in users if user.pw_gid == group or user.pw_name in named}


def _user(number: int) -> str:
    """Return the name of a user, or the number of one who has none here."""
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return f"user {number}"
