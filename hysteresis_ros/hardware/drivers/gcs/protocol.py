# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""GCS 2.0 in words and numbers: what driver and emulator both hold to.

Sources: E-727 Digital Multi-Channel Piezo Controller, user manual E727T0005 (2019), sections "GCS commands", "Data
recorder" and "Wave generator"; C-863 Mercury Controller, user manual MS249E, section "GCS commands" (answers of
``DRR?`` and ``HPA?``). A command ends with LF, an answer too; of an answer of several lines all but the last end with a
space before the LF. Commands of one character need no LF.
"""

from __future__ import annotations

#: Commands of one character: status register, motion status, ready status, status of the wave generator, stop.
STATUS, MOTION_STATUS, READY_STATUS, GENERATOR_STATUS, STOP = "\x04", "\x05", "\x07", "\x09", "\x18"
#: Answers to :data:`READY_STATUS`.
READY, NOT_READY = b"\xb1", b"\xb0"

#: Codes of ``ERR?`` by what they mean.
NO_ERROR, SYNTAX, UNKNOWN_COMMAND, TOO_LONG = 0, 1, 2, 3
SERVO_OFF, POSITION_LIMIT, STOPPED, WRONG_AXIS, OUT_OF_RANGE = 5, 7, 10, 15, 17
WRONG_COUNT, UNKNOWN_PARAMETER, READ_ONLY, SERVO_ON = 24, 54, 64, 79
NO_TABLE, GENERATOR_RUNS, NO_WAVE, VOLTAGE_LIMIT = 57, 73, 75, 302
WAVE_TYPE, WAVE_LENGTH, BUSY = 402, 403, 1005

MEANINGS = {
    NO_ERROR: "no error",
    SYNTAX: "a parameter is no number",
    UNKNOWN_COMMAND: "the command is not known",
    TOO_LONG: "the command is too long",
    SERVO_OFF: "a move with the servo off, or of an axis that is not referenced",
    POSITION_LIMIT: "the position is beyond the limits",
    8: "the velocity is beyond the limits, or the axis is not referenced",
    STOPPED: "stopped by a command",
    WRONG_AXIS: "there is no such axis",
    OUT_OF_RANGE: "a parameter is out of range",
    WRONG_COUNT: "the number of parameters is wrong",
    UNKNOWN_PARAMETER: "there is no such parameter",
    NO_TABLE: "there is no such record table",
    READ_ONLY: "the parameter is read only",
    66: "the voltage is beyond the limits",
    GENERATOR_RUNS: "a move while the wave generator runs",
    NO_WAVE: "the wave generator has no wave table",
    SERVO_ON: "an open-loop command with the servo on",
    215: "the connection between controller and stage may be broken",
    VOLTAGE_LIMIT: "the voltage is beyond the limits",
    333: "a fault of the hardware",
    WAVE_TYPE: "there is no such type of wave",
    WAVE_LENGTH: "the wave is too long",
    602: "a fault of the high voltage",
    603: "the temperature is out of range",
    BUSY: "busy with a lengthy operation",
}

#: Metres of a unit, as controllers write it.
UNITS = {"m": 1.0, "mm": 1.0e-3, "um": 1.0e-6, "µm": 1.0e-6, "nm": 1.0e-9}

#: Parameters by their number.
RANGE_MINIMUM, RANGE_MAXIMUM, AXIS_UNIT = 0x07000000, 0x07000001, 0x07000601
VOLTAGE_MINIMUM, VOLTAGE_MAXIMUM = 0x0B000007, 0x0B000008
SERVO_CYCLE, WAVE_POINTS, RECORD_POINTS, RECORD_TABLES = 0x0E000200, 0x13000004, 0x16000200, 0x16000300
TOLERANCE, SETTLING = 0x07000900, 0x07000901

#: What a record table holds.
TARGET, POSITION, POSITION_ERROR, CONTROL_VOLTAGE, OPEN_LOOP, VOLTAGE = 1, 2, 3, 7, 14, 16


def meaning(code: int) -> str:
    """Return what a code of ``ERR?`` means.

    Parameters
    ----------
    code : int
    """
    return f"error {code}: {MEANINGS.get(code, 'see ERR? in the manual of the controller')}"
