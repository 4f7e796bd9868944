# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Data sent by and to devices: the streams of the emulators, and the drivers' side."""

from __future__ import annotations

import contextlib
import functools
import json
from pathlib import Path

from judging import Target
from mutations import mutated_bytes, mutated_text, mutated_value

#: Time between two samples of an emulated plant [s].
CYCLE = 5.0e-4
GCS_WORDS = (
    *(
        "SVA 1 5\n",
        "MOV 1 2e-6\n",
        "POS? 1\n",
        "ERR?\n",
        "WAV 1 X PNT 1 2 0 1\n",
        "WGO 1 1\n",
        "DRR? 1 5\n",
        "SPA? 1 1\n",
    ),
    *(
        "HLP?\n",
        "SAI?\n",
        "\x05",
        "\x07",
        "\x18",
        "&",
        "RAMP",
        "SIN_P",
        "0x13000004",
        "WTR 0 1 0\n",
        "DRC 1 1 2\n",
        "SVO 1 1\n",
    ),
)
NV200_WORDS = ("set,5\r", "meas\r", "cl,1\r", "stat\r", "\xff\xfa", "\xff\xf0", "kp", "modsrc,0\r", ",", "\r", "error")


def _gcs_controller():
    from hysteresis_ros.laboratory.emulation.bench import DeviceFaults, assumed_stage
    from hysteresis_ros.laboratory.emulation.gcs_controller import MODELS, Controller

    now = [0.0]

    def clock() -> float:
        now[0] += CYCLE
        return now[0]

    return Controller(MODELS["E-754"], assumed_stage(CYCLE), CYCLE, DeviceFaults(clock), clock)


_gcs_bench = functools.cache(_gcs_controller)


def _gcs_commands() -> list[bytes]:
    return ["".join(GCS_WORDS[first : first + 6]).encode() for first in (0, 6, 12, 18)]


def _feed_gcs(data: bytes, folder: Path):
    from hysteresis_ros.laboratory.emulation.gcs import Session

    session = Session(_gcs_bench())
    return session.feed(data) + session.feed(b"\nERR?\n")


@functools.cache
def _amplifier():
    from hysteresis_ros.laboratory.emulation.bench import DeviceFaults, EmulatedPlant, assumed_stage
    from hysteresis_ros.laboratory.emulation.nv200 import Amplifier

    now = [0.0]

    def clock() -> float:
        now[0] += CYCLE
        return now[0]

    return Amplifier(EmulatedPlant(assumed_stage(CYCLE), CYCLE, clock), DeviceFaults(clock))


def _feed_nv200(data: bytes, folder: Path):
    session = _amplifier().session()
    return session.feed(data) + session.feed(b"\rstat\r")


# -- the driver's end ----------------------------------------------------------------------------------------------


class _Spoken:
    """A connection whose other end sends a given text, independent of the request."""

    def __init__(self, data: bytes):
        self._data = data

    def sendall(self, data: bytes) -> None:
        """Ignore the data."""

    def recv(self, size: int) -> bytes:
        part, self._data = self._data[:size], self._data[size:]
        return part

    def close(self) -> None:
        """There is nothing to close."""


class _Answering(_Spoken):
    """A connection to an emulated controller that stores the controller's answers."""

    def __init__(self):
        from hysteresis_ros.laboratory.emulation.gcs import Session

        super().__init__(b"")
        self._session, self.said = Session(_gcs_controller()), b""

    def sendall(self, data: bytes) -> None:
        answer = self._session.feed(data)
        self._data += answer
        self.said += answer


def _open_gcs(connection):
    from hysteresis_ros.hardware.drivers.gcs import GcsDriver, GcsLink, GcsParameters

    driver, link = GcsDriver(), GcsLink.__new__(GcsLink)
    link.name, link.broken, link._rest, link._leads, link._socket = "controller", False, b"", False, connection
    link._require_silence = lambda what: None  # all answers are available before they are requested
    driver._link, driver._failed = link, True
    driver.open(GcsParameters(safe_time=0.0, check_period=60.0, safe_voltage=1.0), 100.0)
    driver.read()
    return driver.play([0.0, 1.0, 2.0], 1e-3)


@functools.cache
def _gcs_answers() -> list[bytes]:
    from hysteresis_ros.hardware.driver import DriverError

    connection = _Answering()
    with contextlib.suppress(DriverError):  # only the answers up to this point count
        _open_gcs(connection)
    return [connection.said]


def _hear_gcs(data: bytes, folder: Path):
    return _open_gcs(_Spoken(data))


def _iio_devices() -> list[bytes]:
    attributes = {"name": "ad5592r\n", "out_voltage0_raw": "5\n", "out_voltage0_scale": "0.61\n"}
    attributes |= {"out_voltage0_raw_available": "[0 1 4095]\n", "out_voltage_offset": "0\n"}
    return [json.dumps(attributes).encode()]


def _read_iio(data: bytes, folder: Path):
    from hysteresis_ros.hardware.drivers.iio import Channel, device_at

    place = folder / "iio" / "iio:device0"
    place.mkdir(parents=True, exist_ok=True)
    for path in place.iterdir():
        path.unlink()
    attributes = json.loads(data)
    for name, text in attributes.items() if isinstance(attributes, dict) else ():
        if "/" not in name and "\0" not in name and 0 < len(name.encode(errors="replace")) < 200:
            (place / name).write_text(text if isinstance(text, str) else json.dumps(text), errors="replace")
    channel = Channel(device_at(folder / "iio", "iio:device0"), "out", "voltage0")
    low, high = channel.range((0.0, 4095.0))
    channel.put_out(0.5 * (low + high))
    return channel.read()


IIO_WORDS = (
    "[0 1 4095]\n",
    "[a b c]\n",
    "[nan inf -inf]\n",
    "1e400\n",
    "nan\n",
    "out_voltage0_scale",
    "0\n",
    "-0\n",
    "",
)
TARGETS = (
    Target("gcs emulator", _feed_gcs, _gcs_commands, mutated_text, GCS_WORDS, suite=600),
    Target("nv200 emulator", _feed_nv200, lambda: ["".join(NV200_WORDS).encode("latin-1")], mutated_bytes, suite=1_000),
    Target("gcs driver", _hear_gcs, _gcs_answers, mutated_bytes, suite=300),
    Target("iio devices", _read_iio, _iio_devices, mutated_value, IIO_WORDS, suite=300, file="iio"),
)
