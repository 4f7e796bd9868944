# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Arguments of the command line, and texts with a meaning: quantities, faults, waveforms, parameter values."""

from __future__ import annotations

import contextlib
import io
import json
import os
from pathlib import Path

from judging import Target
from mutations import NUMBERS, mutated_text, mutated_value

#: Commands that read and print, with words that they accept.
COMMANDS = (
    ["parameters", "motion_controller"],
    ["models", "bouc_wen", "--yaml"],
    ["simulate", "nothing.yaml", "-o", "a.npz", "--reference", "sine", "--frequency", "5Hz", "--amplitude", "7um"],
    ["export", "nothing.csv", "-o", "a.npz", "--namespace", "left"],
    ["report", "nothing.csv", "--range", "0.5s:2s", "--skip", "200ms", "--json", "-"],
    ["identify", "nothing.csv", "--model", "duhem", "--input", "u:V", "--range", "0:60", "--resample", "auto"],
    ["validate", "nothing.yaml", "nothing.csv", "--offset", "free", "--skip", "5"],
    ["design", "nothing.yaml", "--controller", "pid", "--bandwidth", "50", "-o", "a.yaml"],
    ["frf", "nothing.npz", "--kind", "noise", "--low", "5", "--high", "100"],
    ["new", "a.yaml", "--stroke", "100um", "--voltage", "0:100V", "--rate", "2kHz"],
    ["camera", "nothing.avi", "--rate", "30", "--target", "1mm"],
)
SAFE = tuple(words[0] for words in COMMANDS)
WORDS = (*("--help", "-o", "--", "-x", "=", ":", "um", "kHz", "V", "0:", ":0", "1:2:3", "5um/V"), *NUMBERS[:40])


def _call(data: bytes, folder: Path):
    """Exit code 0 or 2, at most one line on standard error, and no exception but SystemExit."""
    from hysteresis_ros.cli.main import main
    from hysteresis_ros.errors import HysteresisError

    words = json.loads(data)
    words = [_harmless(word) for word in words] if isinstance(words, list) and words else [""]
    words[0] = words[0] if words[0] in SAFE else SAFE[len(data) % len(SAFE)]
    before, said, errors = Path.cwd(), io.StringIO(), io.StringIO()
    os.chdir(folder)
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(errors):
            main.main(words, prog_name="hysteresis")
    except SystemExit as end:
        if end.code == 2:
            raise HysteresisError(errors.getvalue().strip()) from None
        if end.code:
            raise AssertionError(f"exit code {end.code}: {errors.getvalue()}") from None
    finally:
        os.chdir(before)
        for path in folder.iterdir():
            path.unlink()


def _harmless(word) -> str:
    """Return a word that does not lead out of the folder."""
    text = word if isinstance(word, str) else json.dumps(word)
    return text.replace("/", "_").replace("..", "_").replace("~", "_").replace("\0", "_")


def _texts() -> list[bytes]:
    return [b"70um", b"5 Hz", b"-1e-6", b"10um/V", b"spike:0.1:0.2:1e-6", b"slow:0:1:0.2", b"[1, 2.5]", b"0:6000"]


def _understand(data: bytes, folder: Path):
    """Give one text to every function that parses one; each has its own errors, all of them ValueErrors."""
    from hysteresis_ros.configuration import parse_value
    from hysteresis_ros.laboratory.emulation.bench import DeviceFaults
    from hysteresis_ros.loop.faults import parse_fault
    from hysteresis_ros.nodes.parameters import assigned
    from hysteresis_ros.recordings.foreign_tables import column_unit, named_column, split_choice
    from hysteresis_ros.references.recipes import asked_waveform
    from hysteresis_ros.units import conversion, quantity

    text = data.decode("utf-8", "replace")
    for read in (parse_value, conversion, named_column, split_choice, column_unit):
        read(text)
    assigned("node", "/node", ["--ros-args", "-p", f"a:={text}", "-p", text])
    taken = 0
    for read in (
        quantity,
        lambda text: parse_fault(text, 1000.0),
        lambda text: DeviceFaults(lambda: 0.0, [text]),
        lambda text: asked_waveform("sine", {"amplitude": text, "frequency": "5Hz"}),
        lambda text: asked_waveform("steps", {"values": text, "times": "0,1"}),
        lambda text: asked_waveform(text, {"cycles": text, "polarity": text}),
    ):
        with contextlib.suppress(ValueError):
            read(text)
            taken += 1
    return taken


TARGETS = (
    Target(
        "command line", _call, lambda: [json.dumps(words).encode() for words in COMMANDS], mutated_value, WORDS, 100
    ),
    Target("quantities, faults, waveforms", _understand, _texts, mutated_text, WORDS, 500),
)
