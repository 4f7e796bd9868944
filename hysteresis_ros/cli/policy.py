# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis policy``: who may say and hear what, for SROS 2."""

from __future__ import annotations

import pathlib

import click

from hysteresis_ros.cli.arguments import ConfigurationName


@click.command(short_help="Write the SROS 2 policy of the nodes of a configuration.")
@click.argument("config", type=ConfigurationName())
@click.option("-o", "--output", required=True, type=click.Path(path_type=pathlib.Path), help="Policy file to write.")
@click.option("--processes/--composed", "processes", default=None, help="As `up` would start them.")
@click.option("--rate", type=click.Choice(["realtime", "lockstep", "fused"]), help="Time mode, as with `up`.")
@click.option("--record", is_flag=True, help="With a recorder.")
@click.option("--plant", type=click.Choice(["own", "external"]), default="own", show_default=True, help="As with `up`.")
@click.option("--namespace", help="Only the axis in this namespace.")
@click.option("--remap", multiple=True, metavar="FROM:=TO", help="A remapping that the nodes get; may be repeated.")
def policy(config, output, processes, rate, record, plant, namespace, remap):
    """Write what each process of CONFIG uses, and nothing else, as a policy that `ros2 security` reads.

    The nodes are made and asked where nobody hears them; no device is opened. Beside their enclaves there are those of
    an operator, who may say what people say and call services, of a monitor, who may only hear, of watch, who serves
    the page, and of epics_ioc.
    """
    from hysteresis_ros.nodes.apart import run_apart

    request = {"config": config, "output": str(output), "namespace": namespace, "rate": rate, "processes": processes}
    request |= {"record": record, "external": plant == "external", "remap": list(remap)}
    raise SystemExit(run_apart("hysteresis_ros.nodes.security", request))
