# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A comparison as scripts get it: printed as its tables, saved as the best configuration or as a page."""

from __future__ import annotations

import os
import pathlib

from hysteresis_ros.comparison.outcome import Comparison
from hysteresis_ros.comparison.table import best_text, format_comparison, write_page
from hysteresis_ros.errors import ConfigurationError
from hysteresis_ros.identification.parameter_file import write_file


class Ranking(Comparison):  # numpydoc ignore=PR02
    """Controllers and compensators in order; ``print`` shows the tables of ``hysteresis compare``.

    Parameters
    ----------
    conditions : Conditions
        What every candidate had to live with.
    around, others : Table or None
        Of plants around the configured one, and of plants of other classes; None where none were drawn. Each has
        ``rows``, the best first.
    configuration : Configuration
        What the first is about.
    """

    def __str__(self) -> str:
        return format_comparison(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the configuration with the best combination (``.yaml``), or a page with plots (``.html``).

        Parameters
        ----------
        path : path-like
            Where to; the ending decides.

        Raises
        ------
        ConfigurationError
            No combination has a rank, or the ending is another.
        HysteresisError
            The file cannot be written, or a page needs Matplotlib and Jinja2.
        """
        ending = pathlib.Path(path).suffix.lower()
        if ending == ".html":
            write_page(self, path)
        elif ending in (".yaml", ".yml"):
            write_file(path, best_text(self))
        else:
            raise ConfigurationError(f"{path}: must end in .yaml (the best combination) or .html (a page)")
