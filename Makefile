# Everything here needs a Python (3.11 to 3.13; choose with PYTHON=…) and a package index, nothing else. No ROS has to
# be installed: `make setup` makes .venv with the ROS 2 Jazzy wheels. `make demo`, `make test` and `make bench` do the
# set-up by themselves and repeat the quick part of it after every change of a source.

VENV := .venv
BIN := $(VENV)/bin
SOURCES := $(shell find hysteresis_ros config launch resource -type f -not -name '*.pyc') setup.py setup.cfg package.xml
MODULES := $(shell find hysteresis_ros -type f -name '*.py')
# Nodes of this environment must not inherit the libraries of another one, nor answer to the network around.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
unexport LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
# The tests start hundreds of processes: where nothing may be kept, each compiles every source again.
unexport PYTHONDONTWRITEBYTECODE
# Workers of the tests, one more than the cores, because graphs of nodes wait most of their time: graphs whose clock
# needs a core run one after the other in one of them, the rest beside. More than eight would wait for that one.
WORKERS ?= $(shell cores=$$(nproc 2>/dev/null || echo 2); echo $$(( cores < 8 ? cores + 1 : 8 )))
# The versions that were tested; `make setup CONSTRAINTS=` takes the newest of everything instead.
CONSTRAINTS ?= constraints.txt
INSTALL := $(BIN)/python -m pip install --disable-pip-version-check $(addprefix --constraint ,$(CONSTRAINTS))
# What pip prints, as one line for each large download and one for the installation.
BRIEFLY := awk '/Downloading .*MB\)/ { gsub(/[(]/, "", $$(NF-1)); if ($$(NF-1) > 5) print "  fetching", $$2, $$(NF-1), "MB" } \
	/^Installing collected/ { print "  installing", NF - 3, "packages" } { fflush() }'
SHELL := /bin/bash
.SHELLFLAGS := -o pipefail -c

.PHONY: help setup setup-all tools demo quick quick-tests test coverage kernels lint format docs bench ci clean
.DELETE_ON_ERROR:

help:
	@echo "make setup | demo | quick | test | coverage | lint | format | docs | bench | ci | clean  (PYTHON=python3.12 chooses the Python)"

setup: $(VENV)/installed

# With the tools that check and document the package: what `make ci` needs.
setup-all: tools

# One after the other, because they are installed into the same environment.
tools: setup
	@$(MAKE) --no-print-directory -j1 $(addprefix $(VENV)/,lint-tools docs-tools colcon-tools coverage-tools)

demo: setup
	rm -rf demo
	$(BIN)/hysteresis demo -o demo

# What starts no nodes, repeats no paper and is not marked slow: while one works.
quick: setup
	$(MAKE) --no-print-directory -j2 lint quick-tests

quick-tests: setup
	$(BIN)/python -m pytest -n $(WORKERS) -m "not slow" $(addprefix --ignore=test/,nodes cli commissioning comparison papers fuzzing docs) \
		--ignore=test/test_install.py --ignore=test/test_extending.py

test: setup kernels
	$(BIN)/python -m pytest -n $(WORKERS)

# What continuous integration runs: every check and every test, none skipped because a tool is missing. The tests of the
# folders in COVERED are those of `coverage`.
ci: setup
	$(MAKE) --no-print-directory -j2 kernels tools
	$(MAKE) --no-print-directory -j2 lint coverage
	$(BIN)/python -m pytest -n $(WORKERS) $(addprefix --ignore=test/,$(COVERED))

# Lines that ran, by the tests of the same folders, apart from `make test`, so that no test against the clock is slowed.
# Processes that tests start are not measured: only folders whose tests run in this process count. Of these the tests of
# `references` were measured whole (44 s of processor time); a folder joins COVERED when it has been, with a new FLOOR.
# Policy: new code of these folders comes with the tests that run it; FLOOR [%] follows what is measured and never falls.
COVERED := references
FLOOR := 93
coverage: setup $(VENV)/coverage-tools
	mkdir -p build/coverage
	$(MEASURED) run --source=$$(echo $(addprefix hysteresis_ros/,$(COVERED)) | tr ' ' ,) \
		-m pytest -q $(addprefix test/,$(COVERED))
	$(MEASURED) report --fail-under=$(FLOOR)

# From Python 3.12 on the interpreter reports lines by itself (sys.monitoring), which costs least.
MEASURED = PYTHONPATH=$(VENV)/coverage \
	COVERAGE_CORE=$$($(BIN)/python -c 'import sys; print("sysmon" if sys.version_info >= (3, 12) else "ctrace")') \
	$(BIN)/python -m coverage

# Compiled once for all workers; pytest takes the modules of the current folder, so this does too.
kernels: setup
	-PYTHONPATH=$(CURDIR) $(BIN)/python test/compile_kernels.py

lint: setup $(VENV)/lint-tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/codespell
	$(BIN)/python test/wording.py
	@$(BIN)/numpydoc lint --ignore PR01,PR02,PR07,RT01,RT02,RT03,YD01,GL08 $(MODULES)
	@$(BIN)/numpydoc lint $(filter %/api.py %/designing.py %/studies.py %/swept.py %/classes.py %/inverse_classes.py hysteresis_ros/__init__.py,$(MODULES))

format: $(VENV)/lint-tools
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# Pages for a browser, build/docs/index.html; a warning is an error. Nothing is fetched.
docs: setup $(VENV)/docs-tools
	$(BIN)/python -m sphinx -W --keep-going -q -d build/doctrees docs build/docs
	@echo "build/docs/index.html"

bench: setup
	missed=0; for file in benchmarks/bench_*.py; do echo "== $$file"; $(BIN)/python $$file || missed=1; done; exit $$missed

clean:
	rm -rf $(VENV) demo dist build docs/reference install log *.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# What is tested is what a user gets: a true installation, made anew after every change (build/lib would keep files
# that were removed from the tree).
$(VENV)/installed: $(VENV)/requirements $(SOURCES)
	@echo "2 of 2: hysteresis_ros itself"
	@rm -rf build/lib build/bdist.*
	@$(INSTALL) --quiet --no-deps --no-build-isolation --force-reinstall .
	@rm -rf build/lib build/bdist.* hysteresis_ros.egg-info
	@touch $@

$(VENV)/requirements: $(VENV)/python setup.py pyproject.toml $(CONSTRAINTS)
	@echo "1 of 2: the packages that hysteresis_ros and its tests need (about 330 MB to fetch; 1 to 3 minutes the first time)"
	@$(INSTALL) ".[all,test]" | $(BRIEFLY)
	@touch $@

$(VENV)/lint-tools: $(VENV)/requirements
	@echo "ruff, mypy, numpydoc and codespell"
	@$(INSTALL) ".[lint]" | $(BRIEFLY)
	@touch $@

$(VENV)/docs-tools: $(VENV)/requirements
	@echo "Sphinx and Jupyter, for the pages and notebooks"
	@$(INSTALL) ".[docs]" | $(BRIEFLY)
	@touch $@

# In a folder that only `make coverage` names, because Numba imports `coverage` wherever it finds it.
$(VENV)/coverage-tools: $(VENV)/requirements
	@echo "coverage"
	@rm -rf $(VENV)/coverage
	@$(INSTALL) --target $(VENV)/coverage coverage | $(BRIEFLY)
	@touch $@

# colcon, with which one test builds the package, is nowhere the environment of the nodes, and brings what slows each of
# their starts (Numba imports `coverage` where it is installed).
$(VENV)/colcon-tools: $(VENV)/requirements
	@echo "colcon"
	@$(BIN)/python -m venv --clear --without-pip $(VENV)/colcon
	@$(INSTALL:install=--python $(VENV)/colcon/bin/python install) colcon-common-extensions "setuptools<80" | $(BRIEFLY)
	@touch $@

$(VENV)/python:
	@$(call make_environment)
	@touch $@

# A Python counts when it runs and has a fitting version (pyenv leaves names that do not run). Debian and Ubuntu split
# the venv module: without ensurepip the environment gets its pip from the pip outside, if there is one.
define make_environment
set -e; chosen=; \
for candidate in $(or $(PYTHON),python3.12 python3.11 python3.13 python3 python); do \
    if $$candidate -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null; then \
        chosen=$$candidate; break; \
    fi; \
done; \
if [ -z "$$chosen" ]; then \
    echo "error: $(if $(PYTHON),$(PYTHON) is not,there is no) Python 3.11, 3.12 or 3.13, which the ROS 2 Jazzy wheels need;" \
        "found: $$($(or $(PYTHON),python3) --version 2>&1 | tail -n 1)." \
        "Install one (Ubuntu 24.04: apt install python3.12-venv) and choose it: make setup PYTHON=python3.12" >&2; \
    exit 1; \
fi; \
echo "making $(VENV) with $$($$chosen --version) ($$chosen)"; \
rm -rf $(VENV); \
if $$chosen -c 'import ensurepip, venv' 2>/dev/null; then \
    $$chosen -m venv $(VENV); \
elif $$chosen -c 'import venv, pip' 2>/dev/null; then \
    echo "note: $$chosen has no ensurepip; .venv gets pip from the pip of $$chosen"; \
    $$chosen -m venv --without-pip $(VENV); \
    $$chosen -m pip --quiet --python $(BIN)/python install pip; \
else \
    echo "error: $$chosen can make no virtual environment: it has no venv module, or neither ensurepip nor pip." \
        "Debian and Ubuntu: apt install python3-venv; or choose another Python: make setup PYTHON=…" >&2; \
    exit 1; \
fi
endef
