# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""`--reference …` moves an axis without a change of its file; a message names the option with the wrong value."""

from __future__ import annotations

import numpy as np
import pytest
from command_support import run

from hysteresis_ros.recordings import load_run


def test_a_simulated_axis_follows_what_was_asked_for(tmp_path):
    path = tmp_path / "a.npz"
    asked = ("--reference", "triangle", "--frequency", "10", "--amplitude", "7um", "--offset", "1um", "--cycles", "1")
    result = run("simulate", "kim2009", *asked, "-o", path)
    assert result.exit_code == 0, result.output
    found = load_run(path)
    assert found.time.size == 300
    turn = np.arange(300) / 300.0
    np.testing.assert_allclose(found["reference"], 1e-6 + 7e-6 * (1.0 - abs(1.0 - 2.0 * turn)), rtol=0, atol=1e-15)
    assert np.ptp(found["displacement"]) == pytest.approx(7e-6, rel=0.1)


REFUSED = [
    (["--reference", "trinagle"], "--reference = 'trinagle'", "did you mean triangle?"),
    (["--reference", "triangle", "--amplitude", "70um"], "--amplitude = '70um'", "allowed: 0 µm … 12 µm"),
    (["--reference", "sine", "--amplitude", "1um", "--offset", "99um"], "--amplitude = '1um'", "reaches"),
    (["--reference", "hold", "--offset", "99um"], "--offset = '99um'", "reaches"),
    (["--reference", "sine", "--amplitude", "1um", "--offset", "2um", "--frequency", "2kHz"], "--frequency", "1500 Hz"),
    (["--reference", "triangle", "--amplitude", "9um", "--frequency", "700Hz"], "--frequency = '700Hz'", "≤ 500 Hz"),
    (["--reference", "file", "--file", "none.csv"], "--file = 'none.csv'", "no such file"),
    (["--reference", "chirp", "--amplitude", "1um"], "--waveform final_frequency", "missing"),
    (["--reference", "square", "--amplitude", "1um", "--waveform", "duty=2"], "--waveform duty = '2'", "0 … 1"),
    (["--reference", "square", "--amplitude", "1um", "--waveform", "duty"], "--waveform duty: write NAME=VALUE", ""),
    (["--amplitude", "1um"], "--amplitude belongs to a waveform", "--reference"),
]


@pytest.mark.parametrize(("words", "option", "why"), REFUSED, ids=lambda value: " ".join(value)[:40])
def test_a_refused_value_names_its_option(tmp_path, monkeypatch, words, option, why):
    monkeypatch.chdir(tmp_path)
    result = run("simulate", "kim2009", "-o", "a.npz", *words)
    assert result.exit_code == 2 and option in result.output and why in result.output, result.output
    assert len(result.output.splitlines()) == 1 and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "give one of --recipe"),
        (["--recipe", "steps", "--reference", "sine"], "give one of --recipe"),
        (["--recipe", "steps", "--offset", "1um"], "--offset belongs to a waveform"),
        (["--recipe", "steps", "--amplitude", "1um"], "--amplitude = '1um': must be a factor"),
        (["--reference", "triangle", "--amplitude", "60"], "--amplitude = '60': 60 of which unit? Write 60V"),
        (["--reference", "triangle", "--amplitude", "60V"], "--cycles = 0: the waveform has no end"),
        (["--reference", "triangle", "--amplitude", "600V", "--cycles", "1"], "--amplitude = '600V'"),
    ],
)
def test_an_excitation_that_cannot_be_is_refused(tmp_path, monkeypatch, words, expected):
    monkeypatch.chdir(tmp_path)
    result = run("excite", "kim2009", "--record", "bag", *words)
    assert result.exit_code == 2 and expected in result.output, result.output
    assert not list(tmp_path.iterdir())


def test_up_refuses_before_it_starts_anything():
    result = run("up", "kim2009", "--reference", "triangle", "--amplitude", "70um")
    assert result.exit_code == 2 and "--amplitude = '70um'" in result.output


def test_an_inchworm_follows_no_waveform(tmp_path):
    result = run("simulate", "inchworm_travel", "--reference", "sine", "--amplitude", "1um", "-o", tmp_path / "a.npz")
    assert result.exit_code == 2 and "cannot follow a waveform" in result.output
