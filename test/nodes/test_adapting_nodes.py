# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""An adapting inverse in nodes: controlled by services, saved to a file, repeated bit for bit from the log."""

from __future__ import annotations

from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: no nodes")

from adapting_support import adapting  # noqa: E402
from nodes_support import RecordedRun, diagnostics, shortened, until  # noqa: E402

NODE = "/hysteresis_compensator"


def lockstep_axis(samples: int, path):
    axis = adapting({"adaptation__slow": 0.05, "adaptation__save_file": str(path)})
    return shortened(axis.with_time_mode("lockstep"), samples)


def test_services_steer_it_a_file_keeps_it_and_the_log_repeats_it(inside, observer, tmp_path):
    from diagnostic_msgs.msg import DiagnosticArray

    from hysteresis_ros.cli.options import laid_under
    from hysteresis_ros.loop.reach import single_axis
    from hysteresis_ros.loop.simulation import differences, simulate

    saved = tmp_path / "adapted.yaml"
    run = RecordedRun(inside, lockstep_axis(2400, saved), tmp_path / "bag")
    heard = observer.listen(DiagnosticArray, "/diagnostics")
    inside.spin()
    compensator = run.compensator
    until(lambda: compensator.sample > 900, what="the beginning")
    assert observer.trigger(f"{NODE}/freeze").message == "adaptation off: the weights are kept"
    until(lambda: (diagnostics(heard, NODE) or [0, ""])[1] == "adaptation frozen: by a service", what="diagnostics")
    kept = compensator.part.adaptation.factors
    assert observer.trigger(f"{NODE}/save").message == f"{saved} written"
    assert observer.trigger(f"{NODE}/resume").success
    recorded = run.result()
    assert not differences(recorded, run.axis)
    assert recorded["adapted_gain"][-1] < 0.9 and len(recorded.metadata["changes"]) == 2
    # the saved weights are overlaid on the axis, here and on the command line
    config = tmp_path / "axis.yaml"
    config.write_text(run.axis.configuration_text(), encoding="utf-8")
    again = single_axis(laid_under(str(config), (str(saved),)))
    assert again.hysteresis_compensator.adaptation.factors == kept
    off = replace(again.hysteresis_compensator.adaptation, type="none", factors=())
    plain = replace(again, hysteresis_compensator=replace(again.hysteresis_compensator, adaptation=off))
    assert simulate(plain, duration=0.1)["adaptation"][-1] == 0.0


def test_what_does_not_adapt_says_so(inside, observer, tmp_path):
    axis = lockstep_axis(50, tmp_path / "nowhere" / "adapted.yaml")
    run = RecordedRun(inside, axis, tmp_path / "bag")
    inside.spin()
    until(lambda: run.compensator.sample > 0, what="the first sample")
    answer = observer.trigger(f"{NODE}/save")
    assert not answer.success and f"{tmp_path / 'nowhere' / 'adapted.yaml'}: cannot be written" in answer.message
    run.result()
