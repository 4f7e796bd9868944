# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Fixtures of the tests of the nodes; their components are in nodes_support."""

from __future__ import annotations

import gc

import pytest
from nodes_support import InProcess, Observer, Processes

from hysteresis_ros.nodes.domain import Domain


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("nodes")


def unused_domain() -> Domain:
    """Claim a domain after a collection: nodes are part of reference cycles, and their participants use domains."""
    gc.collect()
    return Domain()


@pytest.fixture
def domain():
    with unused_domain() as claimed:
        yield claimed.number


@pytest.fixture(scope="module")
def domain_of_module():
    with unused_domain() as claimed:
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
