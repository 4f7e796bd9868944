# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Results of the three papers' identification procedures on simulated plants, as quoted in the documentation.

The simulated plant is of another class than the fitted model, except for paper B, whose procedure must recover the
parameters of the plant.
"""

from __future__ import annotations

from hysteresis_ros.laboratory.papers.auwal2017.model import paper_b, paper_b_reduction
from hysteresis_ros.laboratory.papers.kim2009.identification import paper_k, paper_k_dynamics
from hysteresis_ros.laboratory.papers.wang2014.identification import paper_w


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
        f"paper W: loop width {100.0 * w.opening:.1f} %; major loop rms {w.identified.rms:.1e}, largest "
        f"{w.identified.maximum:.1e} of full range; with the inverse {w.compensated:.1e}; alpha "
        f"{w.identified.alpha:.2f}: {100.0 * w.decaying:.2f} % on decaying loops, alpha 80: "
        f"{100.0 * w.decaying_published:.2f} % ({w.decaying_published / w.decaying:.1f} times)"
    )


if __name__ == "__main__":
    main()
