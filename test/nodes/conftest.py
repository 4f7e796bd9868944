"""Fixtures of the tests of the nodes; what they are made of is in nodes_support."""

from __future__ import annotations

import pytest
from nodes_support import InProcess, Observer, Processes

from hysteresis_ros.nodes.domain import Domain


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("nodes")


@pytest.fixture
def domain():
    with Domain() as claimed:
        yield claimed.number


@pytest.fixture(scope="module")
def domain_of_module():
    with Domain() as claimed:
        yield claimed.number


@pytest.fixture
def processes(tmp_path, domain):
    made = Processes(tmp_path, domain)
    yield made
    made.close()


@pytest.fixture
def observer(domain):
    made = Observer(domain)
    yield made
    made.close()


@pytest.fixture
def inside(domain):
    made = InProcess(domain)
    yield made
    made.close()
