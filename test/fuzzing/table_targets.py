# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Recordings as tables, arrays and responses: CSV and other text, NPZ, NPY, MATLAB."""

from __future__ import annotations

import functools
import io
import tempfile
import zipfile
from pathlib import Path
from random import Random

import numpy as np
import scipy.io
from judging import Target
from mutations import mutated_bytes, mutated_text, mutated_value

TIME = np.arange(6) * 1e-3
#: Minimum number of samples of an identification.
ROWS = range(52)
COLUMNS = {"displacement": 1e-6 * TIME, "voltage": 1e3 * TIME}

#: Names that the readers of tables know.
TABLE_WORDS = (
    "time [s]",
    "t_ms",
    "voltage [V]",
    "x [um]",
    "[",
    "]",
    ",",
    ";",
    "\t",
    "#",
    "%",
    '"',
    "s",
    "m",
    "10um/V",
    "/",
)


def written(name: str, write) -> bytes:
    """Return the content of a file that a writer of the package, or any other program, writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        write(path)
        return path.read_bytes()


def given(data: bytes, folder: Path, name: str) -> Path:
    """Return the path of a file with these bytes."""
    path = folder / name
    path.write_bytes(data)
    return path


@functools.cache
def _recording():
    from hysteresis_ros.recordings.dataset import Recording

    return Recording(TIME, COLUMNS, {}, {"notes": ["a"]})


# -- text ----------------------------------------------------------------------------------------------------------


def _run_tables() -> list[bytes]:
    from hysteresis_ros.recordings.files import write_csv

    own = written("run.csv", lambda path: write_csv(_recording(), path))
    return [own, b"# made elsewhere\n" + own, b'"time [ms]","displacement [um]"\n0,1\n1,2.5\n2,-3e-1\n']


def _read_run_table(data: bytes, folder: Path):
    from hysteresis_ros.recordings.files import read_csv

    return read_csv(given(data, folder, "run.csv"))


def _anyones_tables() -> list[bytes]:
    return [
        _run_tables()[2],
        b"Date;2020-01-01\nSensor;A\n\nt_ms;control_V;cap_um\n"
        + b"".join(b"%d;%d,5;%d,25\n" % (k, k % 7, k % 7) for k in ROWS),
        b"% a comment\n% t\tvoltage [V]\ty [um]\n" + b"".join(b"%g\t%g\t%g\n" % (k, k % 9, 2 * (k % 9)) for k in ROWS),
        ("t u_V x_um\n" + "".join(f"{k} {k % 5} {k % 5}\n" for k in ROWS)).encode("utf-16"),
        ("Zeit [s], Spannung [V], Weg [µm]\n" + "".join(f"{k},{k % 3},{k % 4}\n" for k in ROWS)).encode("latin-1"),
    ]


def _read_anyones_table(data: bytes, folder: Path, name: str = "table.csv"):
    from hysteresis_ros.identification.reading import Columns, read_data

    return read_data(given(data, folder, name), Columns())


def _reference_tables() -> list[bytes]:
    return [b"time [s], reference [um]\n0, 1\n0.001, 2\n0.002, 3\n", b"reference_m\n0\n1e-6\n"]


def _read_reference(data: bytes, folder: Path, name: str):
    from hysteresis_ros.references.waveforms.file import read_samples

    return read_samples(str(given(data, folder, name)), "reference", 1e-3, 1e-3, "waveform.file.")


# -- arrays --------------------------------------------------------------------------------------------------------


def archive(members: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    """Return an archive with any given members."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return stream.getvalue()


def array_bytes(values) -> bytes:
    """Return an array as NPY."""
    stream = io.BytesIO()
    np.save(stream, np.asarray(values), allow_pickle=True)
    return stream.getvalue()


def mutated_archive(random: Random, data: bytes, others: list[bytes], words: tuple[str, ...] = ()) -> bytes:
    """Return an archive with changed members, whose checksums are usually correct."""
    if random.random() < 0.3:
        return mutated_bytes(random, data, others)
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        members = {name: file.read(name) for name in file.namelist()}
    name = random.choice(list(members))
    content = members[name]
    change = random.randrange(7)
    if change <= 1:
        members[name] = mutated_bytes(random, content, others)
    elif change <= 3:  # the header of an array is text
        head = content.find(b"\n") + 1
        text = mutated_text(random, content[10:head], others, HEAD_WORDS)[: 1 << 15]
        members[name] = content[:8] + len(text).to_bytes(2, "little") + text + content[head:]
    elif change == 4:
        members[name] = array_bytes(random.choice(ODD_ARRAYS))
    elif change == 5:
        del members[name]
    else:
        members[random.choice((*(words or HEAD_WORDS), name.removesuffix(".npy"), name + "/"))] = content
    return archive(members, random.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))


HEAD_WORDS = (
    *("'descr'", "'<f8'", "'|O'", "'<U9'", "'<M8[s]'", "'<c16'", "'|V8'", "'|b1'", "'>f4'", "'<f16'", "[('a', '<f8')]"),
    *(
        "'fortran_order'",
        "True",
        "'shape'",
        "(6,)",
        "()",
        "(0,)",
        "(-1,)",
        "(2, 3)",
        "(10**9,)",
        f"({10**12},)",
        "(6.0,)",
    ),
    *(
        "{" * 60,
        "(" * 300,
        "-" * 500 + "1",
        "lambda: 0",
        "__import__('os')",
        "1if 1else 1",
        "'a' 'b'",
        "0xffffffffffffffff",
    ),
)
ODD_ARRAYS = (
    *(np.zeros(0), np.zeros((3, 2)), np.zeros((6, 1)), np.float64(1.0), np.array("text"), np.array("{" * 9999)),
    *(np.array([None, {}]), np.zeros(6, "<M8[s]"), np.zeros(6, complex), np.full(6, np.nan), np.arange(6)[::-1]),
    *(
        np.zeros(6, bool),
        np.zeros(6, [("a", "<f8")]),
        np.array(b"bytes"),
        np.array(["a"] * 6),
        np.array("[1]"),
        np.array("1"),
    ),
)


def _archives() -> list[bytes]:
    from hysteresis_ros.recordings.files import write_npz

    return [
        written("run.npz", lambda path: write_npz(_recording(), path)),
        written(
            "run.npz", lambda path: np.savez(path, time=TIME, voltage=COLUMNS["voltage"], measured=TIME, units="{}")
        ),
        written("run.npz", lambda path: np.savez_compressed(path, t_ms=ROWS, control_V=ROWS, cap_um=ROWS)),
    ]


def _read_archive(data: bytes, folder: Path):
    from hysteresis_ros.recordings.files import read_npz

    return read_npz(given(data, folder, "run.npz"))


def _reference_archives() -> list[bytes]:
    return [written("a.npz", lambda path: np.savez(path, time=TIME, reference=1e-6 * TIME))]


def _responses() -> list[bytes]:
    frequency = np.arange(1.0, 6.0)
    held = {
        "frequency": frequency,
        "response": frequency + 1j,
        "sample_time": 1e-3,
        "input_unit": "V",
        "output_unit": "m",
    }
    more = {name: frequency for name in ("total_variance", "noise_variance", "coherence", "noise", "odd", "even")}
    return [
        written("frf.npz", lambda path: np.savez(path, kind="multisine", **held)),
        written("frf.npz", lambda path: np.savez(path, kind="multisine", degrees=np.array(7), **held, **more)),
    ]


def _read_response(data: bytes, folder: Path):
    from hysteresis_ros.identification.frequency_response import holds_response, load_response, response_columns

    path = given(data, folder, "frf.npz")
    holds_response(path)
    return response_columns(load_response(path))


def _plans() -> list[bytes]:
    from hysteresis_ros.identification.excitations import Plan

    plan = Plan("multisine", 0, 1, 4, 2, (2000,), (1, 3, 5))
    return [plan.text.encode(), Plan("noise", 3, 0, 1, 1, (50, 500), (1, 9)).text.encode()]


def _read_plan(data: bytes, folder: Path):
    from hysteresis_ros.designs.frequency_response import read_plan

    np.savez(folder / "plan.npz", plan=np.array(data.decode(errors="replace")))
    return read_plan(folder / "plan.npz").length


# -- MATLAB --------------------------------------------------------------------------------------------------------


def _matlab_files() -> list[bytes]:
    content = {
        "t": TIME,
        "u": np.arange(6.0),
        "y": 1e-6 * TIME,
        "s": {"x_um": TIME, "n": 3},
        "name": "a",
        "m": np.eye(6)[:, :2],
    }
    plain = {"t_s": np.array(ROWS), "u_V": np.array(ROWS), "y_um": np.array(ROWS, dtype="i2")}
    return [
        written("a.mat", lambda path: scipy.io.savemat(path, content)),
        written("a.mat", lambda path: scipy.io.savemat(path, plain, do_compression=True)),
        written("a.mat", lambda path: scipy.io.savemat(path, plain, format="4")),
    ]


TARGETS = (
    Target("csv of a run", _read_run_table, _run_tables, mutated_text, TABLE_WORDS, file="run.csv"),
    Target("text tables", _read_anyones_table, _anyones_tables, mutated_text, TABLE_WORDS, 300, file="table.csv"),
    Target(
        *("csv of a waveform", functools.partial(_read_reference, name="scan.csv"), _reference_tables, mutated_text),
        words=TABLE_WORDS,
        file="scan.csv",
    ),
    Target("npz of a run", _read_archive, _archives, mutated_archive, suite=500, file="run.npz"),
    Target(
        *("npz of anybody", functools.partial(_read_anyones_table, name="table.npz"), _archives, mutated_archive),
        suite=300,
        file="table.npz",
    ),
    Target(
        *(
            "npz of a waveform",
            functools.partial(_read_reference, name="scan.npz"),
            _reference_archives,
            mutated_archive,
        ),
        suite=300,
        file="scan.npz",
    ),
    Target(
        *("npy of a waveform", functools.partial(_read_reference, name="scan.npy"), lambda: [array_bytes(TIME)]),
        file="scan.npy",
    ),
    Target("npz of a response", _read_response, _responses, mutated_archive, suite=150, file="frf.npz"),
    Target("plan of an excitation", _read_plan, _plans, mutated_value, suite=200, file="plan.npz"),
    Target(
        *("mat files", functools.partial(_read_anyones_table, name="table.mat"), _matlab_files),
        suite=400,
        file="table.mat",
    ),
)
