# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The workflow for scripts and notebooks: ``import hysteresis_ros as hr``, then a few lines. SI units everywhere.

``hr.load``, ``hr.simulate``, ``hr.identify``, ``hr.validate`` and ``hr.report`` do what the commands of the same names
do; ``docs/api.md`` shows examples. Designs are in :mod:`hysteresis_ros.designing`, studies of several runs in
:mod:`hysteresis_ros.laboratory.studies`.
"""

from __future__ import annotations

import os
import pathlib
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike

from hysteresis_ros.arguments import Seconds, checked
from hysteresis_ros.configuration import (
    SUFFIXES,
    Configuration,
    load_configuration,
    parse_configuration,
    save_parameter_file,
    shipped_configurations,
)
from hysteresis_ros.control.controller import ControllerParameters
from hysteresis_ros.control.learning import LearningParameters
from hysteresis_ros.control.margins import Margins
from hysteresis_ros.designs.frequency_response import AxisResponse
from hysteresis_ros.designs.stage_identification import IdentifiedStage, StageRequest, identify_stage
from hysteresis_ros.errors import (
    ConfigurationError,
    HysteresisError,
    MissingExtraError,
    did_you_mean,
    shortened,
)
from hysteresis_ros.identification import workflow
from hysteresis_ros.identification.coupled import (
    IdentifiedStructure,
    StructureData,
    StructureEstimator,
    identify_structure,
)
from hysteresis_ros.identification.data import IdentificationData
from hysteresis_ros.identification.frequency_response import save_response
from hysteresis_ros.identification.prediction import predict
from hysteresis_ros.identification.reading import Columns, Reading, read_data
from hysteresis_ros.identification.registry import USUAL
from hysteresis_ros.identification.stage_data import StageColumns, read_stage, realisations
from hysteresis_ros.identification.workflow import Conditions
from hysteresis_ros.loop.axis_array import ArrayRun, AxisArray, parameters_of_each
from hysteresis_ros.loop.faults import Fault, unreached
from hysteresis_ros.loop.parameters import AxisParameters
from hysteresis_ros.loop.quiet import quiets_of
from hysteresis_ros.loop.reach import reach_warnings, single_axis
from hysteresis_ros.loop.simulation import simulate as simulate_axis
from hysteresis_ros.loop.source import SOURCES, require_accepted
from hysteresis_ros.loop.stage_parameters import StageParameters, without_drivers
from hysteresis_ros.loop.stage_response import scan_warnings
from hysteresis_ros.loop.stage_simulation import chosen_stage, displacements_between, simulate_stage, with_scan
from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run, save_run
from hysteresis_ros.references.scan import Scan
from hysteresis_ros.references.scans import scan_words
from hysteresis_ros.registry import samples as samples_of
from hysteresis_ros.units import figure_name, readable

if TYPE_CHECKING:
    import pandas

    from hysteresis_ros.analysis.scan_report import ScanRun


class Run(Recording):  # numpydoc ignore=PR02
    """Signals of a run or of any recording, by name: ``run.displacement`` or ``run["displacement"]``.

    Parameters
    ----------
    time : array_like, shape (N,)
        Instants [s], finite and strictly increasing.
    signals : dict of str to array_like, shape (N,)
        Named signals in SI units; NaN where a sample of a signal is missing.
    units : dict of str to str, optional
        Unit of each signal; not required for signals of the package (``voltage``, ``displacement`` …).
    metadata : dict, optional
        JSON values, such as ``configuration`` (YAML text of the axis) and ``notes``.

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
        """Return a recording as a run that shares its arrays.

        Parameters
        ----------
        recording : Recording
            Any recording.

        Returns
        -------
        Run
            The same signals.
        """
        kind = StageRun if recording.axes else Run
        return kind(recording.time, recording.signals, recording.units, recording.metadata)

    def __getattr__(self, name: str) -> np.ndarray:
        # an object that is being copied or unpickled has no signals yet
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

    def _repr_html_(self) -> str:
        from hysteresis_ros.analysis.notebook import run_cell

        return run_cell(self)

    def between(self, first: float, last: float) -> Run:
        """Return the part of the run between two instants, both included.

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
            The part has fewer than two samples.

        Examples
        --------
        >>> import hysteresis_ros as hr
        >>> len(hr.simulate("kim2009", duration=0.02).between(0.01, 0.015))
        16
        """
        from hysteresis_ros.analysis.parts import within

        return Run.of(within(self, first, last))

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the signals as a pandas table with the time [s] as its index.

        Returns
        -------
        pandas.DataFrame
            One column per signal; the units are in ``attrs["units"]``.

        Raises
        ------
        MissingExtraError
            Pandas is not installed; the message gives the command that installs it.

        Examples
        --------
        >>> import hysteresis_ros as hr
        >>> table = hr.simulate("kim2009", duration=0.01).to_dataframe()  # doctest: +SKIP
        """
        try:
            import pandas
        except ImportError:
            raise MissingExtraError("pandas", "notebook", "tables need it") from None
        table = pandas.DataFrame(self.signals, index=pandas.Index(self.time, name="time"))
        table.attrs["units"] = {"time": "s", **self.units}
        return table

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the run as ``.npz``, ``.csv`` or ``.mcap``; the suffix of the path selects the format.

        A ``.csv`` has no metadata; if this loses a preload offset, a Python warning states it.

        Parameters
        ----------
        path : path-like
            The file; an existing table is replaced, an existing bag is not.

        Raises
        ------
        RecordingError
            The suffix is unknown, or the file cannot be written.
        """
        from hysteresis_ros.analysis.metrics import lost_offsets

        save_run(self, path)
        _warn(lost_offsets(self, path))


class StageRun(Run):  # numpydoc ignore=PR02
    """Signals of a run of a stage: ``run["x"]`` is the :class:`Run` of one axis, ``run["x/displacement"]`` a signal.

    Parameters
    ----------
    time : array_like, shape (N,)
        Instants [s], finite and strictly increasing.
    signals : dict of str to array_like, shape (N,)
        Signals of all axes in SI units, as ``x/displacement``.
    units : dict of str to str, optional
        Unit of each signal.
    metadata : dict, optional
        JSON values.

    Raises
    ------
    RecordingError
        A shape, a unit or the time axis is wrong; the message names the signal.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> run = hr.simulate("xy_scanner", duration=0.01)
    >>> run.axes, run["x"].displacement.shape
    (('x', 'y'), (100,))
    """

    def __getitem__(self, name: str) -> Any:
        return Run.of(self.axis(name)) if name in self.axes else super().__getitem__(name)

    def __getattr__(self, name: str) -> Any:
        # a run that is being copied or unpickled has no signals, and so no axes yet
        if "signals" in self.__dict__ and name in self.axes:
            return self[name]
        return super().__getattr__(name)


class Compared(workflow.Compared):  # numpydoc ignore=PR02
    """A comparison of a model with a recording, as :func:`validate` returns it.

    Parameters
    ----------
    data : IdentificationData
        The measured data.
    plant : PlantModel
        The model: hysteresis, creep, dynamics, and the inverse that the compensator uses.
    predicted : ndarray, shape (N,)
        Displacement predicted by the model [m].
    validation : Validation
        Errors, and whether the residuals are white.
    inverse : InverseValidation or None
        Errors of the voltage that the inverse computes from the displacement; None without an inverse.
    figures : dict
        Figures by names that contain their units: ``rmse_m``, ``rmse_percent_of_stroke``, ``fit_percent``,
        ``inverse_rmse_v`` and more; None for values that are not finite. ``--json`` prints the same figures.
    warnings : tuple of str
        Warnings, one sentence each.
    recording : RecordingSummary, optional
        Summary of the recording, as lines to print.
    """

    def predict(
        self,
        voltage: ArrayLike | Recording,
        sample_time: float | None = None,
        *,
        intersample: str | None = None,
        initial: str | None = None,
    ) -> np.ndarray:
        """Return the displacement that the model predicts for a voltage; the nodes use the same kernels.

        Parameters
        ----------
        voltage : array_like, shape (N,), or Recording
            Voltage [V]; of a recording, the signal ``voltage`` and the sample time are used.
        sample_time : float, optional
            Sample time of the voltage [s]; by default the sample time of the model.
        intersample : str, optional
            Assumed course of the voltage between samples: ``zoh``, ``linear`` or ``bandlimited``; by default as in the
            identification.
        initial : str, optional
            State at the start: ``zero`` (at rest at 0 V), ``periodic`` (the voltage was periodic before) or
            ``estimate`` (at rest at the first voltage); by default as in the identification.

        Returns
        -------
        ndarray, shape (N,)
            Displacement [m], relative to the zero of the sensor.

        Raises
        ------
        IdentificationError
            The dynamics are known only for another sample time, or ``intersample`` or ``initial`` has an unknown value.
        RecordingError
            The recording has no signal ``voltage``.
        HysteresisError
            The voltage is not a one-dimensional array of finite numbers.

        Examples
        --------
        >>> found = hr.identify("loops.csv")  # doctest: +SKIP
        >>> found.predict([0.0, 10.0, 20.0])  # doctest: +SKIP
        """
        if isinstance(voltage, Recording):
            sample_time = voltage.sample_time if sample_time is None else sample_time
            voltage = voltage["voltage"]
        values = samples_of("voltage", voltage)
        if not values.size or not np.all(np.isfinite(values)):
            raise HysteresisError("voltage: must be at least one number, and all must be finite [V]")
        step = self.plant.sample_time if sample_time is None else float(sample_time)
        if not 0.0 < step < np.inf:
            raise HysteresisError(f"sample_time = {step}: must be above 0 s")
        return predict(self.plant, values, step, intersample, initial)

    def score(self, data: Measured, *, inverse: bool = True, **conditions: Unpack[Conditions]) -> Compared:
        """Compare the model with another recording, as :func:`validate` does.

        Parameters
        ----------
        data : path-like, Recording, IdentificationData or Reading
            A recording that the model was not fitted to.
        inverse : bool
            Also validate the inverse.
        **conditions
            ``skip``, ``offset``, ``intersample`` and ``initial``, see :class:`.workflow.Conditions`.

        Returns
        -------
        Compared
            With ``predicted``, ``figures`` and ``warnings``.

        Raises
        ------
        IdentificationError, DataError, RecordingError
            A choice or the data cannot be used; the message states what is allowed.

        Examples
        --------
        >>> found = hr.identify("loops.csv")  # doctest: +SKIP
        >>> found.score("other.csv").figures["rmse_m"]  # doctest: +SKIP
        """
        return Compared(**vars(super().score(data, inverse=inverse, **conditions)))

    def __repr__(self) -> str:
        units = self.plant.units
        error, share = self.figures.get(figure_name("rmse_m", units)), self.figures.get("rmse_percent_of_stroke")
        parts = [] if error is None else [f"RMS error {readable(error, units[1])}"]
        parts += [] if share is None else [f"{share:.3g} % of the stroke"]
        judged = f": {', '.join(parts)}" if parts else ""
        return f"{type(self).__name__}({self._named()}{judged}, {len(self.data)} samples{_warned(self.warnings)})"

    def _named(self) -> str:
        return self.plant.hysteresis.type

    def _repr_html_(self) -> str:
        from hysteresis_ros.analysis.notebook import model_cell

        return model_cell(self, f"{type(self).__name__}: {self._named()}")


class Identified(Compared, workflow.Identified):  # numpydoc ignore=PR02
    """The result of :func:`identify`: a :class:`Compared` with the identification and its parameter file.

    Parameters
    ----------
    data : IdentificationData
        The measured data.
    plant : PlantModel
        The model: hysteresis, creep, dynamics, and the inverse that the compensator uses.
    predicted : ndarray, shape (N,)
        Displacement predicted by the model [m].
    validation : Validation
        Errors, and whether the residuals are white.
    inverse : InverseValidation or None
        Errors of the voltage that the inverse computes from the displacement; None without an inverse.
    figures : dict
        Figures by names that contain their units, as in :class:`Compared`.
    warnings : tuple of str
        Warnings, one sentence each.
    identification : Identification
        The result with standard deviations, assumptions and, for iterative fits, the parameters after each iteration.
    text : str
        Text of the parameter file of a complete axis; plant, compensator and controller load it.
    response : ResponseCheck, optional
        How well the recording determines the frequency response; None for a model whose hysteresis contains the
        dynamics.
    recording : RecordingSummary, optional
        Summary of the recording, as lines to print.
    """

    def _named(self) -> str:
        linear = self.identification.linear
        return self.identification.model + ("" if linear in ("", "none") else f" with {linear}")


def _warned(warnings: Sequence[str]) -> str:
    """Return the number of warnings as a text to append to a line; empty without warnings."""
    return f", {len(warnings)} warning{'s' if len(warnings) > 1 else ''}" if warnings else ""


@dataclass(frozen=True, eq=False, repr=False)
class DesignedFile:  # numpydoc ignore=PR02
    """A design and the parameter file that contains it."""

    lines: tuple[str, ...]  #: The table that ``hysteresis design`` prints.
    text: str  #: Parameter file of the axis, including the design.
    parameters: Any  #: The designed parameters; they have a ``type``.

    def __str__(self) -> str:
        return "\n".join(self.lines)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.parameters.type})"

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the parameter file atomically.

        Parameters
        ----------
        path : path-like
            A ``.yaml`` or ``.yml`` file; an existing file is replaced.

        Raises
        ------
        ConfigurationError
            The file has another suffix, or cannot be written.
        """
        save_parameter_file(path, self.text, ConfigurationError)


@dataclass(frozen=True, eq=False, repr=False)
class Design(DesignedFile):  # numpydoc ignore=PR02
    """A designed controller and the configuration that contains it.

    Parameters
    ----------
    lines : tuple of str
        The table that ``hysteresis design`` prints.
    text : str
        Parameter file of the axis, including the new controller.
    parameters : ControllerParameters
        Type, gains and model of the controller.
    margins : Margins
        Bandwidth [Hz], margins and poles of the loop with the controller's model; ``margins.meets`` states whether they
        meet the specification of all designs; ``margins.misses()`` lists the unmet specifications.
    warnings : tuple of str
        Warnings, one sentence each.
    """

    parameters: ControllerParameters
    margins: Margins
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        found = self.margins
        return (
            f"Design({self.parameters.type}: bandwidth {found.bandwidth:.4g} Hz, "
            f"gain margin {found.gain_margin:.4g} dB, phase margin {found.phase_margin:.4g}°{_warned(self.warnings)})"
        )

    def _repr_html_(self) -> str:
        from hysteresis_ros.analysis.notebook import design_cell

        return design_cell(f"Design: {self.parameters.type}", self.margins, self.warnings)


@dataclass(frozen=True, eq=False, repr=False)
class DesignedLearning(DesignedFile):  # numpydoc ignore=PR02
    """Iterative learning designed for a scan, and the configuration that contains it.

    Parameters
    ----------
    lines : tuple of str
        The table that ``hysteresis design --learning`` prints.
    text : str
        Parameter file of the axis, including the learning.
    parameters : LearningParameters
        Kind, period, filters and bounds of the learning.
    """

    parameters: LearningParameters


class Response(AxisResponse):  # numpydoc ignore=PR02
    """A measured frequency response of an axis; ``print`` shows the table of ``hysteresis frf``.

    Parameters
    ----------
    plan : Plan
        Position of the excitation in the recording.
    plant : Analysis
        Response from voltage or command to the measured displacement, with its uncertainty:
        ``plant.response.frequency`` [Hz], ``plant.response.response``.
    loop : MeasuredLoop, optional
        Loop transfer function, sensitivity and margins; only for a closed loop.
    model : ndarray of complex, shape (F,), optional
        Response of the controller's model of the plant at the same frequencies.
    model_loop : ndarray of complex, shape (F,), optional
        Loop transfer function with this model.
    margins : Margins, optional
        Margins of the loop with this model.
    limited : float, optional
        Share of the excitation's samples in which range or slew rate limited the voltage [%].
    """

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the response as ``.npz`` (for :func:`.design`), ``.csv`` or ``.yaml``; the suffix selects the format.

        Parameters
        ----------
        path : path-like
            The file; an existing one is replaced.

        Raises
        ------
        RecordingError
            The suffix is unknown, or the file cannot be written.
        """
        save_response(path, self.plant, self.columns, self.figures)


__all__ = [
    "Columns",
    "Compared",
    "Configuration",
    "HysteresisError",
    "Identified",
    "IdentifiedStage",
    "IdentifiedStructure",
    "Run",
    "StageColumns",
    "StageRun",
    "StructureData",
    "StructureEstimator",
    "configurations",
    "identify",
    "identify_structure",
    "load",
    "metrics",
    "plot",
    "report",
    "scan_run",
    "simulate",
    "validate",
]

#: Suffixes of recordings; a bag is a folder.
RECORDINGS = (".npz", ".csv", ".mcap", ".db3")


#: Sources of an axis: a file, the name of a shipped configuration, or an object that this module returned.
Source: TypeAlias = "str | os.PathLike[str] | Configuration | Identified | DesignedFile | Recording"
#: Inputs of metrics and reports: a run, several runs as files or by name, or a result of this module.
_OneRun: TypeAlias = "str | os.PathLike[str] | Recording"
Reported: TypeAlias = "_OneRun | Compared | Sequence[str | os.PathLike[str]] | Mapping[str, _OneRun]"
#: Faults to inject, or a single fault.
Faults: TypeAlias = "str | Fault | Sequence[str | Fault]"
#: Inputs of an identification: a file, or data already read.
Measured: TypeAlias = "str | os.PathLike[str] | Recording | IdentificationData | Reading"


def configurations() -> tuple[str, ...]:
    """Return the names of the configurations in the package; :func:`load` and :func:`simulate` accept these names.

    Returns
    -------
    tuple of str
        In alphabetical order.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> "kim2009" in hr.configurations()
    True
    """
    return tuple(sorted(shipped_configurations()))


@checked
def load(path: str | os.PathLike[str], *, namespace: str | None = None) -> Configuration | Run:
    """Read a configuration or a recording; the suffix decides which.

    Parameters
    ----------
    path : path-like
        A parameter file (``.yaml``) or the bare name of a shipped one (``kim2009``); or a recording: a bag (folder,
        ``.mcap``, ``.db3``) or a table (``.npz``, ``.csv`` with units in its header).
    namespace : str, optional
        The axis to use, if a bag contains several.

    Returns
    -------
    Configuration or Run
        :func:`simulate` and :func:`design` accept a configuration, also with changed parameters:
        ``load("kim2009").override("motion_controller", type="open_loop")``.

    Raises
    ------
    ConfigurationError
        The file is neither a configuration nor a recording, or the parameter file cannot be read.
    RecordingError
        The recording cannot be read.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> hr.load("kim2009").node("motion_controller")["type"]
    'sliding_mode'
    """
    path = pathlib.Path(path)
    if path.suffix.lower() in RECORDINGS or path.is_dir():
        return Run.of(load_run(path, namespace, further=True))
    if path.suffix.lower() in SUFFIXES or (not path.exists() and path.name == path.stem == str(path)):
        return load_configuration(path)
    if not path.exists():
        raise ConfigurationError(f"{path}: no such file or folder; give a configuration or a recording")
    endings = ", ".join((*SUFFIXES, *RECORDINGS))
    raise ConfigurationError(f"{path}: neither a configuration nor a recording; it must be a bag or end in {endings}")


@overload
def simulate(  # numpydoc ignore=PR01
    config: Source,
    *,
    duration: float | str | None = None,
    setpoints: ArrayLike | Mapping[str, ArrayLike] | None = None,
    requests: ArrayLike | None = None,
    speeds: ArrayLike | None = None,
    faults: Faults = (),
    scan: Scan | None = None,
    quiet: Sequence[str | Sequence[float | str]] = (),
    namespace: str | None = None,
    axes: None = None,
) -> Run:
    """Run an axis, or a stage."""


@overload
def simulate(  # numpydoc ignore=PR01
    config: Source,
    *,
    duration: float | str | None = None,
    setpoints: ArrayLike | None = None,
    faults: Faults = (),
    namespace: str | None = None,
    axes: int,
    each: Mapping[str, Sequence[Any] | np.ndarray] | None = None,
    threads: int = 1,
) -> ArrayRun:
    """Run many independent axes."""


@checked
def simulate(
    config: Source,
    *,
    duration: Seconds | None = None,
    setpoints: ArrayLike | Mapping[str, ArrayLike] | None = None,
    requests: ArrayLike | None = None,
    speeds: ArrayLike | None = None,
    faults: Faults = (),
    scan: Scan | None = None,
    quiet: Sequence[str | Sequence[float | str]] = (),
    namespace: str | None = None,
    axes: int | None = None,
    each: Mapping[str, Sequence[Any] | np.ndarray] | None = None,
    threads: int = 1,
) -> Run | ArrayRun:
    """Run an axis, or a stage of coupled axes, offline from rest.

    The result of an axis is bit-identical to a run of its nodes in lockstep. If the axis may be unable to follow its
    reference, or if its output was limited by the range or a slew rate for more than a moment, a Python warning reports
    this.

    Parameters
    ----------
    config : path-like, Configuration, Identified, Design or Recording
        The axis: a parameter file, the name of a shipped one, a result of :func:`load`, :func:`identify` or
        :func:`design`, or a run, whose axis is then simulated.
    duration : float or str, optional
        Duration [s], or a text with its unit such as ``"100ms"``; by default from ``setpoints``, from the parameter
        ``samples`` or from the waveform.
    setpoints : array_like, shape (N,), or mapping of str to array_like, optional
        Setpoint at each sample [m], within the range that the axis accepts; the last setpoint is held until the end of
        the run. For a stage: a mapping by the names of its axes.
    requests : array_like, shape (N,), optional
        Requests to an inchworm's sequencer at each sample.
    speeds : array_like, shape (N,), optional
        Requested walking speed of an inchworm at each sample [m/s]; NaN: no request.
    faults : sequence of Fault or str, or one of them
        Faults to inject: ``hr.Fault("stale", 0.1, 0.3)``, or a text ``NAME:START:DURATION[:VALUE]`` with times in
        seconds, such as ``"stale:0.1:0.3"``. ``docs/topics.md`` lists the names.
    scan : Scan, optional
        Scan that a stage follows around its setpoints, such as
        ``hysteresis_ros.references.scans.scan_of("raster", {"width": 30e-6, "depth": 30e-6})``; by default the scan of
        its configuration. :func:`report` then evaluates the scan.
    quiet : sequence of tuple or str, optional
        Quiet holds of an axis: ``(start, duration)`` in seconds, optionally with the largest drift [m] as a third
        number (each may be a text with its unit), or a text such as ``"1s:500ms:5nm"``.
    namespace : str, optional
        The axis to use, if a configuration contains several; for a stage, the axis in which faults are injected.
    axes : int, optional
        Number of independent copies of this axis to run in one call (1 … 4096); setpoints may then have the shape
        (axes, N).
    each : mapping of str to sequence, optional
        Parameters in which the copies differ, as in :func:`axis_array`.
    threads : int
        Number of threads that compute the copies.

    Returns
    -------
    Run
        ``time``, ``setpoint``, ``reference``, ``command``, ``voltage``, ``displacement``, ``measured``, ``estimated``
        and the other signals of the axis. For a stage a :class:`StageRun`, which contains a run of each axis. With
        ``axes`` an :class:`.ArrayRun`, whose signals have the shape (axes, N).

    Raises
    ------
    ConfigurationError
        The configuration cannot be read, the length of the run is not given, or a fault is unknown.
    ParameterError
        A parameter, the duration or a setpoint is wrong, or the creep during a quiet hold exceeds its tolerance; the
        message states the allowed values.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> run = hr.simulate("kim2009", duration=0.01)
    >>> run.displacement.shape, run.units["displacement"]
    ((30,), 'm')
    """
    from hysteresis_ros.analysis.metrics import limited_text

    configuration, words = configuration_of(config), _words(faults)
    if quiet and (axes is not None or configuration.stage is not None):
        raise ConfigurationError("quiet is for a single axis: leave it out")
    if axes is not None:
        if requests is not None or speeds is not None or scan is not None or isinstance(setpoints, Mapping):
            raise ConfigurationError(
                "requests, speeds, a scan and setpoints by names are for a single run: leave them out, or omit axes"
            )
        array = AxisArray(_parameters_of_array(configuration, axes, each, words, namespace), threads)
        made = _run_of_array(array, setpoints, duration)
        _warn(unreached(words, made.time.size, array.sample_rate))
        return made
    if each is not None:
        raise ConfigurationError("each needs axes, the number of axes")
    if scan is not None:
        configuration = with_scan(configuration, *scan_words(scan))
    if configuration.stage is not None:
        _refuse_motor_requests("stage", requests, speeds)
        if setpoints is not None and not isinstance(setpoints, Mapping):
            raise ConfigurationError('setpoints of a stage need the names of its axes: give {"x": …, "y": …}')
        stage = chosen_stage(configuration, words, namespace)
        _warn((*stage.warnings(), *scan_warnings(stage)))
        if setpoints is not None:
            axes_of = {name: stage.axes[stage.place(name)] for name in setpoints}
            setpoints = {name: _setpoints(f"setpoints of {name}", setpoints[name], axes_of[name]) for name in axes_of}
        recording = simulate_stage(stage, duration=duration, setpoints=setpoints)
        limited = {name: limited_text(recording.axis(name)) for name in recording.axes}
        reached = unreached(words, len(recording), stage.sample_rate)
        _warn([*reached, *(f"{name}: {text}" for name, text in limited.items() if text)])
        return Run.of(recording)
    if isinstance(setpoints, Mapping):
        raise ConfigurationError("setpoints by names are for a stage, and this is a single axis: give one array")
    axis = single_axis(configuration, namespace)
    if axis.inchworm_sequencer is None:
        _refuse_motor_requests("piezo axis", requests, speeds)
    if words:
        axis = axis.with_faults(words)
    _warn(reach_warnings(axis))
    given = None if setpoints is None else _setpoints("setpoints", setpoints, axis)
    run = simulate_axis(
        axis, duration=duration, setpoints=given, requests=requests, speeds=speeds, quiet=quiets_of(quiet)
    )
    _warn([*unreached(words, len(run), axis.plant_simulator.sample_rate), *filter(None, [limited_text(run)])])
    return Run.of(run)


def _refuse_motor_requests(kind: str, *given: ArrayLike | None) -> None:
    """Refuse requests to the sequencer of an inchworm, which a ``kind`` of axis does not have."""
    if any(one is not None for one in given):
        raise ConfigurationError(f"requests and speeds are for an inchworm, and this is a {kind}: leave them out")


def _run_of_array(array: AxisArray, setpoints: ArrayLike | None, duration: float | None) -> ArrayRun:
    """Run many axes; refuse setpoints [m] that one of them would ignore."""
    samples = None if duration is None else array.parameters[0].with_duration(duration).plant_simulator.samples
    made = array.run(setpoints, samples)  # raises an error for setpoints of another shape
    if setpoints is not None:
        require_accepted("setpoints", np.asarray(setpoints, dtype=float), *array.setpoint_range.T[..., np.newaxis])
    return made


def _words(faults: Faults) -> tuple[str, ...]:
    """Return faults as texts; a single fault is a sequence of one."""
    if isinstance(faults, type) or not isinstance(faults, (Fault, Iterable, type(None))):
        raise ConfigurationError(f"faults = {shortened(faults)}: must be a fault such as 'stale:0.1:0.3', or a list")
    return tuple(map(str, [faults] if isinstance(faults, (str, Fault)) else faults or ()))


def _warn(texts: Iterable[str]) -> None:
    """Issue Python warnings that name the line of the caller of this module, outside :func:`.checked`."""
    for text in texts:
        warnings.warn(text, stacklevel=4)


def _setpoints(name: str, values: Any, axis: AxisParameters) -> np.ndarray:
    """Return setpoints [m], shape (N,); refuse setpoints that the running axis would ignore."""
    given = samples_of(name, np.atleast_1d(values))
    if not given.size:
        raise HysteresisError(f"{name}: must be at least one value [m]")
    require_accepted(name, given, *SOURCES[axis.kind.source](axis.source).setpoint_range)
    return given


@checked
def axis_array(
    config: Source,
    axes: int,
    *,
    each: Mapping[str, Sequence[Any] | np.ndarray] | None = None,
    threads: int = 1,
    faults: Faults = (),
    namespace: str | None = None,
) -> AxisArray:
    """Return many independent axes that advance together in one call, such as the actuators of a deformable mirror.

    The result of each axis is bit-identical to a run of this axis alone, for any number of axes and threads.

    Parameters
    ----------
    config : path-like, Configuration, Identified, Design or Recording
        The axis, a simulated actuator; see :func:`simulate`.
    axes : int
        Number of axes, 1 … 4096.
    each : mapping of str to sequence, optional
        Parameters in which the axes differ: ``NODE.PARAMETER`` and a value for each axis, such as
        ``{"plant_simulator.sensor.seed": range(1, 1025)}``. Axes with equal seeds have equal noise.
    threads : int
        Number of threads that compute the axes.
    faults : sequence of Fault or str, or one of them
        Faults of every axis, see :func:`simulate`.
    namespace : str, optional
        The axis to use, if a configuration contains several.

    Returns
    -------
    AxisArray
        The axes at rest: ``step(setpoints)`` for one sample, ``run(setpoints)`` for many.

    Raises
    ------
    ParameterError
        The number of axes or threads, a parameter, or the number of its values is wrong.
    ConfigurationError
        The configuration cannot be read, or its axis is not a simulated actuator.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> mirror = hr.axis_array("kim2009", 3, each={"plant_simulator.sensor.offset": [0.0, 1e-9, -1e-9]})
    >>> mirror.step([0.0, 1e-6, 2e-6]).shape
    (3,)
    """
    return AxisArray(_parameters_of_array(configuration_of(config), axes, each, faults, namespace), threads)


def _parameters_of_array(
    configuration: Configuration,
    axes: int,
    each: Mapping[str, Sequence[Any] | np.ndarray] | None,
    faults: Faults,
    namespace: str | None,
) -> list[AxisParameters]:
    """Return the parameters of each axis of an array; warn if the axes cannot follow their reference."""
    if configuration.stage is not None:
        raise ConfigurationError("axes: this is a stage of coupled axes: give the file of a single axis, or omit axes")
    axis = single_axis(configuration, namespace)
    words = _words(faults)
    if words:
        axis = axis.with_faults(words)
    for text in reach_warnings(axis):
        warnings.warn(text, stacklevel=4)
    return parameters_of_each(axis, axes, each)


@overload
def identify(  # numpydoc ignore=PR01
    source: Measured,
    model: str = USUAL,
    *,
    columns: Columns | None = None,
    linear: str | None = None,
    options: dict[str, Any] | None = None,
    inverse: str | None = None,
    progress: Any = None,
    **conditions: Unpack[Conditions],
) -> Identified:
    """Identify a model of an axis."""


@overload
def identify(  # numpydoc ignore=PR01
    source: Measured | Sequence[str | os.PathLike[str]],
    model: str = USUAL,
    *,
    columns: StageColumns,
    loops: Measured | None = None,
    into: Source | None = None,
    options: dict[str, Any] | None = None,
    progress: Any = None,
) -> IdentifiedStage:
    """Identify a stage of coupled axes."""


@checked
def identify(
    source: Any,
    model: str = USUAL,
    *,
    columns: Columns | StageColumns | None = None,
    loops: Any = None,
    into: Any = None,
    linear: str | None = None,
    options: dict[str, Any] | None = None,
    inverse: str | None = None,
    progress: Callable[..., None] | None = None,
    **conditions: Unpack[Conditions],
) -> Identified | IdentifiedStage:
    """Identify a model of an axis (hysteresis and the dynamics after it), or a stage of coupled axes, from recordings.

    Parameters
    ----------
    source : path-like, Recording, IdentificationData or Reading
        A bag, CSV or NPZ whose columns name their units (``control_V``, ``gauge_um``), or data already read; arrays as
        ``hr.Run(time, {"voltage": …, "measured": …})``.
    model : str
        Name of the model; ``hysteresis models`` lists the names. ``usual``: ``prandtl_ishlinskii``, or
        ``generalised_play`` or (after a poor fit) ``preisach`` if it predicts held-out data better; ``auto``: the best
        of all models.
    columns : Columns or StageColumns, optional
        Columns of a file, their units, and the part to use: ``hr.Columns("ch1:V", "ch2:um")``. With
        ``hr.StageColumns()`` several inputs and outputs, from one file or several, are identified as a stage.
    loops : path-like or Recording, optional
        For a stage: a recording in which one actuator after the other moves through its range.
    into : str, path-like or Configuration, optional
        For a stage: a configuration whose simulated plants or devices are kept; the rest is taken from the result.
    linear : str, optional
        Linear dynamics after the hysteresis: ``auto`` (the default: lag, delay, creep and up to two resonances, if
        they predict better), ``none``, ``lag,delay,creep,modes``, ``second_order``, ``arx`` …
    options : dict, optional
        Options of the model, such as ``{"play_count": 20}``; for a stage the options of :class:`.StageRequest`.
    inverse : str, optional
        Inverse of the compensator; by default the first inverse of the model.
    progress : callable, optional
        Called as ``progress(number, text)`` while the fit runs; for a stage as ``progress(text)``.
    **conditions
        ``skip``, ``offset``, ``intersample`` and ``initial``, see :class:`.workflow.Conditions`.

    Returns
    -------
    Identified or IdentifiedStage
        With ``parameters``, ``figures``, ``warnings`` and ``save(path)``; for a single axis also ``predicted`` and
        ``converged``. :func:`simulate`, :func:`design` and :func:`report` accept the result of a single axis directly.

    Raises
    ------
    IdentificationError, DataError, RecordingError
        The request or the data cannot be used; the message states what is allowed.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> found = hr.identify("loops.csv", "preisach", skip=200)  # doctest: +SKIP
    >>> found.figures["rmse_percent_of_stroke"]  # doctest: +SKIP
    """
    if isinstance(columns, StageColumns):
        if linear is not None or inverse is not None or conditions:
            raise HysteresisError("linear, inverse and conditions are for a single axis: leave them out for a stage")
        known = StageRequest.__dataclass_fields__
        unknown = [name for name in options or {} if name not in known]
        if unknown:
            raise HysteresisError(f"{', '.join(unknown)}: no such option of a stage; choose from {', '.join(known)}")
        request = StageRequest(**{"progress": progress, **(options or {})})
        if model != USUAL:
            request = replace(request, model=model)
        stage = read_stage(source, columns)
        base = into if into is None or isinstance(into, Configuration) else load_configuration(into)
        turns = None if loops is None else read_stage(loops, columns)
        return identify_stage(stage, realisations(stage, columns), request, turns, base)
    if loops is not None or into is not None:
        raise HysteresisError("loops= and into= are only for a stage: leave them out, or add columns=hr.StageColumns()")
    reading = read_data(source, columns)
    found = workflow.identify(
        reading, model, linear=linear, options=options, inverse=inverse, progress=progress, **conditions
    )
    return Identified(**vars(found))


@checked
def validate(
    parameters: Source,
    source: Measured,
    *,
    columns: Columns | None = None,
    namespace: str = "",
    inverse: bool = True,
    **conditions: Unpack[Conditions],
) -> Compared:
    """Simulate an identified plant with a recorded voltage and compare it with the measured displacement.

    Parameters
    ----------
    parameters : Identified, path-like, Configuration, Design or Recording
        A result of :func:`identify`, or an axis whose plant is simulated, see :func:`simulate`: a parameter file
        (identified or written by hand), or the name of a shipped one.
    source : path-like, Recording, IdentificationData or Reading
        See :func:`identify`; preferably data that the model was not fitted to.
    columns : Columns, optional
        Columns of a file, see :func:`identify`.
    namespace : str
        The axis to use, if a file contains several.
    inverse : bool
        Also validate the inverse.
    **conditions
        ``skip``, ``offset``, ``intersample`` and ``initial``, see :class:`.workflow.Conditions`.

    Returns
    -------
    Compared
        With ``predicted``, ``figures`` and ``warnings``.

    Raises
    ------
    ConfigurationError, ParameterError, IdentificationError, DataError, RecordingError
        The file, a choice or the data cannot be used; the message states what is allowed.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> found = hr.identify("loops.csv")  # doctest: +SKIP
    >>> hr.validate(found, "other.csv").figures["rmse_m"]  # doctest: +SKIP
    """
    reading = read_data(source, columns)
    given = parameters if isinstance(parameters, (str, os.PathLike)) else configuration_of(parameters)
    return Compared(**vars(workflow.validate(given, reading, namespace=namespace, inverse=inverse, **conditions)))


@checked
def metrics(source: Reported | ArrayRun, *, namespace: str | None = None) -> dict[str, Any]:
    """Return the figures of a run, an identification or a validation; :func:`report` also writes a page.

    Parameters
    ----------
    source : path-like, Recording, ArrayRun, Identified, Compared, sequence of path-like, or mapping
        A recording, or a result of :func:`simulate`, :func:`identify` or :func:`validate`. Several runs are compared: a
        sequence of files, or a mapping of names to runs.
    namespace : str, optional
        The axis to use, if a bag contains several.

    Returns
    -------
    dict
        Figures in SI units, by names that contain their unit: ``rms_error_m``, ``settling_time_s`` …; for an inchworm
        its moves and steps. For several runs, or for a stage: one such dictionary per run or axis, by name; a stage
        that follows a scan also has ``scan``, the errors in the plane (:func:`scan_run`). For many independent axes
        each figure is an array, shape (n,), with NaN for an axis that lacks the figure.

    Raises
    ------
    RecordingError
        The recording cannot be read or evaluated.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> hr.metrics(hr.simulate("kim2009", duration=0.1))["samples"]
    300
    >>> hr.metrics(hr.simulate("kim2009", axes=3, duration=0.1))["rms_error_m"].shape
    (3,)
    """
    if isinstance(source, ArrayRun):
        from hysteresis_ros.analysis.metrics import FIGURES, AxisSettings, compute_metrics, reference_delay

        each = []
        for number, axis in enumerate(source.parameters):
            limits, controller = axis.hysteresis_compensator.limits, axis.motion_controller
            late = reference_delay(controller.feedforward.preview, controller.learning.type)
            settings = AxisSettings(limits.minimum, limits.maximum, controller.model.preload.offset, late)
            each.append(compute_metrics(source.axis(number, describe=False), settings, parts=False))
        return {name: np.array([figures[name] for figures in each], dtype=float) for name, *_ in FIGURES}
    return report(source, namespace=namespace)


@checked
def report(
    source: Reported,
    path: str | os.PathLike[str] | None = None,
    *,
    title: str | None = None,
    namespace: str | None = None,
) -> dict[str, Any]:
    """Return the figures of a run, an identification or a validation, and write a page about it.

    Parameters
    ----------
    source : path-like, Recording, Identified, Compared, sequence of path-like, or mapping
        A recording, or a result of :func:`simulate`, :func:`identify` or :func:`validate`. Several runs are compared: a
        sequence of files, or a mapping of names to runs.
    path : path-like, optional
        Self-contained HTML file to write. Plots need Matplotlib and Jinja2 (``pip install
        "hysteresis_ros[report]"``).
    title : str, optional
        Heading of the page of a run; by default the name of the recording, or of all recordings.
    namespace : str, optional
        The axis to use, if a bag contains several.

    Returns
    -------
    dict
        Figures in SI units, by names that contain their unit: ``rms_error_m``, ``settling_time_s`` …; for an inchworm
        its moves and steps. For several runs, or for a stage: one such dictionary per run or axis, by name; a stage
        that follows a scan also has ``scan``, the errors in the plane (:func:`scan_run`).

    Raises
    ------
    RecordingError
        The recording cannot be read or evaluated, or the page cannot be written.
    HysteresisError
        Matplotlib or Jinja2 is not installed; the message gives the command that installs it.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> figures = hr.report(hr.simulate("kim2009", duration=0.1))
    >>> figures["samples"], figures["saturated_percent"]
    (300, 0.0)
    >>> both = hr.report({"fine": "a.npz", "coarse": "b.npz"}, "both.html")  # doctest: +SKIP
    >>> both["fine"]["rms_error_m"]  # doctest: +SKIP
    """
    if isinstance(source, workflow.Compared):
        if path is not None:
            from hysteresis_ros.analysis.identification_report import (
                write_identification_report,
                write_validation_report,
            )

            if isinstance(source, workflow.Identified):
                write_identification_report(path, source)
            else:
                write_validation_report(path, source)
        return source.figures
    if not isinstance(source, (str, os.PathLike, Recording)):
        from hysteresis_ros.analysis.side_by_side import labels_of, report_several

        listed = isinstance(source, Sequence) and all(isinstance(one, (str, os.PathLike)) for one in source)
        if not (listed or isinstance(source, Mapping)):
            raise HysteresisError(
                f"source is of type {type(source).__name__}: must be a run, a result of hr.identify or hr.validate, a "
                "file name, a list of file names, or a dictionary of runs such as {'fine': run, 'coarse': other}"
            )
        named = source if isinstance(source, Mapping) else labels_of(source)
        for name in named:
            if not isinstance(name, str):
                raise HysteresisError(f"source: the name of a run is {shortened(name)}: must be a text")
        return report_several({name: _recording(run, namespace) for name, run in named.items()}, path, title)[0]
    run = _recording(source, namespace)
    heading = title or ("run" if isinstance(source, Recording) else pathlib.Path(source).name)
    if run.axes:
        from hysteresis_ros.analysis.scan_report import plane_figures, plane_of, scan_figures, write_scan_report
        from hysteresis_ros.analysis.side_by_side import report_several

        axes, scanned = stage_axes_of(run), scan_run(run)
        if scanned is None:
            plane = plane_of(axes)
            found = report_several(axes, path, title, plane)[0]
            return found if plane is None else {"plane": plane_figures(plane), **found}
        if path is not None:
            write_scan_report(path, scanned, heading)
        return {"scan": scan_figures(scanned), **report_several(axes)[0]}
    from hysteresis_ros.analysis.side_by_side import report_of

    report = report_of(run)
    figures = report.figures(run)
    if path is not None:
        report.write(run, path, heading, figures)
    return figures


def scan_run(
    source: str | os.PathLike[str] | Recording, first: float | None = None, last: float = np.inf
) -> ScanRun | None:
    """Return a recorded scan of a stage, for :func:`~hysteresis_ros.analysis.scan_report.scan_figures`.

    A simulated run is also evaluated between its samples, against the exact undelayed path.

    Parameters
    ----------
    source : path-like or Recording
        The run of a stage, or a part of it. Between the samples only a simulated run from its first sample is known.
    first, last : float, optional
        Part of the run to evaluate [s]; by default all samples after the first period of the path, or after its first
        line if the run has fewer than two periods. Only samples in which all axes follow the scan are included, also
        after the scan was stopped and restarted.

    Returns
    -------
    ScanRun or None
        None if the run does not follow a scan.

    Raises
    ------
    RecordingError
        The part has no sample on a line.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> hr.scan_run(hr.simulate("xy_scanner", duration=0.01)) is None
    True
    """
    from hysteresis_ros.analysis.scan_report import NO_LINE, ScanRun, trigger_times
    from hysteresis_ros.errors import RecordingError

    run = _recording(source, None)
    found = _scanning_stage(run)
    if found is None:
        return None
    parameters, scan = found
    names, periods = parameters.scanning_axes, parameters.stage.scan.periods
    places = [parameters.names.index(name) for name in names]
    if run.is_simulated and run.time[0] == 0.0:  # a part of a run does not begin at rest
        time, displacement = displacements_between(parameters, run)
        sample = np.minimum(((time - time[0]) * parameters.sample_rate + 1e-6).astype(int), len(run) - 1)
        moment = time + _delays_of_path(run, names, np.arange(len(run)) / parameters.sample_rate, parameters)[sample]
        reference = scan.position(np.nan_to_num(moment)) + np.array([run[f"{name}/setpoint"][sample] for name in names])
    else:
        time, displacement = (
            run.time - run.time[0],
            np.array([run[f"{name}/displacement"] for name in parameters.names]),
        )
        moment = time + _delays_of_path(run, names, time, parameters)
        reference = np.array([run[f"{name}/reference"] for name in names])
    # the references do not include the preload offset, but the displacements do
    zeros = np.array([parameters.axes[place].motion_controller.model.preload.offset for place in places])
    displacement = displacement[places] - zeros[:, np.newaxis]
    there = _on_path(scan, periods, moment, None if first is None else 0.0)
    there &= (time >= (first or 0.0) - 1e-9) & (time <= last + 1e-9)
    if not np.any(there):
        raise RecordingError(NO_LINE)
    triggers = trigger_times((run.axis(name) for name in names), time[there], run.time[0])
    moments = None if np.array_equal(moment[there], time[there]) else moment[there]
    signals = reference[:, there], displacement[:, there]
    return ScanRun(scan, time[there], *signals, triggers, moments, names)


def stage_axes_of(run: Recording) -> dict[str, Recording]:
    """Return the axes of a stage; the errors of all of them count from the same instant on.

    Parameters
    ----------
    run : Recording
        The run of a stage.

    Returns
    -------
    dict of str to Recording
        The axes by name. If the stage follows a scan, they count from the instant from which :func:`scan_run` counts;
        otherwise from the instant at which the last axis begins its scan.
    """
    from hysteresis_ros.analysis.metrics import stage_axes

    found = _scanning_stage(run)
    if found is None:
        return stage_axes(run)
    parameters, scan = found
    time = run.time - run.time[0]
    moment = time + _delays_of_path(run, parameters.scanning_axes, time, parameters)
    counted = _on_path(scan, parameters.stage.scan.periods, moment)
    return stage_axes(run, float(run.time[np.argmax(counted)]) if np.any(counted) else None)


def _scanning_stage(run: Recording) -> tuple[StageParameters, Scan] | None:
    """Return the stage of a run, without its drivers, and the scan that it follows; None if it follows none."""
    configuration = configuration_of(run) if run.axes and run.configuration else None
    if configuration is None or configuration.stage is None:
        return None
    parameters = StageParameters.from_configuration(without_drivers(configuration, run.axes))
    return None if parameters.scan is None else (parameters, parameters.scan)


def _on_path(scan: Scan, periods: int, moment: np.ndarray, first: float | None = None) -> np.ndarray:
    """Return whether each sample counts: on the path of a scan, from the time ``first`` on the path on [s].

    The scan ends after ``periods`` periods; 0: never. By default ``first`` is the result of
    :func:`~hysteresis_ros.analysis.scan_report.judged_from`.

    Units: ``moment`` [s], the time on the path; NaN: not on the path.
    """
    from hysteresis_ros.analysis.scan_report import judged_from

    ends = periods * scan.period or np.inf
    there = (moment >= -1e-9) & (moment < ends - 1e-9)
    return there & (moment >= (judged_from(scan, moment[there]) if first is None else first) - 1e-9)


#: Time differences below this are rounding errors of the stamps [s].
ROUNDED = 1e-7


def _delays_of_path(run: Recording, names: Sequence[str], time: np.ndarray, parameters: StageParameters) -> np.ndarray:
    """Return, for each sample, the time on the path of a scan minus the time of the run [s].

    The difference is zero until the scan restarts or a sample is missing from the recording. It is NaN where the axes
    do not follow the scan together.
    """
    signals = [f"{name}/waveform_sample" for name in names]
    if not all(signal in run for signal in signals):
        return np.zeros(time.size)
    samples = np.array([run[signal] for signal in signals])
    together = np.all(samples == samples[0], axis=0) & (samples[0] >= 0.0)
    delays = samples[0] / parameters.sample_rate - time
    return np.where(together, np.where(np.abs(delays) < ROUNDED, 0.0, delays), np.nan)


@checked
def plot(source: str | os.PathLike[str] | Recording, kind: str = "traces", *, namespace: str | None = None) -> Any:
    """Draw a run; in a notebook ``%matplotlib inline`` shows the returned figure.

    Parameters
    ----------
    source : path-like or Recording
        A recording, or a result of :func:`simulate`.
    kind : str
        ``traces`` (reference, displacement and estimate over time), ``error``, ``voltage``, ``loops`` (before and after
        compensation), ``spectrum``, ``histogram`` …, as on the page of :func:`report`.
    namespace : str, optional
        The axis to use, if a bag contains several.

    Returns
    -------
    matplotlib.figure.Figure
        The figure; ``savefig(path)`` writes it.

    Raises
    ------
    HysteresisError
        The plot does not exist, the recording lacks its signals, or Matplotlib is not installed.

    Examples
    --------
    >>> import hysteresis_ros as hr
    >>> hr.plot(hr.simulate("kim2009", duration=0.1), "loops").savefig("loops.png")  # doctest: +SKIP
    """
    from hysteresis_ros.analysis.plots import chart_figure
    from hysteresis_ros.analysis.report import charts_of
    from hysteresis_ros.analysis.run_charts import judged

    run = _recording(source, namespace)
    if run.axes:
        names = " or ".join(f"namespace='{name}'" for name in run.axes)
        raise HysteresisError(f"the run has several axes, and a plot shows one: give {names}")
    charts = {chart.name: chart for chart in charts_of(judged(run))}
    if kind not in charts:
        there = ", ".join(charts)
        raise HysteresisError(f"kind = {kind!r}: this recording has the plots {there}{did_you_mean(kind, charts)}")
    return chart_figure(charts[kind])


def configuration_of(source: Source) -> Configuration:
    """Return the configuration that describes an axis.

    Parameters
    ----------
    source : str or path or Configuration or Identified or DesignedFile or Recording
        A file, the name of a shipped configuration, or an object that contains one.

    Returns
    -------
    Configuration
        The configuration of the axis.

    Raises
    ------
    ConfigurationError
        A recording does not contain the configuration of its axis, or a file is not a configuration.
    """
    if isinstance(source, Configuration):
        return source
    if isinstance(source, (workflow.Identified, DesignedFile)):
        return parse_configuration(source.text, f"the {type(source).__name__.lower()} axis")
    if isinstance(source, Recording):
        if not source.configuration:
            raise ConfigurationError("the recording has no configuration of its axis; give the parameter file")
        return parse_configuration(source.configuration, "the configuration in the recording")
    if not isinstance(source, (str, os.PathLike)):
        raise ConfigurationError(
            f"configuration = {shortened(source)}: must be a parameter file (.yaml), the name of a shipped one "
            "(hr.configurations()), a run, or a result of hr.load, hr.identify or hr.design"
        )
    return load_configuration(source)


def _recording(source: str | os.PathLike[str] | Recording, namespace: str | None) -> Recording:
    """Return a recording, read from its file if necessary; for a stage, return the named axis."""
    if isinstance(source, Recording):
        return source.axis(namespace) if namespace and source.axes else source
    if not isinstance(source, (str, os.PathLike)):
        kind = type(source).__name__
        raise HysteresisError(f"source is of type {kind}: must be a run or its file; hr.report evaluates other results")
    return load_run(source, namespace, further=True)
