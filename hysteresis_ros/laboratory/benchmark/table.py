# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Output of a benchmark: a printed table, CSV, JSON, and a page with a figure."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from hysteresis_ros.analysis.page import render_page, write_page
from hysteresis_ros.analysis.plots import data_uri, new_figure
from hysteresis_ros.laboratory.benchmark.judging import Row
from hysteresis_ros.laboratory.benchmark.manifest import Task
from hysteresis_ros.units import readable

TITLE = "Benchmark of models of hysteresis"
HEADINGS = ("model", "error (RMS)", "95 % interval", "of stroke", "largest", "parameters", "fit", "prediction")
#: How the figures were obtained.
JUDGED = (
    "Each model is fitted to the train part. For the test part it receives only the input, and runs freely from rest.",
    "Error: RMS of measured minus predicted output over the judged samples of the test part.",
    "Interval: 95 %, by resampling blocks of the squared error that are longer than its correlation time; it holds for "
    "other parts of this recording, not for other recordings.",
    "Fit and prediction: processor time, including the compilation of compiled models.",
)
#: Lowest and highest error on the axis of the figure [% of stroke].
LOWEST, HIGHEST = 1e-3, 100.0


def cells(row: Row) -> list[str]:
    """Return the cells of a row under :data:`HEADINGS`; if there is no error, the second cell is the problem."""
    if math.isnan(row.error):
        return [row.model, row.problem, *[""] * (len(HEADINGS) - 2)]
    return [
        row.model,
        readable(row.error, row.unit),
        f"{readable(row.low, row.unit)} … {readable(row.high, row.unit)}",
        f"{row.percent:.3g} %",
        readable(row.maximum, row.unit),
        "-" if row.parameters is None else str(row.parameters),
        f"{row.fit_seconds:.3g} s",
        f"{row.predict_seconds:.2g} s",
    ]


def format_table(tasks: Sequence[Task], rows: Sequence[Row]) -> str:
    """Return the printed table, recording by recording."""
    lines = []
    for task in tasks:
        found = [row for row in rows if row.recording == task.name]
        table = [list(HEADINGS), *(cells(row) for row in found if not math.isnan(row.error))]
        widths = [max(len(line[place]) for line in table) for place in range(len(HEADINGS))]
        lines += ["", f"{task.name}: {task.about}" if task.about else task.name]
        lines.append(
            f"  fit: {len(task.train)} samples; test: {len(task.test) - task.first} samples, stroke "
            f"{readable(task.stroke, task.test.output_unit)}"
        )
        for line in table:
            first, *others = (cell.rjust(width) for cell, width in zip(line, widths, strict=True))
            lines.append("  " + "  ".join([line[0].ljust(widths[0]), *others]).rstrip())
        lines += [f"  {row.model}: {row.problem}" for row in found if row.problem]
    return "\n".join(lines).lstrip("\n")


def to_csv(rows: Sequence[Row]) -> str:
    """Return the rows as CSV with a header; errors in the unit of the output."""
    text = io.StringIO()
    names = [*Row.__dataclass_fields__, "percent"]
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        values = {**asdict(row), "percent": row.percent}
        writer.writerow({name: _written(value) for name, value in values.items()})
    return text.getvalue()


def _written(value):
    """Return a value for a text table; empty if it is unknown."""
    return "" if value is None or (isinstance(value, float) and not math.isfinite(value)) else value


def to_json(tasks: Sequence[Task], rows: Sequence[Row], left_out: Sequence[str]) -> dict:
    """Return everything as JSON: recordings, rows, and recordings whose files are missing."""
    return {
        "judged": list(JUDGED),
        "recordings": [
            {
                "name": task.name,
                "about": task.about,
                "train_samples": len(task.train),
                "test_samples": len(task.test) - task.first,
                "sample_time_s": task.train.sample_time,
                "stroke": task.stroke,
                "unit": task.test.output_unit,
                "truth": None if task.truth is None else dict(task.truth),
            }
            for task in tasks
        ],
        "rows": [
            {name: _written(value) or (None if _written(value) == "" else value) for name, value in asdict(row).items()}
            for row in rows
        ],
        "left_out": list(left_out),
    }


def errors_figure(tasks: Sequence[Task], rows: Sequence[Row]):
    """Return the figure of the errors [% of stroke] with their intervals, one line per recording."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    models = list(dict.fromkeys(row.model for row in rows))
    figure, (axis,) = new_figure(1.2 + 0.16 * (len(models) + 1.5) * len(tasks))
    spread = 0.75 / max(len(models), 1)
    for number, model in enumerate(models):
        places, values, ends = [], [], []
        for place, task in enumerate(tasks):
            for row in rows:
                if (row.model, row.recording) == (model, task.name) and math.isfinite(row.error):
                    percent = float(np.clip(row.percent, LOWEST, HIGHEST))
                    factor = percent / row.error if row.error else 0.0
                    places.append(place + spread * (number - 0.5 * (len(models) - 1)))
                    values.append(percent)
                    ends.append((max(percent - factor * row.low, 0.0), max(factor * row.high - percent, 0.0)))
        if values:
            axis.errorbar(values, places, xerr=np.array(ends).T, fmt="o", markersize=4.5, capsize=2.5, label=model)
    axis.set(xscale="log", xlabel="RMS error [% of stroke]", ylim=(len(tasks) - 0.5, -0.5))
    axis.set_yticks(range(len(tasks)), [task.name for task in tasks])
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=6, frameon=False, fontsize=9)
    return figure


def write_benchmark_page(path, tasks: Sequence[Task], rows: Sequence[Row], left_out: Sequence[str]) -> None:
    """Write the page."""
    tables = [
        dict(
            title=task.name,
            about=task.about,
            size=f"fit: {len(task.train)} samples; test: {len(task.test) - task.first} samples; stroke "
            f"{readable(task.stroke, task.test.output_unit)}.",
            rows=[cells(row) for row in rows if row.recording == task.name and not math.isnan(row.error)],
            problems=[f"{row.model}: {row.problem}" for row in rows if row.recording == task.name and row.problem],
        )
        for task in tasks
    ]
    picture = data_uri(errors_figure(tasks, rows))
    write_page(
        path,
        render_page(
            "benchmark.html.j2",
            title=TITLE,
            headings=HEADINGS,
            tables=tables,
            picture=picture,
            judged=JUDGED,
            left_out=left_out,
        ),
    )
