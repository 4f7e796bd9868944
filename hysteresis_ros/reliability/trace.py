# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What was seen while something went wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Samples:
    """What the plant did.

    Parameters
    ----------
    time : ndarray, shape (N,)
        When it was seen [s], on one clock with everything else.
    stamp : ndarray, shape (N,)
        Of the sample [s].
    voltage, displacement : ndarray, shape (N,)
        What the plant put out [V], and where it was [m].
    life : ndarray, shape (N,)
        Which life of the plant it is: one that begins again knows nothing of the voltage before.
    """

    time: np.ndarray
    stamp: np.ndarray
    voltage: np.ndarray
    displacement: np.ndarray
    life: np.ndarray

    @classmethod
    def of(cls, rows) -> Samples:
        """Return the samples of rows with these five numbers.

        Parameters
        ----------
        rows : iterable of sequence of float
        """
        table = np.array([tuple(row) for row in rows], dtype=np.float64).reshape(-1, 5).T
        return cls(*table)

    def between(self, begun: float, ended: float) -> Samples:
        """Return those that were seen in a time.

        Parameters
        ----------
        begun, ended : float
            [s]
        """
        within = (self.time >= begun) & (self.time <= ended)
        columns = (self.time, self.stamp, self.voltage, self.displacement, self.life)
        return Samples(*(column[within] for column in columns))


@dataclass(frozen=True)
class Trace:
    """One mishap, once, in one way of running.

    Parameters
    ----------
    mishap, way : str
    amount : float
        Of what was done.
    load : float
        Of the machine meanwhile, processes that want to run.
    begun, ended, recovered : float
        When it began and ended, and when the axis followed a setpoint again [s]; NaN: it did not.
    asked : tuple of float
        Lowest and highest place that was asked for, rest included [m].
    samples : Samples
        From a moment before until the recovery.
    broken : tuple of str
        What else did not happen as it must: processes that died, tracebacks, calls without an answer.
    said : str
        The gravest that the nodes said of themselves on ``/diagnostics``.
    notes : tuple of str
        What a reader of the table should know.
    """

    mishap: str
    way: str
    amount: float
    load: float
    begun: float
    ended: float
    recovered: float
    asked: tuple[float, float]
    samples: Samples
    broken: tuple[str, ...] = ()
    said: str = ""
    notes: tuple[str, ...] = ()

    def with_samples(self, samples: Samples) -> Trace:
        """Return the same with what a recording holds in the place of what was seen.

        Parameters
        ----------
        samples : Samples
            Of a whole run.
        """
        last = self.recovered if np.isfinite(self.recovered) else np.inf
        return replace(self, samples=samples.between(self.begun, last))
