# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis watch`` reports wrong input before anything moves."""

from __future__ import annotations

import importlib.util
import socket

import pytest
from command_support import refusal

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")


@pytest.fixture(autouse=True)
def nothing_starts(monkeypatch):
    """A test fails if the command starts a process before it has checked its input."""
    import subprocess

    monkeypatch.setattr(subprocess, "Popen", lambda *given, **options: pytest.fail(f"started: {given}"))


@pytest.mark.parametrize("words", [("watch",), ("watch", "kim2009"), ("up", "kim2009", "--watch")])
def test_without_aiohttp_it_says_what_to_install(monkeypatch, words):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *more: None if name == "aiohttp" else found(name, *more)
    )
    assert 'pip install "hysteresis_ros[watch]"' in refusal(*words)


def test_an_address_a_port_and_a_folder_that_are_none_are_named(tmp_path):
    pytest.importorskip("aiohttp", reason="aiohttp is not installed: no page")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert f"127.0.0.1:{port}: cannot listen on it: Address already in use" in refusal("watch", "--port", port)
    assert "192.0.2.1:8642: cannot listen on it" in refusal("watch", "--bind", "192.0.2.1")
    assert "nowhere.example" in refusal("watch", "--bind", "nowhere.example.invalid")
    assert "nowhere: is not a folder" in refusal("watch", "--folder", tmp_path / "nowhere")
    assert "70000" in refusal("watch", "--port", 70000)
    assert "did you mean kim2009?" in refusal("watch", "kim209")
