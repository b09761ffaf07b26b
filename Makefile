# make demo   the main job on a built-in car: log, models, verdict, controller, page
# make test   lint, types and tests
# make test-all   the slow checks too
PYTHON ?= python3
BIN := .venv/bin
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export SLIPANGLE_DATA ?= $(wildcard $(abspath ../shared/data))

.PHONY: demo test test-all lint clean

demo: .venv/installed
	$(BIN)/slipangle demo

test: lint
	$(BIN)/python -m pytest -n auto -q

test-all: lint
	$(BIN)/python -m pytest -n auto -q -m "slow or not slow"

lint: .venv/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/pyright

.venv/bin/python:
	$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("Python is %d.%d, slipangle needs 3.11 or newer: make PYTHON=python3.12" % sys.version_info[:2])'
	$(PYTHON) -m venv .venv

.venv/installed: .venv/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

.venv/installed-dev: .venv/installed pyproject.toml
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet --group dev
	touch $@

clean:
	rm -rf .venv .pytest_cache .ruff_cache build dist
