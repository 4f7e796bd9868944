# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Write a policy as a command asks for it: ``python -m hysteresis_ros.nodes.security '{"config": …}'``.

The argument has ``config``, ``output``, ``namespace`` (or null), ``rate`` (or null), ``processes`` (or null: as `up`
decides), ``record`` and ``external`` (truths), ``remap`` (list).
"""

from __future__ import annotations

import json
import sys

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.identification.parameter_file import write_file
from hysteresis_ros.loop.axis_parameters import AxisParameters, in_time
from hysteresis_ros.nodes.security.policy import policy_text
from hysteresis_ros.nodes.security.used import enclaves_of
from hysteresis_ros.simulation.axes import axes


def main() -> int:
    """Do what the only argument says; return the exit code."""
    request = json.loads(sys.argv[1])
    try:
        found, processes, record = _axes(request), request["processes"], request["record"]
        enclaves = enclaves_of(found, composed=processes is False, record=record, remap=tuple(request["remap"]))
        write_file(request["output"], policy_text(enclaves))
    except HysteresisError as error:
        print(f"hysteresis: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    print(f"{request['output']}: {', '.join(enclave.path for enclave in enclaves)}")
    return 0


def _axes(request: dict) -> list[AxisParameters]:
    """Return the axes that `up` would start with the same options."""
    everywhere = {"time_mode": request["rate"]} if request["rate"] else {}
    if request["external"]:
        everywhere["external_plant"] = True
    found = axes(load_configuration(request["config"]).override("", **everywhere), request["namespace"])
    if request["record"]:
        found = [axis.with_recorder("recording") for axis in found]
    as_is = request["rate"] is not None or request["processes"] is not None
    return found if as_is else [in_time(axis) for axis in found]


if __name__ == "__main__":
    raise SystemExit(main())
