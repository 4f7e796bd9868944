# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""The package in total: one version, the layers of the design, complete docstrings."""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import inspect
import itertools
import json
import pathlib
import re
import subprocess
import sys
import xml.etree.ElementTree

import pytest
import wording
import yaml

import hysteresis_ros

ROOT = pathlib.Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "hysteresis_ros"
SOURCES = sorted(PACKAGE.rglob("*.py"))
TESTS = sorted((ROOT / "test").rglob("*.py"))

#: Layers that every folder may import besides itself: imports have one direction, in the order of the data flow.
BASE = {"", "errors", "units", "arguments", "signals", "files", "configuration", "registry", "executors"}
BLOCKS = BASE | {"models", "control", "references"}
MEASURED = BLOCKS | {"recordings", "hardware", "identification"}
CORE = MEASURED | {"loop", "designs", "analysis", "api", "designing", "exchange"}
MAY_IMPORT = {
    # at first use only, for `import hysteresis_ros as hr`
    "": BLOCKS | {"api", "designing", "exchange", "laboratory", "loop"},
    "errors": {""},
    "units": {"", "errors"},
    "arguments": {"", "errors", "units"},
    "signals": set(),
    "files": {"", "errors"},
    "configuration": {"", "errors", "files"},
    "registry": {"", "errors", "configuration"},
    "executors": {"", "errors"},
    "models": BASE,
    "control": BASE | {"models"},
    "references": BASE | {"models", "control"},
    "recordings": BASE,
    "hardware": BASE | {"models", "recordings"},
    "identification": BASE | {"models", "control", "recordings"},
    "loop": BLOCKS | {"recordings", "hardware"},
    "designs": MEASURED | {"loop"},
    "analysis": MEASURED,
    "api": MEASURED | {"loop", "designs", "analysis"},
    "designing": MEASURED | {"loop", "designs", "analysis", "api"},
    "exchange": MEASURED | {"loop", "api"},
    "nodes": MEASURED | {"loop", "designs", "analysis"},
    "cli": CORE | {"nodes"},
    "laboratory": CORE | {"nodes", "cli"},
}
ROS = re.compile(r"^(rclpy|ament_index_python|std_srvs|\w+_(msgs|interfaces))$")
#: Third-party files that pages contain: uPlot 1.6.32 as published (npm), with its licence (MIT) in the same folder.
#: Neither our notice nor our linters apply to them, and they must not be edited: sha256 of each file.
ASSETS = PACKAGE / "analysis" / "assets"
VENDORED = {
    ASSETS / "uPlot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
    ASSETS / "uPlot.min.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    ASSETS / "uPlot.LICENSE": "8f989229699b4fe2f1a0432d0e9edc338a8a911e250e2d1b01ecd770a5f5b1bd",
}
#: Heavy or special packages, and the only folders that may import them.
ONLY_IN = {
    "matplotlib": "analysis laboratory",
    "jinja2": "analysis",
    "click": "cli laboratory",
    "rich": "cli",
    "rosbags": "recordings",
    "mcap": "recordings",
    "cv2": "hardware",
    "control": "exchange",
    "distributed": "executors",
    "aiohttp": "laboratory",
}
#: Packages that blocks and their parameters must not import into a node.
HEAVY = ("scipy.signal", "scipy.optimize", "matplotlib", "jinja2", "rclpy", "click", "rosbags")


def name_of(path: pathlib.Path) -> str:
    return str(path.relative_to(PACKAGE.parent))


def layer_of(path: pathlib.Path) -> str:
    """Return the folder of a source, or the name of a top-level module; '' for the package itself."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return "" if parts == ("__init__",) else parts[0]


@functools.cache
def import_statements(path: pathlib.Path) -> list[ast.Import | ast.ImportFrom]:
    """Return all imports of a source, including lazy imports; three tests ask for them."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]


def imported_modules(path: pathlib.Path):
    """Yield the dotted names of all modules that a source imports anywhere, including lazy imports."""
    for node in import_statements(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        else:
            assert node.level == 0, f"{name_of(path)}:{node.lineno}: relative import"
            yield node.module
            if node.module == "hysteresis_ros":
                yield from (f"hysteresis_ros.{alias.name}" for alias in node.names)


def child(element, name: str) -> str:
    return element.find(name).text


#: Prints the arguments of setup.py for setuptools; in a separate process, because setuptools replaces distutils and
#: refuses to be imported after it.
SETUP = """
import json, setuptools
given = {}
setuptools.setup = lambda **arguments: given.update(arguments)
exec(compile(open("setup.py", encoding="utf-8").read(), "setup.py", "exec"), {"__file__": "setup.py"})
print(json.dumps(given, default=str))
"""


@functools.cache
def setup_arguments() -> dict:
    """Return the arguments of setup.py for setuptools."""
    if importlib.util.find_spec("setuptools") is None:
        pytest.skip("setup.py needs setuptools")
    answer = subprocess.run([sys.executable, "-c", SETUP], cwd=ROOT, capture_output=True, text=True, check=True)
    return json.loads(answer.stdout)


def text_of(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_every_module_of_the_tests_has_a_name_of_its_own():
    """pytest imports them by their names alone: of two with the same name, both folders would get the first."""
    names = [path.stem for path in TESTS if path.stem != "conftest"]
    assert {name for name in names if names.count(name) > 1} == set()


def test_version_is_the_same_everywhere():
    manifest = xml.etree.ElementTree.parse(ROOT / "package.xml").getroot()
    arguments = setup_arguments()
    assert hysteresis_ros.__version__ == child(manifest, "version") == arguments["version"]
    assert re.fullmatch(r"\d+\.\d+\.\d+", hysteresis_ros.__version__), "ROS wants three numbers"
    released = re.findall(r"^(\d+\.\d+\.\d+) \((\d{4}-\d\d-\d\d)\)\n-+$", text_of("CHANGELOG.rst"), re.MULTILINE)
    assert released[0][0] == hysteresis_ros.__version__, "the newest release must be first, below Forthcoming"
    cited = yaml.safe_load(text_of("CITATION.cff"))
    assert (cited["version"], str(cited["date-released"])) == released[0] and cited["license"] == "Apache-2.0"


def test_hooks_run_tools_of_the_environment_and_fetch_nothing():
    (repository,) = yaml.safe_load(text_of(".pre-commit-config.yaml"))["repos"]
    assert repository["repo"] == "local"
    assert all(hook["language"] == "system" for hook in repository["hooks"])
    tools = {hook["entry"].split()[0] for hook in repository["hooks"]}
    assert tools <= {f".venv/bin/{name}" for name in ("ruff", "mypy", "numpydoc", "codespell", "python")}
    assert re.search(r"lint --ignore (\S+)", text_of("Makefile"))[1] in str(repository["hooks"]), "as in make lint"


def test_manifest_and_setup_describe_the_same_package():
    manifest = xml.etree.ElementTree.parse(ROOT / "package.xml").getroot()
    arguments = setup_arguments()
    assert child(manifest, "name") == arguments["name"] == "hysteresis_ros"
    licences = [element.text for element in manifest.iter("license")]
    assert " AND ".join(licences) == arguments.get("license_expression", arguments.get("license")), "SPDX expressions"
    assert all((ROOT / element.get("file")).is_file() for element in manifest.iter("license"))
    assert child(manifest, "maintainer") == arguments["maintainer"]
    assert manifest.find("maintainer").get("email") == arguments["maintainer_email"]
    assert manifest.find("export/build_type").text == "ament_python"


@pytest.mark.slow
def test_manifest_names_every_ros_package_that_is_imported():
    manifest = xml.etree.ElementTree.parse(ROOT / "package.xml").getroot()
    named = {element.text for element in manifest.iter("exec_depend")}
    tops = {module.split(".")[0] for path in SOURCES for module in imported_modules(path)}
    assert {top for top in tops if ROS.match(top)} <= named


def test_every_executable_has_a_main_function():
    for entry in setup_arguments()["entry_points"]["console_scripts"]:
        name, target = entry.split(" = ")
        module, function = target.split(":")
        path = ROOT / (module.replace(".", "/") + ".py")
        assert path.is_file(), f"{name}: no {path}"
        tree = ast.parse(path.read_text(encoding="utf-8"))
        defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        imported = {
            alias.asname or alias.name for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names
        }
        assert function in defined | imported, f"{name}: {module} has no {function}"


def opening(path: pathlib.Path) -> str:
    """Return the first comment of a source, without comment marks and with single spaces."""
    marked = itertools.takewhile(lambda line: line.startswith(("#", "//")), path.read_text("utf-8").splitlines())
    return " ".join(" ".join(marked).replace("#", " ").replace("//", " ").split())


def test_every_source_begins_with_the_notice_of_its_licence():
    notice = opening(PACKAGE / "__init__.py")
    assert notice.startswith("Copyright 2026 ") and "Licensed under the Apache License, Version 2.0" in notice
    folders = ("hysteresis_ros", "test", "launch", "examples", "benchmarks", "docs")
    paths = [path for name in folders for path in (ROOT / name).rglob("*") if path not in VENDORED]
    sources = [path for path in paths if path.suffix in (".py", ".c", ".h", ".js")]
    without = [name_of(path) for path in [*sources, ROOT / "setup.py"] if opening(path) != notice]
    assert without == [], "copy the notice from hysteresis_ros/__init__.py"


@pytest.mark.parametrize("path", VENDORED, ids=name_of)
def test_what_others_wrote_is_as_they_published_it(path):
    assert hashlib.sha256(path.read_bytes()).hexdigest() == VENDORED[path]


def test_every_folder_of_sources_is_a_package():
    assert [str(folder) for folder in {path.parent for path in SOURCES} if not (folder / "__init__.py").is_file()] == []


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_imports_go_one_way(path):
    layer = layer_of(path)
    assert layer in MAY_IMPORT, f"{layer} is new: give it a place among the layers in this test"
    for module in imported_modules(path):
        top, _, rest = module.partition(".")
        if top == "hysteresis_ros":
            used = rest.split(".")[0] if rest.split(".")[0] in MAY_IMPORT else ""
            assert used in MAY_IMPORT[layer] | {layer}, f"{layer} imports {module}"
        elif ROS.match(top):
            assert layer in ("nodes", "laboratory"), f"{layer} imports {module}; only nodes may"
        elif top in ONLY_IN:
            assert layer in ONLY_IN[top].split(), f"{layer} imports {module}; only {ONLY_IN[top]} may"


def module_of(path: pathlib.Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the groups of modules that import each other, directly or indirectly (also lazily)."""
    reached: dict[str, set[str]] = {}
    for start in graph:
        found, ahead = set(), [start]
        while ahead:
            new = graph.get(ahead.pop(), set()) - found
            found |= new
            ahead += new
        reached[start] = found
    together = {frozenset({a} | {b for b in reached[a] if a in reached.get(b, ())}) for a in graph if a in reached[a]}
    return sorted(sorted(group) for group in together)


def test_no_modules_import_each_other_in_a_circle():
    sources = {module_of(path): path for path in SOURCES}
    graph: dict[str, set[str]] = {}
    for module, path in sources.items():
        graph[module] = set()
        for node in import_statements(path):
            if isinstance(node, ast.Import):
                graph[module] |= {alias.name for alias in node.names if alias.name in sources}
            else:
                for alias in node.names:
                    inner = f"{node.module}.{alias.name}"
                    graph[module] |= {inner if inner in sources else node.module} & set(sources)
    assert circles(graph) == []
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]


def test_the_rules_see_what_they_forbid(tmp_path):
    source = tmp_path / "lazy.py"
    source.write_text("def f():\n    from rclpy.node import Node\n    import matplotlib.pyplot as p, os\n")
    assert list(imported_modules(source)) == ["rclpy.node", "matplotlib.pyplot", "os"]
    assert ROS.match("std_srvs") and ROS.match("lifecycle_msgs") and not ROS.match("rosbags")


@pytest.mark.parametrize("path", TESTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_tests_import_no_tests(path):
    """Common functions of tests are in support modules; imports in scripts of child processes count, too."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    texts = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    scripted = re.findall(r"^\s*(?:from|import) (test_\w+)", "\n".join(texts), re.MULTILINE)
    names = {part for name in imported_modules(path) for part in name.split(".") if part.startswith("test_")}
    assert not names | set(scripted), f"move what is shared into a support module: {sorted(names | set(scripted))}"


def is_setter(node) -> bool:
    """A property is documented at its getter."""
    return any(isinstance(item, ast.Attribute) and item.attr == "setter" for item in node.decorator_list)


def public_definitions(tree: ast.Module):
    """Yield ``(qualified name, node)`` of the public classes and functions of a module, methods included."""
    definitions = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for node in tree.body:
        if isinstance(node, definitions) and not node.name.startswith("_"):
            yield node.name, node
            if isinstance(node, ast.ClassDef):
                for inner in node.body:
                    if isinstance(inner, definitions) and not inner.name.startswith("_") and not is_setter(inner):
                        yield f"{node.name}.{inner.name}", inner


def section(docstring: str, title: str) -> str | None:
    """Return the text of one numpydoc section, or None when there is no such section."""
    found = re.search(rf"^{title}\n-+\n(.*?)(?=^\S[^\n]*\n-+\n|\Z)", docstring, re.MULTILINE | re.DOTALL)
    return found and found.group(1)


def described_names(text: str) -> set[str]:
    """Return the names at the left margin of a Parameters section; ``a, b : float`` are two names."""
    lines = [line.split(" :")[0] for line in text.splitlines() if line and not line[0].isspace()]
    return {name.strip().lstrip("*") for line in lines for name in line.split(",")}


def accepted_names(node, bound: bool) -> set[str] | None:
    """Return the parameters of a function or of a class's ``__init__``; a dataclass's are its fields."""
    if isinstance(node, ast.ClassDef):
        makers = [item for item in node.body if isinstance(item, ast.FunctionDef) and item.name == "__init__"]
        if not makers:
            return {item.target.id for item in node.body if isinstance(item, ast.AnnAssign)} or None
        node, bound = makers[0], True
    names = [item.arg for item in [*node.args.posonlyargs, *node.args.args]]
    if bound and not any(isinstance(item, ast.Name) and item.id == "staticmethod" for item in node.decorator_list):
        del names[0]
    return {*names, *(item.arg for item in node.args.kwonlyargs)}


def inherited_fields(node, tree: ast.Module) -> set[str]:
    """Return the fields of a dataclass's bases in the same module, which it may describe, too."""
    bases = {item.id for item in getattr(node, "bases", ()) if isinstance(item, ast.Name)}
    classes = [item for item in tree.body if isinstance(item, ast.ClassDef) and item.name in bases]
    return {name for item in classes for name in accepted_names(item, bound=False) or ()}


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_public_things_are_documented_completely(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert ast.get_docstring(tree), f"{name_of(path)} has no docstring"
    for name, node in public_definitions(tree):
        docstring = ast.get_docstring(node)
        assert docstring, f"{name} has no docstring"
        assert docstring.splitlines()[0].rstrip()[-1] in ".:", f"{name}: the first line is no sentence"
        text = section(inspect.cleandoc(docstring) + "\n", "Parameters")
        accepted = accepted_names(node, bound="." in name)
        if text is not None and accepted is not None:
            described = described_names(text)
            variadic = {item.arg for item in ast.walk(node) if isinstance(item, ast.arg)}
            accepted_too = variadic | inherited_fields(node, tree)
            assert described <= accepted | accepted_too, f"{name} describes {sorted(described - accepted)}: unknown"
            missing = {item for item in accepted - described if not item.startswith("_")}
            assert not missing, f"{name} does not describe {sorted(missing)}"


#: Interfaces for users have full documentation: modules of `hr.*`, and the folders that docs/extending.md extends.
FULL_FOLDERS = {"models", "control", "references", "hardware"}
FULL_MODULES = {
    "api.py",
    "designing.py",
    "exchange.py",
    "designs/stage_identification.py",
    "identification/coupled.py",
    "identification/local_polynomial.py",
    "identification/workflow.py",
    "laboratory/benchmark/models.py",
    "laboratory/bluesky.py",
    "laboratory/studies.py",
    "laboratory/swept.py",
    "loop/ready.py",
    "recordings/triggers.py",
}
SECTIONS = ("Parameters", "Other Parameters", "Returns", "Yields", "Attributes")


def exported_classes() -> set[tuple[str, str]]:
    """Return the module and name of each class with an ``hr.*`` name, wherever it is defined."""
    values = [getattr(hysteresis_ros, name) for name in hysteresis_ros.__all__]
    return {(value.__module__, value.__name__) for value in values if inspect.isclass(value)}


def superfluous_sections(tree: ast.Module, exported: set[str]) -> list[str]:
    """Return objects with numpydoc sections in an internal module, including private ones."""
    definitions = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    open_to_users = {
        inner
        for node in tree.body
        if isinstance(node, ast.ClassDef) and node.name in exported
        for inner in ast.walk(node)
    }
    return [
        f"{node.name} (line {node.lineno}): {title}"
        for node in ast.walk(tree)
        if isinstance(node, definitions) and node not in open_to_users
        for title in SECTIONS
        if section((ast.get_docstring(node) or "") + "\n", title) is not None
    ]


def undescribed_classes(tree: ast.Module) -> list[str]:
    """Return public classes whose ``__init__`` has parameters without a Parameters section."""
    return [
        name
        for name, node in public_definitions(tree)
        if isinstance(node, ast.ClassDef)
        and any(isinstance(item, ast.FunctionDef) and item.name == "__init__" for item in node.body)
        and accepted_names(node, bound=False)
        and section((ast.get_docstring(node) or "") + "\n", "Parameters") is None
    ]


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_docstrings_are_full_where_users_write_and_one_sentence_elsewhere(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    if layer_of(path) in FULL_FOLDERS:
        missing = undescribed_classes(tree)
        assert missing == [], f"{name_of(path)}: users make these; add a Parameters section to {missing}"
    elif path.relative_to(PACKAGE).as_posix() not in FULL_MODULES:
        exported = {name for module, name in exported_classes() if module == module_of(path)}
        found = superfluous_sections(tree, exported)
        assert found == [], f"{name_of(path)} is internal: one sentence with its units, no section: {found}"


def test_the_rules_of_docstrings_see_what_they_forbid():
    sections = '"""Add.\n\n    Parameters\n    ----------\n    a : float\n        One.\n    """'
    internal = ast.parse(f"def _add(a):\n    {sections}\nclass Shown:\n    {sections}")
    assert superfluous_sections(internal, {"Shown"}) == ["_add (line 1): Parameters"]
    bare = ast.parse('class Law:\n    """A law."""\n    def __init__(self, gain):\n        pass\n')
    assert undescribed_classes(bare) == ["Law"]


@pytest.mark.slow
def test_words_that_are_not_ours_become_fewer():
    """An allowance in test/wording.py may be lowered, never raised."""
    assert wording.too_many(wording.counted()) == []
    assert wording.occurrences("a b", wording.in_one_line("one a\n    # b, A b, a bc")) == 1
    first = next(iter(wording.NOT_OURS))
    (line, *_) = wording.too_many({phrase: {"docs/new.md": 1000} for phrase in wording.NOT_OURS})
    assert line.startswith(f"'{first}' stands 1000 times, ") and "Write: " in line and "docs/new.md (1000)" in line


@pytest.mark.slow
def test_the_laboratory_is_beside_the_core():
    """An axis runs without papers, campaigns, emulated devices and pages: a node imports none of them."""
    nodes = "motion_controller, plant_simulator, hysteresis_compensator, reference_generator, recorder, axis"
    code = f"""
import sys
from hysteresis_ros.nodes import {nodes}
from hysteresis_ros.cli import main, up
print(*[name for name in sys.modules if name.startswith("hysteresis_ros.laboratory")])
"""
    answer = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert answer.stdout.split() == []


@pytest.mark.slow
def test_a_node_imports_no_more_than_it_needs():
    """Memory is limited: SciPy's signal and optimisation, plots and the command line are not imported by nodes."""
    modules = "sys, hysteresis_ros.loop.axis, hysteresis_ros.loop.parameters"
    code = f"import {modules}; print(*[name for name in {HEAVY} if name in sys.modules])"
    answer = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert answer.stdout.split() == []


def test_every_tool_and_library_has_a_tested_version():
    """`make setup` on a new machine installs the tested versions, even if newer ones were published."""
    pinned = dict(re.findall(r"^([a-z0-9-]+)==([^;\s]+)", text_of("constraints.txt"), re.MULTILINE))
    arguments = setup_arguments()
    asked = [*arguments["install_requires"], *itertools.chain(*arguments["extras_require"].values())]
    names = {re.match(r"[\w.-]+", requirement)[0].lower().replace("_", "-").replace(".", "-") for requirement in asked}
    assert names <= set(pinned)
    assert "://" not in text_of("constraints.txt"), "no package index is named"


def test_the_test_command_runs_tests_and_the_lint_is_a_command_of_its_own():
    """A new version of a checker must not make the tests fail for a new user."""
    makefile = text_of("Makefile")
    rules = dict(re.findall(r"^([\w-]+):([^=\n]*(?:\n\t[^\n]*)*)", makefile, re.MULTILINE))
    assert "lint" not in rules["test"] and "pytest" in rules["test"]
    assert "coverage" in rules["ci"] and "--fail-under" in rules["coverage"]
    assert "lint" in rules["ci"] and "pytest" in rules["ci"] and "make --no-print-directory ci" in text_of(".ci/run")
    assert not {"ruff", "mypy", "sphinx", "colcon-common-extensions"} & set(setup_arguments()["extras_require"]["test"])
