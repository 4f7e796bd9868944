"""How fast nodes that exchange messages are on this machine; imports no ROS itself."""

from __future__ import annotations

import contextlib
import os
import pathlib
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from hysteresis_ros.loop.axis_parameters import AxisParameters
from hysteresis_ros.nodes.domain import Domain
from hysteresis_ros.nodes.launcher import Graph
from hysteresis_ros.recordings.bag_reader import read_bag
from hysteresis_ros.recordings.files import load_run


@dataclass(frozen=True)
class Answers:
    """How soon the nodes of an axis answer a measurement in real time.

    Parameters
    ----------
    rate : float
        Of the samples [Hz].
    samples, late : int
        Samples, and how many of their voltages came too late.
    p50, p99, max : float
        Time from a measurement to its voltage that half, 99 % and all of the samples do not exceed [s], as the recorder
        hears both.
    """

    rate: float
    samples: int
    late: int
    p50: float
    p99: float
    max: float


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
    with _recorded(parameters.with_time_mode("lockstep"), samples, composed) as bag:
        return float(load_run(bag).metadata["timing"]["rate_hz"])


def answers(parameters: AxisParameters, samples: int, composed: bool) -> Answers:
    """Let the nodes of an axis run in real time, recorded, and return how soon they answer.

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
    with _recorded(parameters.with_time_mode("realtime"), samples, composed) as path:
        bag = read_bag(path)
        late = int(load_run(path).metadata["late_commands"])
    measured, voltage = (
        next(topic for name, topic in bag.topics.items() if name.endswith(ending)).received()
        for ending in ("/joint_states", "/voltage")
    )
    # a voltage answers the last measurement before it
    asked = np.searchsorted(measured, voltage, side="right") - 1
    took = 1e-9 * (voltage - measured[np.maximum(asked, 0)])[asked >= 0]
    p50, p99, longest = np.quantile(took, [0.5, 0.99, 1.0]) if took.size else (np.nan,) * 3
    rate = parameters.plant_simulator.sample_rate
    return Answers(rate, measured.size, late, float(p50), float(p99), float(longest))


@contextlib.contextmanager
def _recorded(axis: AxisParameters, samples: int, composed: bool) -> Iterator[pathlib.Path]:
    """Run an axis and yield its bag, which is removed afterwards."""
    # a namespace of its own as well: another graph may enter the domain while this one runs
    plant = replace(axis.plant_simulator, samples=samples, late_limit=-1)
    axis = replace(axis, namespace=f"/doctor_{os.getpid()}", plant_simulator=plant)
    with tempfile.TemporaryDirectory(prefix="hysteresis_") as folder, Domain() as domain:
        options = {"composed": composed, "record": pathlib.Path(folder) / "bag"}
        with Graph([axis], **options, environment=domain.environment) as graph:
            graph.wait()
        yield graph.bags[0]
