"""Where recordings that were measured by others lie; they are no part of the project."""

from __future__ import annotations

import os
import pathlib

REPOSITORY = pathlib.Path(__file__).resolve().parents[2]
DATA = pathlib.Path(os.environ.get("HYSTERESIS_DATA", REPOSITORY.parent / "shared" / "data"))
