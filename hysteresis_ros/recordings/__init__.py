# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Recordings: bags, CSV and NPZ, all read into and written from one dataset type (time, named signals, units).

Read ``dataset`` and ``files`` first. ``bag_reader`` and ``align`` read a bag; ``bag_writer`` and ``run_bag`` write one.
``foreign_tables`` reads tables of other programs, ``repair`` repairs bags that were cut off.
"""

from hysteresis_ros.recordings.dataset import Recording
from hysteresis_ros.recordings.files import load_run, save_run
from hysteresis_ros.signals import COLUMNS

__all__ = ["COLUMNS", "Recording", "load_run", "save_run"]
