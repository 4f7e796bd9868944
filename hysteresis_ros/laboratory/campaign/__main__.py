# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Run a campaign: ``python -m hysteresis_ros.laboratory.campaign '{"config": "picma_stage", …}'``.

The argument is a JSON object with the keys ``config``, ``only`` and ``ways`` (lists of names), ``rounds``, ``seed``,
``rate``, ``output`` and ``json`` (paths, or empty), and ``add`` (paths).
"""

from __future__ import annotations

import json
import pathlib
import sys
import tempfile

import rclpy
from rclpy.signals import SignalHandlerOptions

from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.laboratory.campaign.mishaps import CATALOGUE, WAYS, Mishap
from hysteresis_ros.laboratory.campaign.results import Results, conditions, line, load_results, page
from hysteresis_ros.laboratory.campaign.run import Campaign
from hysteresis_ros.nodes.domain import stay_on_this_machine

#: Exit code when a claim did not hold.
NOT_HELD = 4


def main() -> int:
    """Run the campaign that the only argument describes; return the exit code."""
    request = json.loads(sys.argv[1])
    mishaps = tuple(CATALOGUE[name] for name in request["only"])
    ways = tuple(request["ways"])
    try:
        stay_on_this_machine()
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        before = conditions()
        with tempfile.TemporaryDirectory(prefix="hysteresis_") as folder:
            campaign = Campaign(
                request["config"],
                mishaps,
                ways,
                request["rounds"],
                request["seed"],
                pathlib.Path(folder),
                request["rate"],
            )
            verdicts = campaign.run(lambda verdict: print(line(verdict), flush=True))
        config = f"{request['config']} at {request['rate']:g} Hz" if request["rate"] else request["config"]
        _write(request, mishaps, Results(config, tuple(verdicts), before, conditions()))
    except HysteresisError as error:
        print(f"hysteresis: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    failed = {verdict.trace.mishap for verdict in verdicts if verdict.failures}
    print(f"{len(verdicts)} fault cases: {'all held' if not failed else 'not held: ' + ', '.join(sorted(failed))}")
    return NOT_HELD if failed else 0


def _write(request: dict, mishaps: tuple[Mishap, ...], results: Results) -> None:
    """Write the requested files."""
    if request["json"]:
        results.save(pathlib.Path(request["json"]))
    for path in request["add"]:
        results = results.and_of(load_results(pathlib.Path(path)))
    if request["output"]:
        there = {verdict.trace.way for verdict in results.verdicts}
        names = {verdict.trace.mishap for verdict in results.verdicts} | {mishap.name for mishap in mishaps}
        rows = [mishap for name, mishap in CATALOGUE.items() if name in names]
        text = page(rows, [way for way in WAYS if way in there], results)
        pathlib.Path(request["output"]).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())
