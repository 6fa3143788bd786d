# `make demo` and `make test` each do everything on a fresh machine with Python >= 3.11.
SHELL  := /bin/bash
VENV   := .venv
BIN    := $(VENV)/bin
PYTHON ?= $(firstword $(shell for name in python3.13 python3.12 python3.11 python3; do command -v $$name; done))
FLAGS  := --disable-pip-version-check -c constraints.txt

.PHONY: help demo test format clean

help:
	@echo "make demo    install what is needed, then fly nine simulated vehicles around a target"
	@echo "make test    install what is needed, then check format, lint and types and run all tests"
	@echo "make format  rewrite the sources in the project's format"
	@echo "make clean   remove the virtual environment and all caches"

demo: $(VENV)/.runtime
	@$(BIN)/fg-gcs fly missions/demo.toml

test: $(VENV)/.dev
	@echo "== format";  $(BIN)/ruff format --check .
	@echo "== lint";    $(BIN)/ruff check .
	@echo "== types";   $(BIN)/mypy
	@echo "== tests";   $(BIN)/pytest

format: $(VENV)/.dev
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache *.egg-info

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else f"fg-gcs needs Python 3.11 or newer; $(PYTHON) is {sys.version.split()[0]}. Name another one: make PYTHON=...")'
	@echo "Creating the virtual environment $(VENV) with $(PYTHON) ..."
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.runtime: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "Installing fg-gcs and what it runs on into $(VENV) (once, about half a minute) ..."
	@$(BIN)/python -m pip install $(FLAGS) -e .
	@touch $@

$(VENV)/.dev: $(VENV)/.runtime
	@echo "Installing the tools of the tests into $(VENV) (once) ..."
	@$(BIN)/python -m pip install $(FLAGS) -e '.[dev]'
	@touch $@
