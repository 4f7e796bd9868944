"""What all tests share: how properties are tried, and how the tests are spread over workers (pytest-xdist)."""

from __future__ import annotations

import pytest
from hypothesis import settings

# Properties are not timed: the first example of a test may compile kernels.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

#: Tests that start graphs of nodes: one after the other in one worker, since they need the time they have.
GRAPHS = ("test/nodes/", "test/cli/test_excite_command.py")


def group_of(nodeid: str) -> str:
    """Return with what a test shares its worker: the tests of its file, or all that start graphs."""
    return "graphs" if nodeid.startswith(GRAPHS) else nodeid.split("::", 1)[0]


def pytest_collection_modifyitems(config, items):
    """Let a worker begin with the graphs, which take longest; without workers the order stays."""
    if hasattr(config, "workerinput"):
        items.sort(key=lambda item: group_of(item.nodeid) != "graphs")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Hand out groups of tests."""
    from xdist.scheduler import LoadScopeScheduling

    class Groups(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return group_of(nodeid)

    return Groups(config, log)
