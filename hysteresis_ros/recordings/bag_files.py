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
from collections.abc import Iterable, Mapping

from hysteresis_ros.errors import RecordingError

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


def whole(words: Mapping[str, str]) -> dict[str, bytes]:
    """Return the content of files by the paths they had, as far as it is there.

    Parameters
    ----------
    words : mapping of str to str
        As :func:`packed_files` gives them.
    """
    found = {}
    for name, text in words.items():
        if text.startswith(WHOLE):
            with contextlib.suppress(binascii.Error, ValueError):
                found[name] = base64.b64decode(text.removeprefix(WHOLE), validate=True)
    return found


def note_on_disk(name: str, content: bytes) -> str:
    """Return in one line that the file on this disk is another one now; empty: it is not, or there is none.

    Parameters
    ----------
    name : str
        Path.
    content : bytes
        What the recording holds.
    """
    with contextlib.suppress(OSError, ValueError):
        path = pathlib.Path(name)
        if path.is_file() and (path.stat().st_size != len(content) or path.read_bytes() != content):
            return f"{name} on this disk is not the file that the run was made with, which is in the recording and used"
    return ""


def require_same(name: str, text: str) -> None:
    """Refuse to repeat a run with a file of which the recording holds a digest only, unless it is that on this disk.

    Parameters
    ----------
    name : str
        Path.
    text : str
        Words of the file.

    Raises
    ------
    RecordingError
        It is not there, or another one.
    """
    try:
        with pathlib.Path(name).open("rb") as stream:
            same = DIGEST + hashlib.file_digest(stream, "sha256").hexdigest() == text
    except (OSError, ValueError):
        same = False
    if not same:
        raise RecordingError(
            f"{name}: the run was made with this file, which is too large for the recording, and it is not on this "
            f"disk any more ({text}); put it there to repeat the run"
        )
