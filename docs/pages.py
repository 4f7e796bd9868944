# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""What Sphinx needs besides its extensions: pages of the reference, links out of this folder, equations as MathML."""

from __future__ import annotations

import ast
import functools
import inspect
import pathlib
import re
import types

import click
import latex2mathml.converter
from docutils import nodes

import hysteresis_ros as hr
from hysteresis_ros.cli.main import COMMANDS, main

ROOT = pathlib.Path(__file__).resolve().parents[1]
#: Where the sources are, for links to what is no page.
REPOSITORY = "https://github.com/hysteresis-ros/hysteresis_ros/"

#: Namespaces of blocks: what stands above their lists.
BLOCKS = {
    "models": "Hysteresis models, from voltage [V] to displacement [m], those of other packages included; "
    ":doc:`/models` says which one to choose.",
    "inverses": "Compensators, from the wanted displacement [m] to the voltage [V], with a model of their own.",
    "controllers": "Controllers, from reference and measured displacement [m] to the command [m]; :doc:`/control` says "
    "which one to choose and how it is designed.",
    "references": "Waveforms, displacements [m] over time.",
}


def title(text: str) -> str:
    """Return a heading of reStructuredText."""
    return f"{text}\n{'=' * len(text)}\n\n"


def listed(names) -> str:
    """Return a summary of names with a page for each."""
    return (
        ".. autosummary::\n   :toctree: generated\n   :nosignatures:\n\n" + "".join(f"   {n}\n" for n in names) + "\n"
    )


def of_kind(kind) -> list[str]:
    """Return the public names that are functions, or classes."""
    return [name for name in hr.__all__ if kind(getattr(hr, name))]


def first_sentence(docstring: str | None) -> str:
    """Return the first sentence of a docstring in one line, without roles and marks."""
    text = " ".join((docstring or "").split("\n\n")[0].split())
    text = re.sub(r":\w+:`[.~]*([^`]*)`", r"\1", text).replace("``", "").replace("`", "'")
    return re.sub(r"([*|_\\])", r"\\\1", text)


def names_page() -> str:
    """Return the page of the functions and classes of the package itself."""
    text = title("Functions and results") + (
        "``import hysteresis_ros as hr`` gives these, each imported at its first use. All numbers are SI.\n\n"
        ".. rubric:: Functions\n\n"
    )
    text += listed(f"hysteresis_ros.{name}" for name in of_kind(inspect.isfunction))
    return text + ".. rubric:: Classes\n\n" + listed(f"hysteresis_ros.{name}" for name in of_kind(inspect.isclass))


def blocks_page(namespace: str) -> str:
    """Return the page of a namespace of blocks."""
    classes = [name for name in dir(getattr(hr, namespace)) if inspect.isclass(getattr(getattr(hr, namespace), name))]
    made = [name for name in classes if hasattr(getattr(getattr(hr, namespace), name), "keywords")]
    return (
        title(f"hr.{namespace}")
        + f"{BLOCKS[namespace]}\n\n"
        + listed(f"hysteresis_ros.{namespace}.{name}" for name in made)
    )


def commands_page() -> str:
    """Return the page of all commands, as their help has them."""
    text = title("Commands") + "``hysteresis COMMAND --help`` prints the same. Wrong input ends with exit code 2.\n\n"
    with click.Context(main, info_name="hysteresis", max_content_width=100, terminal_width=100) as whole:
        for name in COMMANDS:
            command = main.get_command(whole, name)
            with click.Context(command, info_name=name, parent=whole, terminal_width=100) as context:
                lines = command.get_help(context).splitlines()
            heading = f"hysteresis {name}"
            block = "\n".join(f"   {line}".rstrip() for line in lines)
            text += f"{heading}\n{'-' * len(heading)}\n\n.. code-block:: text\n\n{block}\n\n"
    return text


def public(tree: ast.Module):
    """Yield name and first sentence of the public functions and classes of a module."""
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            yield node.name, first_sentence(ast.get_docstring(node))


def modules_page() -> str:
    """Return the page of everything there is: each module with its public functions and classes, a line each."""
    text = title("Everything there is") + (
        "Every module of the package with its public functions and classes, for searching. What is not among the "
        "functions and blocks of ``hr`` may change from version to version.\n\n"
    )
    folder = ""
    for path in sorted((ROOT / "hysteresis_ros").rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        tree = ast.parse(path.read_text(encoding="utf-8"))
        top = ".".join(name.split(".")[:2])
        if top != folder and (ROOT / "hysteresis_ros" / top.partition(".")[2]).is_dir():
            folder = top
            text += f"{top}\n{'-' * len(top)}\n\n"
        text += f"``{name}``: {first_sentence(ast.get_docstring(tree))}\n\n"
        rows = [f"- ``{item}``: {line}\n" for item, line in public(tree)]
        text += "".join(rows) + ("\n" if rows else "")
    return text


@functools.cache
def reference_pages() -> dict[str, str]:
    """Return the pages of the reference by file name."""
    found = {"names": names_page(), **{f"hr_{name}": blocks_page(name) for name in BLOCKS}}
    found |= {"commands": commands_page(), "modules": modules_page()}
    index = title("Reference") + (
        "What ``import hysteresis_ros as hr`` gives, the commands, and everything behind them; parameters of the nodes "
        "are on a page of their own: :doc:`/parameters`.\n\n.. toctree::\n   :maxdepth: 2\n\n"
    )
    return {"index": index + "".join(f"   {name}\n" for name in found), **found}


def write_reference(folder: pathlib.Path) -> None:
    """Write the pages of the reference, those that changed only: what did not is not read again."""
    folder.mkdir(exist_ok=True)
    for name, text in reference_pages().items():
        path = folder / f"{name}.rst"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def with_links(app, docname: str, source: list[str]) -> None:
    """Let links out of this folder lead to the repository."""
    if "/" not in docname:
        source[0] = re.sub(r"\]\(\.\./", f"]({REPOSITORY}blob/main/", source[0])


def with_all_pages(app, docname: str, source: list[str]) -> None:
    """Put pages that no list names at the end of the last one: a new page is found at once."""
    if docname != "index":
        return
    named = set(re.findall(r"^([\w/]+)$", source[0], re.MULTILINE))
    rest = sorted(path.stem for path in pathlib.Path(app.srcdir).glob("*.md") if path.stem not in named | {"index"})
    source[0] = source[0].replace("\n% more", "".join(f"\n{name}" for name in rest))


def mathml(self, node: nodes.Element) -> None:
    """Write an equation as MathML, which browsers draw by themselves."""
    display = "block" if isinstance(node, nodes.math_block) else "inline"
    self.body.append(latex2mathml.converter.convert(node.astext(), display=display))
    raise nodes.SkipNode


def shown_members(app, what: str, name: str, obj: object, skip: bool, options) -> bool | None:
    """Leave out what a class only has for the package: kernels and tables."""
    plain = name in ("keywords", "kernel", "kernel_of") or isinstance(obj, (types.BuiltinFunctionType, dict))
    return True if what == "class" and plain else None


def with_bars(app, what: str, name: str, obj: object, options, lines: list[str]) -> None:
    """Keep the bars of |h| as they are: reStructuredText takes them for marks outside of equations and literals."""
    equation = None
    for number, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        if line.strip().startswith(".. math::"):
            equation = indent
        elif line.strip() and equation is not None and indent <= equation:
            equation = None
        if equation is None:
            parts = line.split("``")
            parts[::2] = [part.replace("|", r"\|") for part in parts[::2]]
            lines[number] = "``".join(parts)


def connect(app) -> None:
    """Connect all of it."""
    app.add_html_math_renderer("mathml", (mathml, None), (mathml, None))
    app.connect("source-read", with_links)
    app.connect("source-read", with_all_pages)
    app.connect("autodoc-skip-member", shown_members)
    app.connect("autodoc-process-docstring", with_bars)
