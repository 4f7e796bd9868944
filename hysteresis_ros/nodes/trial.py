"""How fast nodes that exchange messages are on this machine; imports no ROS itself."""

from __future__ import annotations

import os
import pathlib
import tempfile
from dataclasses import replace

from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.nodes.domain import Domain
from hysteresis_ros.nodes.launcher import Graph
from hysteresis_ros.recordings.files import load_run


def message_rate(parameters: AxisParameters, samples: int, composed: bool) -> float:
    """Return how many samples a second the nodes of an axis make in lockstep, recorded [Hz].

    They run in a ROS domain that nobody else uses.

    Parameters
    ----------
    parameters : AxisParameters
    samples : int
        Length of the run.
    composed : bool
        All nodes in one process, instead of one for each.

    Raises
    ------
    GraphError
        A node died.
    """
    axis = parameters.with_time_mode("lockstep")
    # a namespace of its own as well: another graph may enter the domain while this one runs
    plant = replace(axis.plant_simulator, samples=samples)
    axis = replace(axis, namespace=f"/doctor_{os.getpid()}", plant_simulator=plant)
    with tempfile.TemporaryDirectory(prefix="hysteresis_") as folder, Domain() as domain:
        options = {"composed": composed, "record": pathlib.Path(folder) / "bag"}
        with Graph([axis], **options, environment=domain.environment) as graph:
            graph.wait()
        return float(load_run(graph.bags[0]).metadata["timing"]["rate_hz"])
