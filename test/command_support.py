# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Run a command of ``hysteresis``, in its own process or in that of the test."""

from __future__ import annotations

import subprocess
import sys

from click.testing import CliRunner

from hysteresis_ros.cli.main import main


def hysteresis(*words, code: int = 0) -> str:
    """Run a command in this process, which takes 0.3 s less than one of its own; return what it prints."""
    result = run(*words)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == code, result.output
    return result.output


def hysteresis_process(*words, code: int = 0) -> str:
    """Run a command in its own process; return what it prints."""
    answer = subprocess.run(
        [sys.executable, "-m", "hysteresis_ros.cli.main", *map(str, words)], capture_output=True, text=True
    )
    assert answer.returncode == code, answer.stdout + answer.stderr
    return answer.stdout + answer.stderr


def run(*words):
    """Run a command in this process; return the result of click."""
    return CliRunner().invoke(main, [str(word) for word in words])


def refusal(*words) -> str:
    """Return the one line with which a command refuses; a slow machine may print lines of progress before it."""
    result = run(*words)
    assert isinstance(result.exception, SystemExit), result.exception
    assert result.exit_code == 2, result.output
    lines = [line for line in result.output.splitlines() if not line.lstrip().startswith("…")]
    assert len(lines) == 1 and lines[0].startswith("hysteresis: "), result.output
    return lines[0]
