# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis repair``: make a bag whole that was cut off."""

from __future__ import annotations

import pathlib

import click

from hysteresis_ros.cli.progress import shown


@click.command(short_help="Make a bag whole that was cut off or is damaged.")
@click.argument("bag", type=click.Path(path_type=pathlib.Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=pathlib.Path), help="Folder to create; BAG_repaired by default."
)
def repair(bag: pathlib.Path, output: pathlib.Path | None) -> None:
    """Write what is left of BAG (a folder, .mcap or .db3) into a new folder that every tool reads.

    Up to the last whole message nothing is lost; index, statistics and metadata.yaml are made anew, so that ros2 bag,
    Foxglove and rosbags open it. BAG itself stays as it is. The reports of this package read a bag that was cut off
    without this, too.
    """
    from hysteresis_ros.recordings import repair as repairing

    with shown(f"repairing {bag.name}"):
        done = repairing.repair(bag, output)
    if done.path is None:
        click.echo(f"{bag}: is whole, {done.messages} messages; nothing to repair")
        return
    for line in done.lost:
        click.echo(f"left out: {line}", err=True)
    mended = f"{', '.join(done.mended)} made whole" if done.mended else "metadata.yaml made anew"
    click.echo(f"{done.path}: {done.messages} messages; {mended}")
