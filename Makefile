# make demo            the main job on a built-in car: log, models, verdict, controller, page
# make test            lint, types and tests
# make test-all        the slow checks too
# make test-machines   everything that fits, as other machines compute it; COMMIT=hash: one and a third of its tests
# make test-lowest     the tests with the lowest versions that pyproject.toml allows, extras too, on Python 3.11
# make test-export     exported C on every compiler and machine that is installed (docs/export.md names the packages)
# make docs            the documentation as a site, build/docs/html: anything doubtful and any broken link fails
# make mutants         the source broken on purpose, one place at a time: do the tests notice?
PYTHON ?= python3
LOWEST_PYTHON ?= $(shell command -v python3.11 || echo $(PYTHON))
BIN := .venv/bin
TYPES := .venv/types/lib/python3.11/site-packages
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export SLIPANGLE_DATA ?= $(wildcard $(abspath ../shared/data))

.PHONY: demo test tests test-all tests-all test-machines test-lowest test-export docs mutants lint style types clean

demo: .venv/installed
	$(BIN)/slipangle demo

# Types take a minute of one core: beside the tests, which take all of them.
test: style
	$(MAKE) -j 2 types tests

test-all: style
	$(MAKE) -j 2 types tests-all

# Tests start a hundred processes that import all of this: byte code is kept, whatever the environment says.
tests tests-all: export PYTHONDONTWRITEBYTECODE :=

tests: .venv/installed-dev
	$(BIN)/python -m pytest -n auto -q

tests-all: .venv/installed-dev
	$(BIN)/python -m pytest -n auto -q -m "slow or not slow"

test-machines: .venv/installed-dev
	$(BIN)/python -m tests.machines --tests $(if $(COMMIT),--one $(COMMIT))

test-lowest: .venv-lowest/installed
	.venv-lowest/bin/python -m pytest -n auto -q

test-export: .venv/installed-export
	$(BIN)/python -m pytest -q -m "slow or not slow" tests/export tests/codegen

docs: .venv/installed-docs
	$(BIN)/python -m docs.site

mutants: .venv/installed-dev
	$(BIN)/python -m tests.mutants

lint: style types

style: .venv/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: .venv/installed-types
	$(BIN)/pyright

.venv/bin/python:
	$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("Python is %d.%d, slipangle needs 3.11 or newer: make PYTHON=python3.12" % sys.version_info[:2])'
	$(PYTHON) -m venv .venv

.venv/installed: .venv/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

.venv/installed-dev: .venv/installed pyproject.toml
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet --editable ".[neural]" --group dev
	touch $@

.venv/installed-export: .venv/installed-dev pyproject.toml
	$(BIN)/python -m pip install --quiet --group export
	touch $@

.venv/installed-docs: .venv/installed pyproject.toml
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet --group docs
	touch $@

# Read by pyright, never run: the same wheels whatever Python and system this is.
.venv/installed-types: .venv/installed-dev pyproject.toml
	rm -rf $(TYPES)
	$(BIN)/python -m pip install --quiet --group types --target $(TYPES) --no-deps --only-binary :all: --python-version 3.11 \
		--platform manylinux2014_x86_64 --platform manylinux_2_27_x86_64 --platform manylinux_2_28_x86_64
	touch $@

.venv-lowest/installed: pyproject.toml tests/lowest.py
	$(LOWEST_PYTHON) -c 'import sys; sys.version_info[:2] == (3, 11) or sys.exit("Python is %d.%d, the lowest versions are those for 3.11: make test-lowest LOWEST_PYTHON=python3.11" % sys.version_info[:2])'
	$(LOWEST_PYTHON) -m venv --clear .venv-lowest
	.venv-lowest/bin/python -m pip install --quiet --upgrade "pip>=25.1"
	.venv-lowest/bin/python -m tests.lowest > .venv-lowest/constraints.txt
	.venv-lowest/bin/python -m pip install --quiet --constraint .venv-lowest/constraints.txt --editable ".[neural,cluster]" --group test
	touch $@

clean:
	rm -rf .venv .venv-lowest .pytest_cache .ruff_cache build dist
