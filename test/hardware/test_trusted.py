# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Drivers are loaded only from places to which no other user can write; usual installations remain possible."""

from __future__ import annotations

import os
import pathlib
import pwd
import py_compile
import tempfile
from types import SimpleNamespace

import pytest

from hysteresis_ros.hardware import library as trusted
from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.hardware.library import FOLDERS, loaded, require_trusted
from hysteresis_ros.hardware.registry import driver_of

#: A user id that is neither root nor the current user, and one with a name.
STRANGER = 54321
DRIVER = """
from hysteresis_ros.hardware.driver import HardwareDriver
from hysteresis_ros.hardware.drivers.simulated import DRIVER as SIMULATED

DRIVER = HardwareDriver(name="mine", title=TITLE, parameters=SIMULATED.parameters, driver=SIMULATED.driver)
"""


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A private folder in /tmp, to which all users can write, with a driver in it."""
    monkeypatch.delenv(FOLDERS, raising=False)
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder).resolve() / "lab" / "mine.py"
        path.parent.mkdir(mode=0o755)
        path.write_text(DRIVER.replace("TITLE", "'one'"))
        path.chmod(0o644)
        yield path


def refusal(path) -> str:
    with pytest.raises(DriverError) as raised:
        require_trusted(path)
    return str(raised.value)


def test_a_folder_of_ones_own_is_trusted_in_tmp_too(place):
    assert place.parents[2].stat().st_mode & 0o1000 or os.environ.get("TMPDIR"), "no sticky folder on the way"
    assert require_trusted(place) == place
    assert driver_of(str(place)).title == "one"


@pytest.mark.parametrize("which", ["file", "folder", "folder above"])
def test_what_everybody_may_write_is_refused_with_the_place_and_the_remedy(place, which):
    what = {"file": place, "folder": place.parent, "folder above": place.parents[1]}[which]
    what.chmod(what.stat().st_mode | 0o002)
    said = refusal(place)
    assert f"{what} (mode 0" in said and "can be written by all users" in said and f"chmod o-w {what}" in said
    with pytest.raises(DriverError, match="can be written by all users"):
        driver_of(str(place))
    what.chmod(0o755)
    assert require_trusted(place) == place


def test_a_sticky_folder_keeps_what_is_in_it_only_for_its_owner(place, monkeypatch):
    place.parent.chmod(0o1777)
    assert require_trusted(place) == place
    place.chmod(0o666)
    assert f"chmod o-w {place}" in refusal(place)


def owned(monkeypatch, path, uid: int, gid: int | None = None) -> None:
    """Make a path appear to belong to another user, also where a change of the owner is not permitted."""
    real = pathlib.Path.lstat

    def lstat(self):
        found = real(self)
        if self != path:
            return found
        return SimpleNamespace(st_uid=uid, st_mode=found.st_mode, st_gid=found.st_gid if gid is None else gid)

    monkeypatch.setattr(pathlib.Path, "lstat", lstat)


@pytest.mark.parametrize("level", [0, 1, 2])
def test_what_belongs_to_somebody_else_is_refused_by_name(place, monkeypatch, level):
    what = [place, *place.parents][level]
    owned(monkeypatch, what, STRANGER)
    said = refusal(place)
    assert f"{what} belongs to user {STRANGER}" in said and "copy the driver to a folder of your own" in said


def test_root_this_user_and_the_owner_of_the_package_are_trusted(place, monkeypatch):
    owned(monkeypatch, place, 0)
    assert require_trusted(place)
    # a container whose user is root, with a checkout of another user from outside
    real = pathlib.Path.stat
    source = pathlib.Path(trusted.__file__)
    monkeypatch.setattr(
        pathlib.Path,
        "stat",
        lambda self, **more: SimpleNamespace(st_uid=STRANGER) if self == source else real(self, **more),
    )
    owned(monkeypatch, place, STRANGER)
    assert require_trusted(place)


def test_a_group_may_write_that_has_no_other_members(place, monkeypatch):
    place.parent.chmod(0o775)
    me = pwd.getpwuid(os.geteuid())
    other = SimpleNamespace(pw_uid=STRANGER, pw_gid=70001, pw_name="mallory")
    monkeypatch.setattr(trusted.pwd, "getpwall", lambda: [me, other])
    groups = {70000: [me.pw_name], 70001: [], 70002: [me.pw_name, "mallory"]}
    monkeypatch.setattr(trusted.grp, "getgrgid", lambda gid: SimpleNamespace(gr_mem=groups[gid]))
    owned(monkeypatch, place.parent, os.geteuid(), 70000)
    assert require_trusted(place), "a private group of the user is allowed"
    owned(monkeypatch, place.parent, os.geteuid(), 79999)
    assert require_trusted(place), "a group without members is allowed"
    for group in (70001, 70002):
        owned(monkeypatch, place.parent, os.geteuid(), group)
        said = refusal(place)
        assert f"by its group, and so by user {STRANGER}" in said and f"chmod g-w {place.parent}" in said


def test_links_are_followed_and_their_folders_looked_at(place, tmp_path):
    aside = place.parents[1] / "aside"
    aside.mkdir(mode=0o755)
    link = aside / "link.py"
    link.symlink_to("../lab/mine.py")
    assert require_trusted(link) == place
    absolute = aside / "absolute.py"
    absolute.symlink_to(place)
    assert require_trusted(absolute) == place
    aside.chmod(0o777)  # a user who may write here could redirect the link
    assert f"chmod o-w {aside}" in refusal(link)
    assert require_trusted(place) == place
    aside.chmod(0o755)
    place.parent.chmod(0o777)
    for path in (link, absolute):
        assert f"chmod o-w {place.parent}" in refusal(path)
    assert f"chmod o-w {place.parent}" in refusal(aside / ".." / "lab" / "mine.py")


def test_a_link_of_somebody_else_is_refused(place, monkeypatch):
    link = place.parent / "link.py"
    link.symlink_to("mine.py")
    owned(monkeypatch, link, STRANGER)
    assert f"{link} belongs to user {STRANGER}" in refusal(link)


def test_stated_folders_are_the_only_ones(place, monkeypatch):
    monkeypatch.setenv(FOLDERS, f"/nowhere:{place.parent}")
    assert require_trusted(place)
    link = place.parent / "out.py"
    outside = place.parents[1] / "other.py"
    outside.write_text("")
    link.symlink_to(outside)
    for path in (outside, link, place.parent / ".." / "other.py"):
        assert f"it is outside the folders {FOLDERS}=/nowhere:{place.parent}" in refusal(path)
    monkeypatch.setenv(FOLDERS, "")
    assert FOLDERS in refusal(place)


def test_libraries_are_looked_at_before_they_are_loaded(place):
    library = place.with_suffix(".so")
    library.write_bytes(b"no library")
    with pytest.raises(DriverError, match="cannot be loaded"):
        loaded(library)
    library.chmod(0o666)
    with pytest.raises(DriverError, match="can be written by all users"):
        loaded(library)


def test_bytecode_that_somebody_left_is_not_used(place):
    source, found = place.read_text(), place.stat()
    place.write_text(source.replace("'one'", "'two'"))
    os.utime(place, ns=(found.st_atime_ns, found.st_mtime_ns))
    py_compile.compile(str(place))  # with the size and time of the following version
    place.write_text(source)
    os.utime(place, ns=(found.st_atime_ns, found.st_mtime_ns))
    assert driver_of(str(place)).title == "one"
