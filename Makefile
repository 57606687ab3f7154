# make demo   sets up and plans the shipped example
# make test   sets up and checks everything that a change must hold
# make help   lists the rest

SHELL := /bin/bash
BIN := .venv/bin
WORKERS ?= 2
PYTEST := $(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup

.PHONY: help setup demo test test-slow lint types imports unit lock wheel clean

help:
	@echo "make setup      make .venv from requirements.lock (skipped when it is up to date)"
	@echo "make demo       plan the inspection of the example, results in demo/"
	@echo "make test       format, lint, types, import contracts, tests"
	@echo "make test-slow  the tests that take minutes"
	@echo "make lint       format and lint only;  make types  mypy only"
	@echo "make lock       resolve the dependencies anew into requirements.lock"
	@echo "make wheel      build dist/cellwright-*.whl"
	@echo "make clean      remove what tools have left behind; .venv and lakes stay"

setup:
	@scripts/set_up.sh

demo: setup
	$(BIN)/cellwright inspect examples/grooved_cylinder.yaml --out demo

test: lint types imports unit

lint: setup
	$(BIN)/ruff format --check --quiet .
	$(BIN)/ruff check --quiet .

types: setup
	$(BIN)/mypy

imports: setup
	$(BIN)/lint-imports

unit: setup
	$(PYTEST) -m "not slow"

test-slow: setup
	$(PYTEST) -m slow

lock: setup
	$(BIN)/uv pip compile pyproject.toml --group dev --group setup --python-version 3.11 --upgrade --quiet \
		--no-header --no-annotate --generate-hashes --output-file requirements.lock

wheel: setup
	$(BIN)/uv build --wheel --no-build-isolation --python $(BIN)/python --out-dir dist --quiet

clean:
	rm -rf build dist demo .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -not -path './.venv/*' -prune -exec rm -rf {} +
