# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Evaluation of a run: figures of merit, charts, reports. Matplotlib and Jinja2 are imported only here, at first use.

Read first ``metrics`` (the figures) and ``parts`` (the parts of a run, each with its own figures), then ``run_charts``
and ``report``, which draw with ``plots`` and ``page``. ``inchworm`` and ``inchworm_report`` do the same for inchworm
motors.
"""
