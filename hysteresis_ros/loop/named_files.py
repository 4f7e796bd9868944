# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Files that the parameters of an axis name: without them its run cannot be repeated."""

from __future__ import annotations

import pathlib
from collections.abc import Iterator

from hysteresis_ros.loop.node_parameters import NODE_PARAMETERS
from hysteresis_ros.recordings.configured import configured

#: The end of names of parameters of files that are written.
WRITTEN = "save_file"


def file_parameters(text: str, namespace: str = "") -> Iterator[tuple[str, str, pathlib.Path]]:
    """Yield node, name and path of each parameter that names a file to be read; arguments as of :func:`named_files`."""
    for node, kind in NODE_PARAMETERS.items():
        values = configured(text, node, namespace) if node != "recorder" else {}
        for row in kind.table():
            if row.place == "files" and not row.name.endswith(WRITTEN) and values.get(row.name):
                yield node, row.name, pathlib.Path(str(values[row.name])).expanduser()


def named_files(text: str, namespace: str = "") -> list[pathlib.Path]:
    """Return the files that a configuration names for its nodes to read, as far as they are there.

    Parameters
    ----------
    text : str
        YAML of the axis; whatever else it is, it names none.
    namespace : str, optional
        Of the axis.
    """
    return sorted({path for *_, path in file_parameters(text, namespace) if path.is_file()})
