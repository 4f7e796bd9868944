# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""One door for every kind of recording: the path says which format it is."""

from __future__ import annotations

import pathlib

from hysteresis_ros.errors import RecordingError
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.tables import read_csv, read_npz, write_csv, write_npz


def load_run(path, namespace: str | None = None, *, further: bool = False) -> Recording:
    """Read a run from ``.npz``, ``.csv``, a bag folder, a bare ``.mcap`` or a bare ``.db3`` file.

    Parameters
    ----------
    path : path-like
        The recording.
    namespace : str, optional
        Which axis of a bag; needed only when the bag holds several.
    further : bool
        Of a bag also the signals beyond the columns of a run (``applied``, ``switching``, ``disturbance`` …); tables
        give whatever they hold.

    Raises
    ------
    RecordingError
        The recording is missing, unreadable, lacks the signals, or holds several axes and none was chosen.
    """
    path = pathlib.Path(path)
    if path.suffix.lower() == ".npz":
        return read_npz(path)
    if path.suffix.lower() == ".csv":
        return read_csv(path)
    # rosbags and mcap take a tenth of a second to import: only those who open a bag pay for it
    from hysteresis_ros.recordings.align import read_recording

    return read_recording(path, namespace, further=further)


def save_run(recording: Recording, path, configuration: str | None = None) -> None:
    """Write a run as ``.npz``, ``.csv`` or ``.mcap``; the suffix decides.

    Parameters
    ----------
    recording : Recording
        The run.
    path : path-like
        Where to; an existing table is replaced, an existing bag is not.
    configuration : str, optional
        YAML text of the axis for a bag; the one in the recording's metadata by default.

    Raises
    ------
    RecordingError
        The suffix is another, or the file cannot be written.
    """
    path = pathlib.Path(path)
    suffix = path.suffix.lower()
    if suffix == ".npz":
        write_npz(recording, path)
    elif suffix == ".csv":
        write_csv(recording, path)
    elif suffix == ".mcap":
        from hysteresis_ros.recordings.run_bag import write_recording

        write_recording(recording, path, configuration)
    else:
        raise RecordingError(f"{path}: unknown kind of file '{path.suffix}'; write .npz, .csv or .mcap")
