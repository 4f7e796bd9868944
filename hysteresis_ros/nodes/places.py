# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Files that others name over the graph lie in folders that the user of the node has stated."""

from __future__ import annotations

import os
import pathlib

from hysteresis_ros.errors import Problem
from hysteresis_ros.parameters import ParameterRow

#: Environment variable: folders, as in PATH; not set: the folder the node was started in, without what is hidden there.
FOLDERS = "HYSTERESIS_FILES"


def misplaced(row: ParameterRow, value) -> Problem | None:
    """Return what is wrong with a value that somebody gives over the graph, None when it names nothing forbidden.

    Symbolic links and ``..`` are followed first.

    Parameters
    ----------
    row : ParameterRow
        Of the parameter.
    value : object
    """
    if row.place == "start" and (row.choices is None or (isinstance(value, str) and "/" in value)):
        allowed = "is code, or given to it: only the parameter file or the command line of the node may name it"
        return Problem(row.name, value, allowed)
    if row.place != "files" or not isinstance(value, str) or not value:
        return None
    stated = os.environ.get(FOLDERS)
    if stated is None:
        folders, where = _working_folder(), "the folder the node was started in, hidden files excepted"
    else:
        folders, where = [pathlib.Path(name) for name in stated.split(os.pathsep) if name], FOLDERS
    try:
        path = pathlib.Path(value).expanduser().resolve()
        below = [path.relative_to(root) for root in _resolved(folders) if path.is_relative_to(root)]
    except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a user who is not, a null byte
        return Problem(row.name, value, f"is no path: {error}")
    if any(stated is not None or not any(part.startswith(".") for part in found.parts) for found in below):
        return None
    there = ", ".join(map(str, folders)) or "nowhere"
    allowed = (
        f"a file that is named over the graph must lie in {there} ({where}); name one there, give it in the parameter "
        f"file of the node, or start the node with {FOLDERS}=FOLDER"
    )
    return Problem(row.name, value, allowed)


def _working_folder() -> list[pathlib.Path]:
    """Return the working folder; of services, which are started in the root, none: everything lies below that."""
    folder = pathlib.Path.cwd()
    return [folder] if folder != pathlib.Path(folder.anchor) else []


def _resolved(folders: list[pathlib.Path]) -> list[pathlib.Path]:
    return [folder.expanduser().resolve() for folder in folders]
