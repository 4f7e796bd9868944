"""The choice of a hysteresis model by name, for actuators, compensators and their YAML."""

from __future__ import annotations

from dataclasses import dataclass

from hysteresis_ros.block import Block
from hysteresis_ros.errors import ParameterError, Problem
from hysteresis_ros.models.bouc_wen import BoucWenHysteresis, BoucWenParameters
from hysteresis_ros.models.bouc_wen_mechanical import BoucWenMechanicalParameters, BoucWenOscillator
from hysteresis_ros.models.duhem import DuhemHysteresis, DuhemParameters
from hysteresis_ros.models.polynomial import PolynomialHysteresis, PolynomialParameters
from hysteresis_ros.models.prandtl_ishlinskii import PrandtlIshlinskiiHysteresis, PrandtlIshlinskiiParameters
from hysteresis_ros.models.preisach import PreisachHysteresis, PreisachParameters
from hysteresis_ros.models.proportional import ProportionalHysteresis, ProportionalParameters
from hysteresis_ros.models.rate_independent import require_structure
from hysteresis_ros.parameters import Parameters, group, parameter

#: The block of each type.
HYSTERESIS_BLOCKS = {
    "proportional": ProportionalHysteresis,
    "polynomial": PolynomialHysteresis,
    "bouc_wen": BoucWenHysteresis,
    "duhem": DuhemHysteresis,
    "prandtl_ishlinskii": PrandtlIshlinskiiHysteresis,
    "preisach": PreisachHysteresis,
    "bouc_wen_mechanical": BoucWenOscillator,
}


@dataclass(frozen=True)
class HysteresisParameters(Parameters):
    """Type of the hysteresis model and the parameters of each."""

    type: str = parameter(description="hysteresis model", choices=tuple(HYSTERESIS_BLOCKS), read_only=True)
    proportional: ProportionalParameters = group(ProportionalParameters, variant_of="type")
    polynomial: PolynomialParameters = group(PolynomialParameters, variant_of="type")
    bouc_wen: BoucWenParameters = group(BoucWenParameters, variant_of="type")
    duhem: DuhemParameters = group(DuhemParameters, variant_of="type")
    prandtl_ishlinskii: PrandtlIshlinskiiParameters = group(PrandtlIshlinskiiParameters, variant_of="type")
    preisach: PreisachParameters = group(PreisachParameters, variant_of="type")
    bouc_wen_mechanical: BoucWenMechanicalParameters = group(BoucWenMechanicalParameters, variant_of="type")

    @property
    def chosen(self) -> Parameters:
        """Parameters of the chosen model."""
        return getattr(self, self.type)

    def require_same(self, present: HysteresisParameters) -> None:
        """Raise ParameterError when type or sizes are not the ``present`` ones: they cannot change while running."""
        if self.type != present.type:
            raise ParameterError(
                [Problem("hysteresis.type", self.type, f"is fixed while running: keep {present.type}")]
            )
        require_structure(present.chosen, self.chosen)


def hysteresis_block(parameters: HysteresisParameters, sample_time: float) -> Block:
    """Return the block of the chosen model.

    It has, beside what every block has, ``gain`` [m/V], ``inverse`` (closed-form inverse or None) and ``rebase()``.

    Raises
    ------
    ParameterError
        The type or the parameters of the chosen model are wrong.
    """
    parameters = parameters.validated()
    return HYSTERESIS_BLOCKS[parameters.type](parameters.chosen, sample_time)
