# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The notebooks run from their first to their last cell, and their stored form contains no results."""

from __future__ import annotations

import pathlib

import pytest

nbformat = pytest.importorskip("nbformat", reason="notebooks need the extra docs")
pytest.importorskip("nbclient", reason="notebooks need the extra docs")
pytest.importorskip("ipykernel", reason="notebooks need the extra docs")

FOLDER = pathlib.Path(__file__).resolve().parents[2] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def test_the_notebooks_run(tmp_path):
    """One after the other in one kernel, names deleted between, because imports take most of the time of a notebook."""
    from nbclient import NotebookClient

    whole = nbformat.v4.new_notebook()
    for path in NOTEBOOKS:
        cells = nbformat.read(path, as_version=4).cells
        for cell in (nbformat.v4.new_code_cell("%reset -f"), *cells):
            cell.metadata["notebook"], cell["id"] = path.stem, f"{len(whole.cells)}"
            whole.cells.append(cell)
    NotebookClient(whole, kernel_name="python3", timeout=300, resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [(cell.metadata.notebook, output) for cell in whole.cells for output in cell.get("outputs", ())]
    drawn = {name for name, output in outputs if "image/png" in output.get("data", {})}
    assert drawn == {path.stem for path in NOTEBOOKS}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_results(path):
    notebook = nbformat.read(path, as_version=4)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert len(NOTEBOOKS) >= 4 and cells
    assert all(not cell.outputs and cell.execution_count is None for cell in cells), "clear all results, then save"
