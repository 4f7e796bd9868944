# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Fuzz one reader guided by coverage: ``python test/fuzzing/guided.py "text tables" -max_total_time=60``.

Atheris generates the inputs from the valid ones; it is not a dependency of the package (``pip install atheris``).
Further arguments are those of libFuzzer. Readers that call compiled kernels (devices, nodes) cannot be tested in this
way, because Numba does not compile code that Atheris has changed.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]


def main() -> int:
    """Fuzz until libFuzzer ends, which also ends the process."""
    try:
        import atheris
    except ImportError:
        print("guided.py: needs atheris, which is not installed: pip install atheris", file=sys.stderr)
        return 2
    with atheris.instrument_imports(include=["hysteresis_ros"]):
        from hysteresis_ros import configuration, files, units  # noqa: F401
        from hysteresis_ros.identification import frequency_response, reading  # noqa: F401
        from hysteresis_ros.recordings import align, foreign_tables  # noqa: F401
        from hysteresis_ros.recordings import files as recorded_files  # noqa: F401
        from hysteresis_ros.references.waveforms import file  # noqa: F401
    from targets import TARGETS

    if not sys.argv[1:] or sys.argv[1] not in TARGETS:
        print(f"guided.py: give one of the readers: {', '.join(TARGETS)}", file=sys.stderr)
        return 2
    target, folder, corpus = TARGETS[sys.argv[1]], Path(tempfile.mkdtemp()), Path(tempfile.mkdtemp())
    for number, seed in enumerate(target.seeds()):
        (corpus / str(number)).write_bytes(seed)

    def read(data: bytes) -> None:
        try:
            target.read(data, folder)
        except target.refusals:
            return

    warnings.simplefilter("ignore")
    limits = ["-timeout=5", "-rss_limit_mb=2048", "-max_len=4096"]
    atheris.Setup([sys.argv[0], *limits, *sys.argv[2:], str(corpus)], read)
    atheris.Fuzz()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
