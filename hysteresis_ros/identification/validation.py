# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Validation of any model: error of the prediction, whiteness of the residual, uncertainty of the parameters.

References
----------
.. [1] Ljung, System Identification, 1999, sections 9.2 (covariance), 16.4 (FPE) and 16.6 (residual tests).
.. [2] Ljung & Box, Biometrika 65, 1978 (portmanteau test).
.. [3] Auwal et al., figure 5 (residual tests at 99.9 %).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from hysteresis_ros.identification.data import DataError, finite_array, refuse_short

#: Lags of the correlations [samples]; probability that the correlation at one lag is within its bounds (as in paper B).
LAGS = 25
CONFIDENCE = 0.999


@dataclass(frozen=True, eq=False)
class CorrelationTest:
    """A correlation of the residual, with bounds for an ideal residual."""

    lags: np.ndarray  #: shape (L,) [samples]; positive: the input precedes the residual.
    correlation: np.ndarray  #: shape (L,); Normalised, -1 … 1.
    bound: float  #: Half width of the confidence interval at each single lag.
    confidence: float  #: Probability of the confidence interval.
    outside: int  #: Number of tested lags outside the interval (lag 0 of an autocorrelation is not tested).
    largest: float  #: Largest absolute correlation of the lags tested.
    #: Half width of the interval that contains the correlations at all tested lags with the probability ``confidence``
    #: (Bonferroni).
    joint_bound: float
    #: Probability that chance makes the joint statistic of all lags at least this large (Ljung-Box); NaN if not
    #: computed.
    probability: float

    @property
    def passed(self) -> bool:
        """Whether all lags are within the joint bound; a false rejection has the probability 1 - confidence."""
        return self.largest <= self.joint_bound


def _correlation_test(lags, correlation, tested, deviation, confidence, probability=float("nan")):
    """Return the test of the lags ``tested`` (a slice); ``deviation``: standard deviation for independent signals."""
    size = np.abs(correlation[tested])
    bound = scipy.stats.norm.isf(0.5 * (1.0 - confidence)) * deviation
    joint = scipy.stats.norm.isf(0.5 * (1.0 - confidence) / max(size.size, 1)) * deviation
    outside, largest = int(np.count_nonzero(size > bound)), float(np.max(size, initial=0.0))
    return CorrelationTest(lags, correlation, float(bound), confidence, outside, largest, float(joint), probability)


@dataclass(frozen=True, eq=False)
class Validation:
    """Comparison of a prediction with a measurement."""

    samples: int  #: Number of compared samples.
    skipped: int  #: Number of omitted samples at the beginning.
    offset: float  #: Constant that was added to the prediction, in its unit; 0 if the offset was fixed.
    rmse: float  #: Root mean square error, in the unit.
    maximum_error: float  #: Largest absolute error, in the unit.
    stroke: float  #: Peak-to-peak measurement, in the unit.
    fit_percent: float  #: 100 (1 - ‖e‖/‖y - mean y‖) [%].
    mse: float  #: Mean square error, in the unit squared.
    fpe: float  #: Akaike's final prediction error: mse (1 + d/N)/(1 - d/N), in the unit squared.
    autocorrelation: CorrelationTest  #: Autocorrelation of the residual.
    cross_correlation: CorrelationTest | None  #: Cross-correlation of input and residual; None without an input.
    unit: str  #: SI unit of the measurement.
    residual: np.ndarray  #: shape (samples,); Measurement minus prediction, in the unit.
    warnings: tuple[str, ...]  #: Sentences if the residual is not white, or is correlated with the input.

    @property
    def rmse_percent_of_stroke(self) -> float:
        """100 rmse/stroke [%]."""
        return 100.0 * self.rmse / self.stroke

    def to_dict(self) -> dict:
        """Return the figures for JSON, with units in their names, e.g. ``rmse_m``."""
        unit = self.unit
        figures = {
            "samples": self.samples,
            "skipped": self.skipped,
            f"offset_{unit}": self.offset,
            f"rmse_{unit}": self.rmse,
            "rmse_percent_of_stroke": self.rmse_percent_of_stroke,
            f"maximum_error_{unit}": self.maximum_error,
            f"stroke_{unit}": self.stroke,
            "fit_percent": self.fit_percent,
            f"mse_{unit}2": self.mse,
            f"fpe_{unit}2": self.fpe,
            "residual_white": self.autocorrelation.passed,
            "confidence": self.autocorrelation.confidence,
        }
        if self.cross_correlation is not None:
            figures["residual_independent_of_input"] = self.cross_correlation.passed
        return {**figures, "warnings": list(self.warnings)}


def validate(
    measured,
    predicted,
    input=None,
    unit: str = "m",
    parameters: int = 0,
    skip: int = 0,
    free_offset: bool = False,
) -> Validation:
    """Compare a prediction with a measurement."""
    if not unit:
        raise DataError("unit", "unit is empty: figures need a unit; give m, V …")
    y, p = finite_array("measured", measured), finite_array("predicted", predicted)
    if y.shape != p.shape or y.ndim != 1:
        raise DataError("shape", f"measured {y.shape} and predicted {p.shape} must both be of one shape (N,)")
    if not 0 <= skip < len(y):
        raise DataError("range", f"skip = {skip}: must be in 0 … {len(y) - 1}")
    refuse_short(len(y) - skip, max(4, parameters + 2), f"a validation with skip = {skip}, parameters = {parameters}")
    y, p = y[skip:], p[skip:]
    if np.ptp(y) == 0.0:
        raise DataError("constant", f"the measurement is constant ({y[0]:.6g} {unit}) in the compared samples")
    offset = float(np.mean(y - p)) if free_offset else 0.0
    residual = y - p - offset
    mse = float(np.mean(residual**2))
    lags = min(LAGS, (len(y) - 1) // 2)
    auto, cross = residual_autocorrelation(residual, lags), None
    if input is not None:
        u = finite_array("input", input)
        if u.shape != np.shape(measured):
            raise DataError("shape", f"the input has shape {u.shape} and the measurement {np.shape(measured)}")
        cross = input_cross_correlation(u[skip:], residual, lags)
    return Validation(
        samples=len(y),
        skipped=skip,
        offset=offset,
        rmse=float(np.sqrt(mse)),
        maximum_error=float(np.max(np.abs(residual))),
        stroke=float(np.ptp(y)),
        fit_percent=fit_percent(y, p + offset),
        mse=mse,
        fpe=final_prediction_error(mse, len(y), parameters),
        autocorrelation=auto,
        cross_correlation=cross,
        unit=unit,
        residual=residual,
        warnings=tuple(_test_warnings(auto, cross, lags)),
    )


def _test_warnings(auto: CorrelationTest, cross: CorrelationTest | None, lags: int):
    """Yield a warning for each failed test of the residual."""
    percent = f"{100 * auto.confidence:g} %"
    if not auto.passed:
        yield f"the residual is not white: {auto.outside} of {lags} lags outside the {percent} bounds"
    if cross is not None and not cross.passed:
        yield f"the residual depends on the input: {cross.outside} lags outside the {percent} bounds"


def fit_percent(measured, predicted) -> float:
    """Return 100 (1 - ‖y - ŷ‖/‖y - mean y‖) [%]; 100 is perfect, 0 is no better than the mean of y."""
    y, p = np.asarray(measured, dtype=float), np.asarray(predicted, dtype=float)
    return float(100.0 * (1.0 - np.linalg.norm(y - p) / np.linalg.norm(y - y.mean())))


def final_prediction_error(mse: float, samples: int, parameters: int) -> float:
    """Return Akaike's FPE = mse (1 + d/N)/(1 - d/N), in the unit of ``mse``."""
    share = parameters / samples
    return float(mse * (1.0 + share) / (1.0 - share))


def residual_autocorrelation(residual, lags: int = LAGS, confidence: float = CONFIDENCE) -> CorrelationTest:
    """Return the autocorrelation of a residual at the lags 0 … ``lags``; for a white residual it is within ±z/√N.

    Units: ``lags`` [samples].
    """
    _check_confidence(confidence)
    e = np.asarray(residual, dtype=float)
    e = e - e.mean()
    N = len(e)
    refuse_short(N, lags + 2, f"an autocorrelation over {lags} lags")
    power = float(e @ e)
    correlation = np.zeros(lags + 1)
    correlation[0] = 1.0
    if power > 0.0:
        correlation = scipy.signal.correlate(e, e, method="auto")[N - 1 : N + lags] / power
        correlation[0] = 1.0
    later = np.arange(1, lags + 1)
    portmanteau = N * (N + 2) * np.sum(correlation[1:] ** 2 / (N - later))
    probability = float(scipy.stats.chi2.sf(portmanteau, lags)) if lags else float("nan")
    return _correlation_test(np.arange(lags + 1), correlation, slice(1, None), N**-0.5, confidence, probability)


def input_cross_correlation(u, residual, lags: int = LAGS, confidence: float = CONFIDENCE) -> CorrelationTest:
    """Return the correlation of earlier and later inputs with a residual at the lags -``lags`` … ``lags``.

    For independent signals the variance of the correlation is Σ r_e(τ) r_u(τ)/N with the autocorrelations r_e and r_u,
    so coloured signals have wider bounds. Correlation at negative lags indicates feedback from the output to the input.

    Units: ``lags`` [samples].
    """
    _check_confidence(confidence)
    e, u = np.asarray(residual, dtype=float), np.asarray(u, dtype=float)
    e, u = e - e.mean(), u - u.mean()
    N = len(e)
    refuse_short(N, lags + 2, f"a cross-correlation over {lags} lags")
    size = np.sqrt((e @ e) * (u @ u))
    every = np.arange(-lags, lags + 1)
    if size == 0.0:
        return _correlation_test(every, np.zeros(every.size), slice(None), 0.0, confidence)
    correlation = scipy.signal.correlate(e, u, method="auto")[N - 1 - lags : N + lags] / size
    # summed only over the significant lags, because the noise of the autocorrelations would accumulate over all N lags
    reach = min(N - 1, max(4 * lags, int(10 * np.sqrt(N))))
    r_e, r_u = (scipy.signal.correlate(x, x, method="auto")[N - 1 : N + reach] / (x @ x) for x in (e, u))
    spread = max(1.0 + 2.0 * float(np.sum(r_e[1:] * r_u[1:])), 1.0 / N)
    return _correlation_test(every, correlation, slice(None), np.sqrt(spread / N), confidence)


def parameter_covariance(
    jacobian, residual, others: int = 0, *, truncated: float | None = None, correlated: bool = False
) -> np.ndarray:
    """Return the covariance σ² (JᵀJ)⁻¹ of fitted parameters, shape (d, d).

    ``others`` is the number of fitted parameters without a column, such as a constant that was removed from all
    columns. Residuals are assumed white; with ``correlated``, correlated residuals count as fewer samples. Undetermined
    parameters raise DataError; with ``truncated``, directions with a singular value below this fraction of the largest
    one have no variance instead.
    """
    J, e = np.asarray(jacobian, dtype=float), np.asarray(residual, dtype=float)
    N, d = J.shape
    refuse_short(N, d + others + 1, f"the covariance of {d} parameters")
    length = np.linalg.norm(J, axis=0)
    if np.any(length == 0.0):
        if truncated is None:
            raise DataError("rank", f"parameter {int(np.argmin(length)) + 1} of {d} has no influence on the prediction")
        length[length == 0.0] = 1.0
    _, values, Vt = np.linalg.svd(J / length, full_matrices=False)
    known = values > (truncated or 1e-12) * values[0]
    if truncated is None and not known.all():
        raise DataError("rank", f"the data does not determine all {d} parameters")
    root = Vt[known].T / values[known] / length[:, None]
    grown = 1.0
    if correlated:
        e = e - e.mean()
        grown = inflation(e)
    return grown * float(e @ e) / (N - d - others) * root @ root.T


def inflation(residual) -> float:
    """Return the factor by which the correlation of a residual, shape (N,), increases the variance of its mean."""
    e = np.asarray(residual, dtype=float)
    e, N = e - e.mean(), len(e)
    correlation = np.fft.irfft(np.abs(np.fft.rfft(e, 2 * N)) ** 2)[: N // 4]
    below = np.flatnonzero(correlation < 0.05 * correlation[0])
    reach = int(below[0]) if below.size else N // 4
    return 1.0 + 2.0 * float(np.sum(correlation[1:reach])) / float(correlation[0] or 1.0)


def covariance_or_infinite(jacobian, residual, others: int = 0) -> np.ndarray:
    """Return :func:`parameter_covariance`; all entries are infinite if the data does not determine every parameter."""
    try:
        return parameter_covariance(jacobian, residual, others)
    except DataError:
        return np.full((np.shape(jacobian)[1],) * 2, np.inf)


def _check_confidence(confidence):
    if not 0.0 < confidence < 1.0:
        raise DataError("confidence", f"confidence = {confidence}: must be between 0 and 1, such as 0.999")
