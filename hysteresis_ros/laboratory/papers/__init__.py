# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Repetition of published experiments, one folder or module per paper: each claim is compared with its reproduction.

Start with ``claims`` and ``runs``, then read ``reproduction`` of a paper; its ``axis`` contains the published values.
``fleming2010`` is a single module.
"""

#: Modules by the papers' names, each with ``reproduce()`` and ``figures(found)``.
EXPERIMENTS = {
    "kim2009": "hysteresis_ros.laboratory.papers.kim2009.reproduction",
    "auwal2017": "hysteresis_ros.laboratory.papers.auwal2017.reproduction",
    "wang2014": "hysteresis_ros.laboratory.papers.wang2014.reproduction",
    "fleming2010": "hysteresis_ros.laboratory.papers.fleming2010",
}
