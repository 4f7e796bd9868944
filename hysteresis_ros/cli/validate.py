"""``hysteresis validate``: a parameter file against a recording it has not seen."""

from __future__ import annotations

import pathlib

import click

from hysteresis_ros.cli.data_options import data_options, finite, format_figures, inverse_figures, read_data, write_json
from hysteresis_ros.cli.identify import FIRST


@click.command(short_help="Validate a parameter file on a recording.")
@click.argument("params", type=click.Path(path_type=str))
@click.argument("data", type=click.Path(path_type=pathlib.Path))
@click.option("--report", "report_path", type=click.Path(path_type=pathlib.Path), help="HTML page to write.")
@click.option("--no-inverse", is_flag=True, help="Leave the inverse out.")
@data_options
def validate(params, data, report_path, no_inverse, skip, offset, intersample, initial, json_path, **columns):
    """Simulate the plant of PARAMS under the voltage of DATA and compare with what was measured.

    Prints the errors of the model (m, % of stroke, fit %), of its inverse (V, m), and whether the residual is white.
    """
    from hysteresis_ros.identification.parameter_file import load_chain
    from hysteresis_ros.identification.prediction import at_rate, judge, predict

    namespace = columns["namespace"] or ""
    chain, section = load_chain(params, namespace)
    recording, checks = read_data(data, **columns)
    if not chain.mechanical:
        chain = at_rate(chain, recording.sample_time)
    predicted = predict(chain, recording.input, recording.sample_time, intersample, initial, measured=recording.output)
    found, back, reason = judge(
        chain, recording.input, recording.output, predicted, skip or 0, offset == "free", 0, not no_inverse
    )
    figures = found.to_dict()
    judged = figures.pop("warnings")
    notes = [*checks.warnings, *_beyond(chain, recording), *judged]
    if back is None and not no_inverse:
        notes.append(f"no inverse validation: {reason}")
    summary = finite(
        {
            "model": chain.hysteresis.type,
            **figures,
            **inverse_figures(back),
            "largest_autocorrelation": found.autocorrelation.largest,
            "autocorrelation_bound": found.autocorrelation.bound,
            "lags_outside": found.autocorrelation.outside,
        }
    )
    summary |= {"identified_from": section.get("source"), "data": recording.source, "warnings": notes}
    if report_path is not None:
        from hysteresis_ros.analysis.identification_report import write_validation_report

        write_validation_report(report_path, recording, chain, predicted, found, back, summary)
        summary["report"] = str(report_path)
    write_json(summary, json_path, format_figures(summary, FIRST))


def _beyond(chain, recording):
    """Yield a warning when the data leaves the range of voltages the model was identified in."""
    low, high = recording.input_range
    margin = 0.01 * (chain.voltage_high - chain.voltage_low)
    if low < chain.voltage_low - margin or high > chain.voltage_high + margin:
        yield (
            f"the voltage runs from {low:.4g} to {high:.4g} V, beyond the {chain.voltage_low:.4g} … "
            f"{chain.voltage_high:.4g} V the model was identified in: extrapolated"
        )
