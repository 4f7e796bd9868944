# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The experiments of Auwal et al. 2017 on the axis of ``config/auwal2017.yaml``, which states its assumptions.

The experiments are: the transfer function and its validation (section 2), Bouc-Wen's model and its identification
(section 3), PID and inverse multiplicative compensation (sections 4 and 5). Then they are repeated with the limits of
the stack, model errors, noise, creep, several cycles, other frequencies and the paper's camera. Better controllers are
compared with the paper's controllers.
"""

from __future__ import annotations

import numpy as np

from hysteresis_ros.analysis.identification_report import correlations_figure, trajectory_figure
from hysteresis_ros.configuration import Configuration, load_configuration, parse_configuration
from hysteresis_ros.laboratory.papers.auwal2017 import axis as auwal
from hysteresis_ros.laboratory.papers.auwal2017 import control, model
from hysteresis_ros.laboratory.papers.auwal2017 import control as honest
from hysteresis_ros.laboratory.papers.auwal2017.model import PUBLISHED_G4
from hysteresis_ros.laboratory.papers.claims import (
    Reproduction,
    errors_comparison,
    loops_comparison,
    responses_comparison,
    traces_comparison,
)

TITLE = "Auwal et al. 2017, d33 piezo stack: PID and inverse multiplicative compensation of Bouc-Wen hysteresis"

# Runs in the plots within 0 … 150 V, otherwise as in the paper.
LIMITED = "limited"
# Runs in the plots with all realistic conditions together.
HONEST = "honest"


def reproduce(configuration: Configuration | None = None) -> Reproduction:
    """Repeat the paper's experiments and check every claim."""
    configuration = load_configuration("auwal2017") if configuration is None else configuration
    runs = control.paper_runs(configuration)
    limited_claims, limited = honest.limit_claims(configuration)
    condition_claims, together = honest.condition_claims(configuration)
    claims = [
        *model.transfer_function_claims(),
        *model.bouc_wen_claims(),
        *control.tuning_claims(control.tune(configuration)),
        *control.comparison_claims(runs),
        *limited_claims,
        *honest.mismatch_claims(configuration),
        *condition_claims,
        *honest.frequency_claims(configuration),
        *honest.camera_claims(configuration),
    ]
    shown = dict(runs)
    shown |= {f"{LIMITED} {method}": run for method, run in limited.items()}
    shown |= {f"{HONEST} {method}": run for method, run in together.items()}
    return Reproduction("auwal2017", TITLE, tuple(claims), shown, configuration.original)


def figures(found: Reproduction) -> list:
    """Return the plots of a reproduction: captions and figures; needs Matplotlib."""
    paper = {method: found.runs[method] for method in honest.ALL}
    limited = {method: found.runs[f"{LIMITED} {method}"] for method in honest.ALL}
    together = {method: found.runs[f"{HONEST} {method}"] for method in honest.ALL}
    loops = {auwal.METHODS[m]: (paper[m]["reference"], paper[m]["displacement"]) for m in ("none", "pid", "inverse")}
    frequency = np.geomspace(0.05, 100.0, 800)
    points = 2j * np.pi * frequency
    responses = {
        name: np.polyval(numerator, points) / np.polyval(denominator, points)
        for name, (numerator, denominator) in (("G4", PUBLISHED_G4), ("G2", auwal.G2))
    }
    bouc_wen = model.bouc_wen_found().model.search
    tuning = control.tune(parse_configuration(found.configuration, found.name))
    small = tuple(auwal.METHODS[method] for method in honest.WAYS)
    middle = 0.5 / auwal.HONEST_FREQUENCY
    return [
        ("Frequency response of G4 and of G2 [µm/V]", responses_comparison(frequency, responses)),
        (
            "Correlations of the residual of G4 fitted to a synthetic recording, with bounds of 99.9 % for each lag",
            correlations_figure(model.identified().validation),
        ),
        (
            "Bouc-Wen parameters versus the iterations of Nelder-Mead, each divided by its final value",
            trajectory_figure(("d_e", "α", "β", "γ"), bouc_wen.runs[bouc_wen.best].trajectory),
        ),
        (
            "PID gains versus the iterations of Nelder-Mead, each divided by its final value",
            trajectory_figure(("K_P", "K_I", "K_D"), tuning.trajectory),
        ),
        ("The paper's triangle: loops of its three controllers", loops_comparison(loops)),
        ("The paper's triangle: errors, with and without the uncompensated run", _errors(paper, small)),
        ("The paper's triangle within 0 … 150 V: errors", _errors(limited, small)),
        (
            "All realistic conditions together, d_e of the model 5 % too large: two triangles of 0.1 Hz, and the "
            "first reversal",
            traces_comparison(
                {auwal.METHODS[method]: run for method, run in together.items()}, (middle - 0.5, middle + 1.0)
            ),
        ),
        ("All realistic conditions together: errors", _errors(together, small)),
    ]


def _errors(runs, smaller: tuple[str, ...] = ()):
    shown = {auwal.METHODS[method]: (run.time, auwal.error(run)) for method, run in runs.items()}
    return errors_comparison(shown, smaller)
