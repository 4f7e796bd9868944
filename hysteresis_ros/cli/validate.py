# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis validate``: a parameter file against a recording it has not seen."""

from __future__ import annotations

import pathlib

import click

from hysteresis_ros.cli.arguments import ConfigurationName
from hysteresis_ros.cli.data_options import data_options, format_figures, read, write_json
from hysteresis_ros.cli.identify import FIRST
from hysteresis_ros.cli.progress import shown


@click.command(short_help="Validate a parameter file on a recording.")
@click.argument("params", type=ConfigurationName())
@click.argument("data", type=click.Path(path_type=pathlib.Path))
@click.option("--report", "report_path", type=click.Path(path_type=pathlib.Path), help="HTML page to write.")
@click.option("--no-inverse", is_flag=True, help="Leave the inverse out.")
@data_options
def validate(params, data, report_path, no_inverse, skip, offset, intersample, initial, json_path, **columns):
    """Simulate the plant of PARAMS under the voltage of DATA and compare with what was measured.

    Prints the errors of the model (m, % of stroke, fit %), of its inverse (V, m), and whether the residual is white.
    """
    from hysteresis_ros.identification import workflow

    namespace = columns["namespace"] or ""
    reading = read(data, whole=True, **columns)
    conditions = dict(skip=skip, offset=offset, intersample=intersample, initial=initial)
    with shown("simulating what was measured"):
        found = workflow.validate(params, reading, namespace=namespace, inverse=not no_inverse, **conditions)
    summary = {**found.figures, "warnings": list(found.warnings)}
    if report_path is not None:
        from hysteresis_ros.analysis.identification_report import write_validation_report

        write_validation_report(report_path, found)
        summary["report"] = str(report_path)
    write_json(summary, json_path, format_figures(summary, FIRST))
