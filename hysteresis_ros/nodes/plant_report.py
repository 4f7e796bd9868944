# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What ``plant_simulator`` says of its axis: why it was stopped, and what is wrong."""

from __future__ import annotations

from hysteresis_ros.nodes.diagnostics import ERROR, OK, WARN


def explain_trip(part, runner) -> str:
    """Say why a plant has stopped the axis, and what lets it go on.

    Parameters
    ----------
    part : PlantPart
    runner : Runner
        Of its node.
    """
    if part.failure:
        return f"{part.failure}; ~/start tries the device again, cleanup and configure open it anew"
    if part.lost:
        return f"{part.lost} is lost: nothing has come from it; start it again, then call ~/start"
    if part.finding_home:
        return "its relative sensor is homed at the safe voltage; it goes on by itself"
    if part.halted:
        return "an emergency stop (~/stop of a fused axis, or estop); ~/start lets it go on"
    if part.overtravelled:
        low, high = part.travel
        where = f"measured beyond {1e6 * low:.4g} … {1e6 * high:.4g} µm (overtravel)"
        others = "look at gains, delay and scaling"
        late = runner.late_samples
        if not late:
            return f"{where}, where an unstable loop or a wrong sensor gets: {others}; ~/start lets it go on"
        return (
            f"{where} after {late} late samples: voltages that come late make a loop unstable, so look at these first "
            f"(`hysteresis doctor` says what this machine holds); if they are not the cause, {others}; ~/start lets it "
            "go on"
        )
    return runner.explain_trip()


def verdict(part, runner, inputs, late: int, limited: str = "") -> tuple[int, str]:
    """Return level and words of a plant's diagnostics.

    Parameters
    ----------
    part : PlantPart
    runner : Runner
    inputs : list of VoltageInput
        Whoever drives the plant.
    late : int
        Samples that were late since this was last asked.
    limited : str
        For how long its output was limited lately; empty: for no more than a moment.
    """
    topics = " or ".join(input_.topic for input_ in inputs)
    if part.tripped:
        return WARN if part.finding_home else ERROR, f"axis stopped: {explain_trip(part, runner)}"
    if part.silent:
        return ERROR, f"{topics} is stale"
    if limited:
        return WARN, f"{limited}; {part.complaint}" if part.complaint else limited
    if part.complaint:
        return WARN, part.complaint
    if part.saturated:
        return WARN, "voltage saturated"
    if late:
        return WARN, f"{late} samples late"
    if runner.by_message and not runner.exact and not any(input_.received for input_ in inputs):
        return WARN, f"no {topics} has come yet: nobody drives the axis"
    return OK, ""
