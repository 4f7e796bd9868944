# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import pathlib
from collections.abc import Iterator

from hysteresis_ros.errors import HysteresisError

#: What to do about a file that cannot be written.
REMEDY = "choose another place"


@contextlib.contextmanager
def replacing(path, error: type[HysteresisError], remedy: str = REMEDY) -> Iterator[pathlib.Path]:
    """Yield the name of a file beside another one, whose place it takes when the block has ended without an error.

    Parameters
    ----------
    path : path-like
        The file that is to be there in the end; it is replaced as a whole.
    error : type of HysteresisError
        What is raised.
    remedy : str
        What to do when it cannot be written.

    Raises
    ------
    HysteresisError
        As ``error``: the file cannot be written. What stood in its place is untouched, and nothing is left beside it.
    """
    path = pathlib.Path(path)
    beside = path.with_name(f".{path.name}.partial")
    try:
        yield beside
        os.replace(beside, path)
    except OSError as failed:
        reason = failed.strerror or str(failed) or type(failed).__name__
        raise error(f"{path}: cannot be written: {reason}; {remedy}") from None
    finally:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)


def write_text(path, text: str, error: type[HysteresisError]) -> None:
    """Write a text in UTF-8, whole or not at all.

    Parameters
    ----------
    path : path-like
    text : str
    error : type of HysteresisError
        What is raised.

    Raises
    ------
    HysteresisError
        As ``error``: the file cannot be written.
    """
    with replacing(path, error) as beside:
        beside.write_text(text, encoding="utf-8")
