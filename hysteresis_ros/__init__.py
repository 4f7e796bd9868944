# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Hysteretic piezo positioning on ROS 2, from a recording to a controlled axis.

record → identify → simulate → compensate → control → analyse, with the same numbers offline and in the running nodes:
every model, inverse, controller and observer is a block (:mod:`hysteresis_ros.models.block`) that both the offline
simulation and the ROS 2 nodes call. Only :mod:`hysteresis_ros.nodes` needs ROS.

For scripts and notebooks, ``import hysteresis_ros as hr`` gives ``hr.models``, ``hr.inverses``, ``hr.controllers``,
``hr.references`` and the functions of :mod:`hysteresis_ros.api`, :mod:`hysteresis_ros.designing`,
:mod:`hysteresis_ros.exchange` and :mod:`hysteresis_ros.laboratory.studies`. Each name is imported at its first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hysteresis_ros import models, references
    from hysteresis_ros.api import (
        ArrayRun,
        AxisArray,
        Columns,
        Compared,
        Configuration,
        HysteresisError,
        Identified,
        IdentifiedStage,
        IdentifiedStructure,
        Run,
        StageColumns,
        StageRun,
        StructureData,
        StructureEstimator,
        axis_array,
        configurations,
        identify,
        identify_structure,
        load,
        metrics,
        plot,
        report,
        scan_run,
        simulate,
        validate,
    )
    from hysteresis_ros.control import classes as controllers
    from hysteresis_ros.designing import (
        Design,
        DesignedLearning,
        Experiment,
        Response,
        Uncertainty,
        design,
        design_learning,
        frequency_response,
        mismatched,
    )
    from hysteresis_ros.exchange import from_control, to_control, to_scipy, with_dynamics
    from hysteresis_ros.laboratory.studies import Ranking, Reproduction, compare, reproduce
    from hysteresis_ros.laboratory.sweeps.plan import Levels, LogUniform, Normal, Uniform, Within
    from hysteresis_ros.loop.faults import Fault
    from hysteresis_ros.models import inverse_classes as inverses

#: Version of the package; setup.py reads it from here, and package.xml repeats it.
__version__ = "0.1.0"

__all__ = [
    "ArrayRun",
    "AxisArray",
    "Columns",
    "Compared",
    "Configuration",
    "Design",
    "DesignedLearning",
    "Experiment",
    "Fault",
    "HysteresisError",
    "Identified",
    "IdentifiedStage",
    "IdentifiedStructure",
    "Levels",
    "LogUniform",
    "Normal",
    "Ranking",
    "Reproduction",
    "Response",
    "Run",
    "StageColumns",
    "StageRun",
    "StructureData",
    "StructureEstimator",
    "Swept",
    "Uncertainty",
    "Uniform",
    "Within",
    "axis_array",
    "compare",
    "configurations",
    "controllers",
    "design",
    "design_learning",
    "frequency_response",
    "from_control",
    "identify",
    "identify_structure",
    "inverses",
    "load",
    "metrics",
    "mismatched",
    "models",
    "plot",
    "references",
    "report",
    "reproduce",
    "scan_run",
    "simulate",
    "sweep",
    "to_control",
    "to_scipy",
    "validate",
    "with_dynamics",
]

#: Public names of modules: name in this package → module.
_MODULES = {
    "models": "hysteresis_ros.models",
    "references": "hysteresis_ros.references",
    "inverses": "hysteresis_ros.models.inverse_classes",
    "controllers": "hysteresis_ros.control.classes",
}
#: Public names outside :mod:`hysteresis_ros.api`, and their modules.
_PLACES = {
    "Fault": "hysteresis_ros.loop.faults",
    **dict.fromkeys(("from_control", "to_control", "to_scipy", "with_dynamics"), "hysteresis_ros.exchange"),
    **dict.fromkeys(("Levels", "LogUniform", "Normal", "Uniform", "Within"), "hysteresis_ros.laboratory.sweeps.plan"),
    **dict.fromkeys(("Swept", "sweep"), "hysteresis_ros.laboratory.swept"),
    **dict.fromkeys(("Ranking", "Reproduction", "compare", "reproduce"), "hysteresis_ros.laboratory.studies"),
    **dict.fromkeys(
        ("Design", "DesignedLearning", "Experiment", "Response", "Uncertainty"), "hysteresis_ros.designing"
    ),
    **dict.fromkeys(("design", "design_learning", "frequency_response", "mismatched"), "hysteresis_ros.designing"),
}


def __getattr__(name: str) -> Any:
    """Return a public name, imported at its first use (PEP 562)."""
    import importlib

    if name in _MODULES:
        value: Any = importlib.import_module(_MODULES[name])
    elif name in __all__:
        value = getattr(importlib.import_module(_PLACES.get(name, "hysteresis_ros.api")), name)
    else:
        import difflib

        near = difflib.get_close_matches(name, __all__, n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])
