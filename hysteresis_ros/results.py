# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What the functions for scripts return: a run with its signals by name, designs with their files, and a response."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.learning.parameters import LearningParameters
from hysteresis_ros.control.margins import Margins
from hysteresis_ros.errors import HysteresisError
from hysteresis_ros.identification.parameter_file import write_file
from hysteresis_ros.identification.response_file import save_response
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import save_run
from hysteresis_ros.simulation.axis_response import AxisResponse

if TYPE_CHECKING:
    import pandas


class Run(Recording):  # numpydoc ignore=PR02
    """Signals of a run or of any recording, by name: ``run.displacement`` or ``run["displacement"]``.

    Parameters
    ----------
    time : array_like, shape (N,)
        Instants [s], finite and strictly increasing.
    signals : dict of str to array_like, shape (N,)
        Named signals in SI units; NaN where a sample of a signal is missing.
    units : dict of str to str, optional
        Unit of each signal; those that the package knows (``voltage``, ``displacement`` …) need not be given.
    metadata : dict, optional
        Whatever JSON can hold, such as ``configuration`` (YAML text of the axis) and ``notes``.

    Raises
    ------
    RecordingError
        A shape, a unit or the time axis is wrong; the message names the signal.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> run = hr.Run([0.0, 0.1, 0.2], {"voltage": [0.0, 5.0, 10.0], "measured": [0.0, 0.4e-6, 0.9e-6]})
    >>> run.voltage
    array([ 0.,  5., 10.])
    >>> run.units["measured"]
    'm'
    """

    @classmethod
    def of(cls, recording: Recording) -> Run:
        """Return a recording as a run; its arrays are shared.

        Parameters
        ----------
        recording : Recording
            Whatever the package reads or makes.

        Returns
        -------
        Run
            The same signals.
        """
        return cls(recording.time, recording.signals, recording.units, recording.metadata)

    def __getattr__(self, name: str) -> np.ndarray:
        # asked for only what is no attribute; before the fields are there (copying, unpickling), nothing is a signal
        signals = self.__dict__.get("signals", {})
        if name in signals:
            return signals[name]
        there = f"; the signals are {', '.join(signals)}" if not name.startswith("_") else ""
        raise AttributeError(f"the run has no signal or attribute {name!r}{there}")

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.signals]

    def __repr__(self) -> str:
        columns = ", ".join(f"{name} [{unit}]" for name, unit in self.units.items())
        return f"Run of {len(self)} samples, {self.sample_time:.6g} s apart: {columns}"

    def between(self, first: float, last: float) -> Run:
        """Return the part of the run between two instants, both included; its arrays are copies.

        Parameters
        ----------
        first, last : float
            Seconds since the first sample.

        Returns
        -------
        Run
            The same signals.

        Raises
        ------
        RecordingError
            There are fewer than two samples.

        Examples
        --------
        >>> import hysteresis_ros as hr
        >>> len(hr.simulate("kim2009", duration=0.02).between(0.01, 0.015))
        16
        """
        from hysteresis_ros.analysis.excerpt import within

        return Run.of(within(self, first, last))

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the signals as a table of pandas, the time [s] as its index.

        Returns
        -------
        pandas.DataFrame
            One column a signal; the units are in ``attrs["units"]``.

        Raises
        ------
        HysteresisError
            Pandas is not installed; the message says how to.

        Examples
        --------
        >>> import hysteresis_ros as hr
        >>> table = hr.simulate("kim2009", duration=0.01).to_dataframe()  # doctest: +SKIP
        """
        try:
            import pandas
        except ImportError:
            raise HysteresisError(
                'pandas is not installed: pip install pandas, or "hysteresis_ros[notebook]"'
            ) from None
        table = pandas.DataFrame(self.signals, index=pandas.Index(self.time, name="time"))
        table.attrs["units"] = {"time": "s", **self.units}
        return table

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the run as ``.npz``, ``.csv`` or ``.mcap``; the ending decides.

        Parameters
        ----------
        path : path-like
            Where to; an existing table is replaced, an existing bag is not.

        Raises
        ------
        RecordingError
            The ending is another, or the file cannot be written.
        """
        save_run(self, path)


@dataclass(frozen=True, eq=False)
class DesignedFile:  # numpydoc ignore=PR02
    """What was designed, and the parameter file that holds it.

    Parameters
    ----------
    lines : tuple of str
        The table that ``hysteresis design`` prints.
    text : str
        The parameter file: that of the design's source with what was designed.
    """

    lines: tuple[str, ...]
    text: str

    def __str__(self) -> str:
        return "\n".join(self.lines)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the parameter file whole or not at all.

        Parameters
        ----------
        path : path-like
            A ``.yaml`` file.

        Raises
        ------
        HysteresisError
            It cannot be written.
        """
        write_file(path, self.text)


@dataclass(frozen=True, eq=False)
class Design(DesignedFile):  # numpydoc ignore=PR02
    """A designed controller, and the configuration that holds it.

    Parameters
    ----------
    lines : tuple of str
        The table that ``hysteresis design`` prints.
    text : str
        The parameter file: that of the design's source with the new controller.
    parameters : ControllerParameters
        Type, gains and model of the controller.
    margins : Margins
        Bandwidth [Hz], margins and poles of the loop with the controller's model; ``margins.meets`` says whether
        they are those that every design is held to, ``margins.misses()`` what is missing.
    warnings : tuple of str
        What is to be doubted, in sentences.
    """

    parameters: ControllerParameters
    margins: Margins
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class DesignedLearning(DesignedFile):  # numpydoc ignore=PR02
    """A designed learning over the periods of a scan, and the configuration that holds it.

    Parameters
    ----------
    lines : tuple of str
        The table that ``hysteresis design --learning`` prints.
    text : str
        The parameter file: that of the design's source with the learning.
    parameters : LearningParameters
        Kind, period, filters and bounds of the learning.
    """

    parameters: LearningParameters


class Response(AxisResponse):  # numpydoc ignore=PR02
    """A measured frequency response of an axis; ``print`` shows the table of ``hysteresis frf``.

    Parameters
    ----------
    plan : Plan
        Where the excitation stands in the recording.
    plant : Analysis
        Response from voltage or command to the measured displacement, with its band: ``plant.response.frequency``
        [Hz], ``plant.response.response``.
    loop : MeasuredLoop, optional
        Of a closed loop: loop transfer, sensitivity and margins.
    model : ndarray of complex, shape (F,), optional
        What the controller's model has for the plant, at the lines.
    model_loop : ndarray of complex, shape (F,), optional
        What it has for the loop.
    margins : Margins, optional
        Of the model's loop.
    """

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the response: ``.npz`` (for :func:`.design`), ``.csv`` or ``.yaml``; the ending decides.

        Parameters
        ----------
        path : path-like
            Where to; an existing file is replaced.

        Raises
        ------
        RecordingError
            The ending is another, or the file cannot be written.
        """
        save_response(path, self.plant, self.columns, self.figures)
