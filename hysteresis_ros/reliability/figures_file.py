# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What a campaign came to, in a file: ways of running that were tried one after the other make one page."""

from __future__ import annotations

import json
import pathlib
from dataclasses import asdict, dataclass, replace

from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.reliability.conditions import Conditions
from hysteresis_ros.reliability.judge import Figures, Verdict
from hysteresis_ros.reliability.trace import Samples, Trace


@dataclass(frozen=True)
class Results:
    """What campaigns came to.

    Parameters
    ----------
    config : str
        Which axis.
    verdicts : tuple of Verdict
    before, after : Conditions
        At the beginning and the end.
    """

    config: str
    verdicts: tuple[Verdict, ...]
    before: Conditions
    after: Conditions

    def and_of(self, other: Results) -> Results:
        """Return these and those of another campaign.

        Parameters
        ----------
        other : Results

        Raises
        ------
        ConfigurationError
            It was of another axis.
        """
        if other.config != self.config:
            raise ConfigurationError(f"figures of {other.config} do not belong beside those of {self.config}")
        first = min((self.before, other.before), key=lambda when: when.date)
        last = max((self.after, other.after), key=lambda when: when.date)
        return Results(self.config, other.verdicts + self.verdicts, first, last)

    def save(self, path: pathlib.Path) -> None:
        """Write them as JSON; of the samples only what they came to.

        Parameters
        ----------
        path : pathlib.Path
            The file.
        """
        rows = [
            {"figures": asdict(one.figures), "failures": one.failures, "trace": _without_samples(one.trace)}
            for one in self.verdicts
        ]
        table = {"config": self.config, "before": asdict(self.before), "after": asdict(self.after), "verdicts": rows}
        path.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _without_samples(trace: Trace) -> dict:
    return {name: value for name, value in vars(trace).items() if name != "samples"}


def load_results(path: pathlib.Path) -> Results:
    """Read what :meth:`Results.save` has written.

    Parameters
    ----------
    path : pathlib.Path

    Raises
    ------
    ConfigurationError
        It cannot be read, or holds something else.
    """
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        verdicts = tuple(
            Verdict(_trace(row["trace"]), Figures(**row["figures"]), tuple(row["failures"]))
            for row in table["verdicts"]
        )
        return Results(table["config"], verdicts, Conditions(**table["before"]), Conditions(**table["after"]))
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{path}: no figures of hysteresis faults --json: {error}") from None


def _trace(values: dict) -> Trace:
    made = Trace(samples=Samples.of(()), **values)
    low, high = made.asked
    return replace(made, asked=(low, high), broken=tuple(made.broken), notes=tuple(made.notes))
