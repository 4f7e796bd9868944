"""What the identification procedures of the three papers give on simulated truth: the figures the documentation states.

Truths are never of the class that is fitted, but for paper B, where the parameters themselves have to come back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.identification.bouc_wen_static import (
    NAMES,
    PUBLISHED_GUESS,
    BoucWenIdentification,
    identify_bouc_wen_static,
)
from hysteresis_ros.identification.duhem import (
    PUBLISHED_ALPHA,
    DuhemIdentification,
    identify_duhem,
    identify_inverse_duhem,
)
from hysteresis_ros.identification.frequency_response import welch_response
from hysteresis_ros.identification.matrix_fraction import identify_matrix_fraction
from hysteresis_ros.identification.polynomial import PolynomialIdentification, identify_polynomial
from hysteresis_ros.identification.preload import PreloadIdentification, identify_preload, preload_of_offset
from hysteresis_ros.identification.reduction import dominant_second_order, mass_spring_damper
from hysteresis_ros.models.bouc_wen import BoucWenHysteresis, BoucWenParameters
from hysteresis_ros.models.duhem import DuhemHysteresis
from hysteresis_ros.models.linear import LinearDynamics, LinearParameters
from hysteresis_ros.models.polynomial import PolynomialHysteresis
from hysteresis_ros.models.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis, PrandtlIshlinskiiParameters

SAMPLE_TIME = 1e-3  # the models are rate independent
KIM_PEAKS = np.arange(6.0, 120.5, 6.0)
STIFFNESS = 0.41e6  # of the propulsion part [N/m], stated in the paper
PUBLISHED_BOUC_WEN = BoucWenParameters(d_e=0.206e-6, alpha=8.09e-8, beta=3.80e-3, gamma=-5.40e-3)


def triangles(peaks, samples: int = 250) -> np.ndarray:
    """Return triangles from 0 to each of ``peaks`` and back, ``samples`` samples a branch (2 Hz: 250 at 1 kHz)."""
    rise = np.arange(1, samples + 1) / samples
    return np.concatenate([[0.0], *(peak * np.concatenate([rise, 1.0 - rise]) for peak in peaks)])


def stack_truth(opening: float = 0.15, stroke: float = 12.45e-6, fading: float = 1.0) -> PrandtlIshlinskiiParameters:
    """Return a Prandtl-Ishlinskii stack of 40 plays for 0 … 120 V (assumption; not the class that is fitted).

    Parameters
    ----------
    opening : float
        Opening of the loop to 120 V, as a part of the stroke.
    stroke : float
        Displacement at 120 V [m].
    fading : float
        The density of plays falls as exp(-fading r/120 V); 0 would be Rayleigh's law, which polynomials hit exactly.
    """
    radii = 3.0 * np.arange(40)
    weights = np.exp(-fading * radii / 120.0)
    loop = triangles([120.0, 120.0], 400)

    def stack(elastic):
        weights[0] = elastic
        scaled = PrandtlIshlinskiiParameters(tuple(radii), tuple(weights))
        x = PrandtlIshlinskiiHysteresis(scaled, SAMPLE_TIME).simulate(loop)
        return np.max(x[400:801][::-1] - x[800:1201]) / x.max(), x.max()

    low, high = 1e-3, 1e3
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if stack(middle)[0] > opening else (low, middle)
    _, reached = stack(low)
    return PrandtlIshlinskiiParameters(tuple(radii), tuple(weights * (stroke / reached)))


@dataclass(frozen=True)
class PaperK:
    """Polynomial model of a Prandtl-Ishlinskii stack with noise; errors on a decreasing triangle it has not seen.

    Parameters
    ----------
    model : PolynomialIdentification
    stroke, maximum, rms : float
        Of the decreasing triangle: its range, largest and rms error [m]; the paper's largest error is 0.125 µm.
    preload_curve : PreloadIdentification
        W(L0) from noisy points 0 … 6 N.
    preload : float
        What a recording under 5.88 N gives [N].
    voltage, truth, predicted : ndarray, shape (N,)
        The decreasing triangle [V], the stack's displacement and the model's [m], at ``SAMPLE_TIME``.
    """

    model: PolynomialIdentification
    stroke: float
    maximum: float
    rms: float
    preload_curve: PreloadIdentification
    preload: float
    voltage: np.ndarray
    truth: np.ndarray
    predicted: np.ndarray


def paper_k(noise: float = 5e-9, seed: int = 0, **truth) -> PaperK:
    """Identify the polynomial model (K2) and the preload curve (K3) from simulated recordings.

    Parameters
    ----------
    noise : float
        Of the displacement [m rms].
    seed : int
        Of the noise.
    **truth
        Handed to :func:`stack_truth`.
    """
    random = np.random.default_rng(seed)
    stack = stack_truth(**truth)

    def measured(voltage, offset=0.0):
        x = PrandtlIshlinskiiHysteresis(stack, SAMPLE_TIME).simulate(voltage) + offset
        return x + noise * random.standard_normal(x.size)

    voltage = triangles(KIM_PEAKS)
    model = identify_polynomial(voltage, measured(voltage))
    decreasing = triangles(117.0 * np.linspace(1.0, 0.05, 20))
    truth_there = PrandtlIshlinskiiHysteresis(stack, SAMPLE_TIME).simulate(decreasing)
    predicted = PolynomialHysteresis(model.parameters, SAMPLE_TIME).simulate(decreasing)
    error = predicted - truth_there

    forces = np.linspace(0.0, 6.0, 25)
    points = -forces / STIFFNESS + noise * random.standard_normal(forces.size)
    curve = identify_preload(forces, points, in_use=5.88)
    loop = triangles([20.0, 20.0])
    offset = float(np.mean(measured(loop, -5.88 / STIFFNESS) - measured(loop)))
    preload = preload_of_offset(curve.parameters, offset)
    return PaperK(
        model=model,
        stroke=float(np.ptp(truth_there)),
        maximum=float(np.max(np.abs(error))),
        rms=float(np.sqrt(np.mean(error**2))),
        preload_curve=curve,
        preload=preload,
        voltage=decreasing,
        truth=truth_there,
        predicted=predicted,
    )


@dataclass(frozen=True)
class PaperB:
    """Bouc-Wen parameters from 400 noisy samples.

    Parameters
    ----------
    model : BoucWenIdentification
    errors : dict
        Relative error of each parameter.
    iterations : int
        Of the simplex (the paper's: 262).
    """

    model: BoucWenIdentification
    errors: dict[str, float]
    iterations: int


def paper_b(noise: float = 10e-9, seed: int = 0, peak: float = 150.0) -> PaperB:
    """Identify Bouc-Wen's parameters (B3) from one loading and unloading, from the paper's initial guess."""
    voltage = triangles([peak], 200)[1:]
    x = BoucWenHysteresis(PUBLISHED_BOUC_WEN, SAMPLE_TIME).simulate(voltage)
    x = x + noise * np.random.default_rng(seed).standard_normal(x.size)
    model = identify_bouc_wen_static(voltage, x, guess=PUBLISHED_GUESS)
    errors = {n: getattr(model.parameters, n) / getattr(PUBLISHED_BOUC_WEN, n) - 1.0 for n in NAMES}
    return PaperB(model, errors, model.search.runs[model.search.best].iterations)


def polymer_truth(plays: int = 40) -> PrandtlIshlinskiiParameters:
    """Return a modified Prandtl-Ishlinskii element for ±1 V (W7; assumption, the paper's numbers are lost)."""
    radii = np.arange(plays) / plays
    weights = np.exp(-1.5 * radii) / plays
    weights[0] = 0.6
    thresholds = np.concatenate([-np.linspace(0.05, 0.7, 12)[::-1], np.linspace(0.05, 0.7, 12)])
    zones = np.concatenate([np.full(12, 0.008), np.full(12, -0.013)])
    scale = 1e-3  # the tip of the polymer bends by about a millimetre
    return PrandtlIshlinskiiParameters(tuple(radii), tuple(scale * weights), tuple(scale * thresholds), tuple(zones))


@dataclass(frozen=True)
class PaperW:
    """Duhem model of a modified Prandtl-Ishlinskii element; errors in parts of the full range.

    Parameters
    ----------
    identified, published : DuhemIdentification
        With α from a decaying loop, and with the paper's α = 80.
    inverse : DuhemIdentification
        W4.
    opening : float
        Of the loop.
    compensated : float
        Largest error of the truth behind the inverse along the major loop.
    decaying, decaying_published : float
        Rms error on decaying loops that were not used: with the identified α and with the paper's.
    """

    identified: DuhemIdentification
    published: DuhemIdentification
    inverse: DuhemIdentification
    opening: float
    compensated: float
    decaying: float
    decaying_published: float


def paper_w(shape: str = "network", size: int | None = None, seed: int = 0) -> PaperW:
    """Identify the Duhem model, its inverse and α (W3, W4, W7) from sines and one decaying loop."""
    truth = polymer_truth()

    def passed(voltage):
        return PrandtlIshlinskiiHysteresis(truth, SAMPLE_TIME).simulate(voltage)

    cycle = np.sin(2.0 * np.pi * np.arange(1000) / 1000.0)
    major = np.tile(cycle, 3)
    decaying = np.concatenate([cycle, np.tile(cycle, 6) * np.linspace(1.0, 0.02, 6000)])
    unseen = np.concatenate([cycle, np.tile(cycle, 10) * np.exp(-np.arange(10000) / 4000.0)])
    arguments = dict(minor=(decaying, passed(decaying)), shape=shape, size=size, seed=seed)
    identified = identify_duhem(major, passed(major), **arguments)
    published = identify_duhem(major, passed(major), alpha=PUBLISHED_ALPHA, **arguments)
    inverse = identify_inverse_duhem(major, passed(major), **arguments)

    y = passed(major)
    full = float(np.ptp(y))
    wanted = y[1000:]
    block = DuhemHysteresis(inverse.parameters, SAMPLE_TIME)
    drive = block.simulate(y)
    reached = passed(drive)[1000:]

    def misfit(result):
        after = slice(250, None)  # the first quarter cycle comes from rest
        error = DuhemHysteresis(result.parameters, SAMPLE_TIME).simulate(unseen) - passed(unseen)
        return float(np.sqrt(np.mean(error[after] ** 2))) / full

    return PaperW(
        identified=identified,
        published=published,
        inverse=inverse,
        opening=identified.loop.opening,
        compensated=float(np.max(np.abs(reached - wanted))) / full,
        decaying=misfit(identified),
        decaying_published=misfit(published),
    )


#: Numerator and denominator of G4 (B2), and the m, b, K that the paper reads off G2.
PUBLISHED_G4 = ((3400.0, 62060.0), (1.0, 572.5, 10120.0, 61670.0, 539200.0))
PUBLISHED_MASS_SPRING_DAMPER = {"m": 0.1348, "b": 0.4313, "K": 8.6957}


def paper_k_dynamics(noise: float = 0.02, samples: int = 60000, seed: int = 0) -> tuple[int, float, float]:
    """Identify the stack's structure from a noisy recording by the paper's method (K4).

    Parameters
    ----------
    noise : float
        Standard deviation of the sensor's noise, as a part of the signal's.
    samples : int
        Length of the recording at 3 kHz; the input is white.
    seed : int
        Of input and noise.

    Returns
    -------
    order : int
        As suggested.
    frequency : float
        Of the first pole pair [Hz].
    damping : float
        Of the first pole pair.
    """
    values = load_configuration("kim2009").node("plant_simulator")
    rate = values["sample_rate"]
    structure = {name: tuple(values[f"dynamics.{name}"]) for name in "ABC"}
    random = np.random.default_rng(seed)
    u = random.standard_normal(samples)
    y = LinearDynamics(LinearParameters(**structure, output_scale=1e-6), 1.0 / rate).simulate(u)
    y += noise * y.std() * random.standard_normal(samples)
    # a block answers at the end of its sample: u[k] shows in y[k] and not in the sample after
    response = welch_response(u[1:], y[:-1], 1.0 / rate, segment=8192).band(135.0, 1135.0)
    fit = identify_matrix_fraction(response)
    mode = fit.model.modes[0]
    return fit.suggested_order, mode.frequency, mode.damping


def paper_b_reduction() -> dict[str, float]:
    """Return by how much m, b and K of the reduced G4 differ from the paper's (B2), as parts of the paper's."""
    reduced = dominant_second_order(*PUBLISHED_G4)
    found = mass_spring_damper(reduced.numerator, reduced.denominator)
    values = {"m": found.mass, "b": found.damping, "K": found.stiffness}
    return {name: value / PUBLISHED_MASS_SPRING_DAMPER[name] - 1.0 for name, value in values.items()}


def main() -> None:
    """Print all figures."""
    order, frequency, damping = paper_k_dynamics()
    print(f"paper K: order {order} suggested, first pole pair {frequency:.2f} Hz, damping {damping:.5f}")
    parts = ", ".join(f"{name} {100.0 * value:+.2f} %" for name, value in paper_b_reduction().items())
    print(f"paper B: G4 reduced to second order, {parts}")
    k, b, w = paper_k(), paper_b(), paper_w()
    print(
        f"paper K: largest error {k.maximum * 1e6:.3f} µm (rms {k.rms * 1e6:.3f}) of {k.stroke * 1e6:.2f} µm on a "
        f"decreasing triangle; preload {k.preload:.3f} N, stiffness {k.preload_curve.stiffness * 1e-6:.4f} N/µm"
    )
    errors = ", ".join(f"{name} {100.0 * value:+.2f} %" for name, value in b.errors.items())
    print(f"paper B: {errors}; {b.iterations} iterations, converged {b.model.converged}")
    print(
        f"paper W: opening {100.0 * w.opening:.1f} %; major loop rms {w.identified.rms:.1e}, largest "
        f"{w.identified.maximum:.1e} of full range; behind the inverse {w.compensated:.1e}; alpha "
        f"{w.identified.alpha:.2f}: {100.0 * w.decaying:.2f} % on decaying loops, alpha 80: "
        f"{100.0 * w.decaying_published:.2f} % ({w.decaying_published / w.decaying:.1f} times)"
    )


if __name__ == "__main__":
    main()
