# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A benchmark of hysteresis models, from the package and from users, on public recordings and synthetic plants.

Start with ``manifest`` (the recordings, and their parts for fit and test) and ``models`` (the interface ``fit`` and
``predict``, the models of the package, and simple models for comparison). ``synthetic`` makes recordings of plants with
known parameters, ``judging`` fits and evaluates one model on one recording, and ``table`` prints all results.
"""
