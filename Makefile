# make demo and make test do all set-up themselves, in a virtual environment of their own.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# Packages are compiled where they are used: all of theirs, most of which nobody loads, take twenty seconds.
INSTALL := $(BIN)/python -m pip install --quiet --no-compile
# Tests start some hundred processes, each of which would compile the planner anew: more than a second each.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-long bench lint clean

demo: $(STAMP)
	$(BIN)/tandem plan problems/column_capital/problem.yaml -o out/column_capital

# Three workers on two cores: tests of pages and services wait for others a seventh of the time.
test: $(STAMP)
	$(BIN)/python -m pytest -n 3 --dist worksteal -m "not long"

test-long: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist worksteal

bench: $(STAMP)
	$(BIN)/python -m bench

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

$(STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(INSTALL) --editable ".[test,lint]"
	touch $(STAMP)

clean:
	rm -rf $(VENV) out build dist
