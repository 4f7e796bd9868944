# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The pages: every page is found, every public name is in the reference, and no link is broken."""

from __future__ import annotations

import ast
import importlib
import inspect
import pathlib
import re
import sys
import types

import pytest

import hysteresis_ros as hr
from hysteresis_ros.cli.main import COMMANDS

for needed in ("sphinx", "myst_nb", "numpydoc", "latex2mathml"):
    pytest.importorskip(needed, reason="pages need the extra docs")

ROOT = pathlib.Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
BLOCKS = ("models", "inverses", "controllers", "references")


@pytest.fixture(scope="module")
def pages():
    """The module docs/pages.py, which makes the reference and is not part of the package; found as by docs/conf.py."""
    found = sys.path.copy()
    sys.path.insert(0, str(DOCS))
    yield importlib.import_module("pages")
    sys.path[:] = found


def listed(text: str) -> set[str]:
    """Return the pages in the lists of a page."""
    lists = re.findall(r"^```\{toctree\}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return {line for block in lists for line in block.splitlines() if line and not line.startswith(":")}


def test_every_page_and_notebook_is_in_a_list(pages):
    source = [(DOCS / "index.md").read_text(encoding="utf-8")]
    assert "% more" in source[0]
    pages.with_all_pages(types.SimpleNamespace(srcdir=DOCS), "index", source)
    there = {path.stem for path in DOCS.glob("*.md")} - {"index"}
    there |= {f"notebooks/{path.stem}" for path in (DOCS / "notebooks").glob("*.ipynb")}
    assert listed(source[0]) == there | {"reference/index"}


def test_tables_of_the_site_break_long_words_beside_both_side_bars():
    """Otherwise the last column, the meaning, is beyond the edge of a window of 1400 px."""
    text = (DOCS / "conf.py").read_text(encoding="utf-8")
    given = {ast.unparse(one.targets[0]): one.value for one in ast.parse(text).body if isinstance(one, ast.Assign)}
    folders, files = (ast.literal_eval(given[name]) for name in ("html_static_path", "html_css_files"))
    (sheet,) = [DOCS / folder / name for folder in folders for name in files if name == "tables.css"]
    rules = re.sub(r"/\*.*?\*/", "", sheet.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert re.search(r"table\.docutils td[^{}]*\{[^}]*overflow-wrap: anywhere", rules)
    assert re.search(r"code\.literal \{[^}]*white-space: normal", rules)
    (wide,) = re.findall(r"@media \(min-width: (\d+)px\) \{ [^{]*\.content \{ width: 50em", rules)
    assert int(wide) <= 1400


def test_the_index_of_decisions_has_the_title_of_each_one_under_its_group():
    text = (DOCS / "decisions.md").read_text(encoding="utf-8")
    index, *groups = re.split(r"\n## ", text)
    for group in groups:
        name = group.split("\n", 1)[0]
        (entry,) = re.findall(rf"^- \[{name}\]\(#.+\)\n((?:  - .+\n)+)", f"{index}\n", re.MULTILINE)
        titles = [f"{line.removeprefix('  - ')}." for line in entry.splitlines()]
        decisions = re.findall(r"^\*\*(.+?)\*\*", group, re.MULTILINE | re.DOTALL)
        assert titles == [decision.replace("\n", " ") for decision in decisions], name


def test_a_page_that_no_list_names_comes_into_the_last_one(pages, tmp_path):
    for name in ("index", "known", "new"):
        (tmp_path / f"{name}.md").write_text("")
    source = ["```{toctree}\n:maxdepth: 1\n\nknown\n% more\n```\n"]
    pages.with_all_pages(types.SimpleNamespace(srcdir=tmp_path), "index", source)
    assert listed(source[0]) == {"known", "new"}


def test_every_public_name_is_in_the_reference(pages):
    made = pages.reference_pages()
    named = set(re.findall(r"^   hysteresis_ros\.(\S+)$", "\n".join(made.values()), re.MULTILINE))
    public = {name for name in hr.__all__ if name not in BLOCKS}
    for block in BLOCKS:
        space = getattr(hr, block)
        members = {name: getattr(space, name) for name in dir(space) if not name.startswith("_")}
        public |= {f"{block}.{name}" for name, value in members.items() if inspect.isclass(value)}
    assert named == public
    assert all(f"\nhysteresis {name}\n---" in made["commands"] for name in COMMANDS)
    assert "``hysteresis_ros.recordings.repair``" in made["modules"]


@pytest.mark.parametrize("block", BLOCKS[:1] + BLOCKS[2:3])
def test_every_law_is_documented_with_what_it_is(block):
    """Equations and sources are in the module of the law, and in the help of its class."""
    space = getattr(hr, block)
    for name in dir(space):
        made = getattr(space, name)
        if inspect.isclass(made) and hasattr(made, "keywords") and name != "OpenLoop":
            assert "\nNotes\n-----\n" in made.__doc__ and ".. math::" in made.__doc__, name


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::PendingDeprecationWarning")
def test_the_pages_are_made_without_a_warning(pages, tmp_path, capsys):
    """Pages are read and linked, but not written; notebooks are run by another test."""
    from sphinx.cmd.build import build_main
    from sphinx.util.docutils import docutils_namespace

    options = ["-W", "--keep-going", "-q", "-b", "dummy", "-D", "nb_execution_mode=off", "-d", tmp_path / "doctrees"]
    with docutils_namespace():
        code = build_main([str(word) for word in (*options, DOCS, tmp_path / "pages")])
    assert (code, capsys.readouterr().err) == (0, "")


def test_equations_become_elements_that_browsers_draw(pages):
    from docutils import nodes

    written = types.SimpleNamespace(body=[])
    with pytest.raises(nodes.SkipNode):
        pages.mathml(written, nodes.math_block(r"\dot h = \frac{1}{2}", r"\dot h = \frac{1}{2}"))
    assert "<mfrac>" in written.body[0] and 'display="block"' in written.body[0]


def test_bars_are_bars_outside_of_equations_and_literals(pages):
    lines = ["about |h| and ``|V|``", "", ".. math::", "", "   |h|^n", "", "|x| again"]
    pages.with_bars(None, "class", "name", None, None, lines)
    assert lines == [r"about \|h\| and ``|V|``", "", ".. math::", "", "   |h|^n", "", r"\|x\| again"]


def test_what_pages_need_is_not_installed_with_the_package():
    text = (ROOT / "setup.py").read_text(encoding="utf-8")
    needed = re.search(r"install_requires=\[(.*?)\]", text)[1]
    assert not re.search("sphinx|myst|numpydoc|furo|nbclient|latex2mathml", needed)
