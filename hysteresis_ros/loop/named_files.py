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

from hysteresis_ros.loop.node_parameters import NODE_PARAMETERS
from hysteresis_ros.recordings.configured import configured

#: The end of names of parameters of files that are written.
WRITTEN = "save_file"


def named_files(text: str, namespace: str = "") -> list[pathlib.Path]:
    """Return the files that a configuration names for its nodes to read, as far as they are there.

    Parameters
    ----------
    text : str
        YAML of the axis; whatever else it is, it names none.
    namespace : str, optional
        Of the axis.
    """
    found = []
    for node, kind in NODE_PARAMETERS.items():
        values = configured(text, node, namespace) if node != "recorder" else {}
        named = [row.name for row in kind.table() if row.place == "files" and not row.name.endswith(WRITTEN)]
        found += [pathlib.Path(str(values[name])).expanduser() for name in named if values.get(name)]
    return sorted({path for path in found if path.is_file()})
