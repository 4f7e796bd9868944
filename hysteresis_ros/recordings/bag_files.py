# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Files that were read for a run, in its recording: their content, as words of the bag."""

from __future__ import annotations

import base64
import binascii
import contextlib
import hashlib
import pathlib
from collections.abc import Iterable

from hysteresis_ros.recordings.bag_reader import read_bag

#: Name of the words; of a file of more bytes than this there is only its digest.
FILES, LARGEST = "hysteresis_ros files", 2**20

#: How the words of a file begin: what follows is all of it, or its SHA-256.
WHOLE, DIGEST = "base64:", "sha256:"


def packed_files(paths: Iterable[pathlib.Path]) -> dict[str, str]:
    """Return files as words, by their paths.

    Parameters
    ----------
    paths : iterable of pathlib.Path
        Those that cannot be read are left out: whoever needs them says so.
    """
    words = {}
    for path in paths:
        with contextlib.suppress(OSError):
            content = path.read_bytes()
            whole = WHOLE + base64.b64encode(content).decode()
            words[str(path)] = whole if len(content) <= LARGEST else DIGEST + hashlib.sha256(content).hexdigest()
    return words


def files_of(path) -> dict[str, bytes]:
    """Return the files in a recording by the paths they had, as far as their content is there.

    Parameters
    ----------
    path : path-like
        Of the bag.

    Raises
    ------
    RecordingError
        It cannot be read.
    """
    found = {}
    for name, text in read_bag(pathlib.Path(path)).words.get(FILES, {}).items():
        if text.startswith(WHOLE):
            with contextlib.suppress(binascii.Error, ValueError):
                found[name] = base64.b64decode(text.removeprefix(WHOLE), validate=True)
    return found
