# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The command ``hysteresis``: thin subcommands that call the rest of the package.

Module ``entry`` starts the command. ``main`` contains the table of subcommands and imports a subcommand only when it is
called. The subcommands share ``options`` and ``progress``; ``recording`` contains those that read a recording (report,
verify, export, repair). Subcommands of the laboratory are in :mod:`hysteresis_ros.laboratory.commands`.
"""
