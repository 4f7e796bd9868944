# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Reference for compiled kernels: the same computation in a process without Numba's machine code."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np


def interpreted(module: str, expression: str, folder) -> np.ndarray:
    """Return the value of ``expression`` in the namespace of a support module, with every kernel interpreted."""
    path = folder / "interpreted.npy"
    script = f"import sys\nsys.path[:0] = {sys.path!r}\nimport numpy\nfrom {module} import *\n"
    script += f"numpy.save({str(path)!r}, {expression})\n"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, "-c", script], check=True, env=environment, timeout=120)
    return np.load(path)
