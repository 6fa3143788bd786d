# `make demo` and `make test` each do everything on a fresh machine with Python >= 3.11.
SHELL  := /bin/bash
VENV   := .venv
BIN    := $(VENV)/bin
# The first interpreter that runs and is new enough; a name alone may be a version manager's empty shim.
PYTHON ?= $(firstword $(shell for name in python3 python3.13 python3.12 python3.11; do \
	$$name -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$name; done))
FLAGS  := --disable-pip-version-check -c constraints.txt

.PHONY: help demo test checks trial format clean

help:
	@echo "make demo    install what is needed, then fly nine simulated vehicles around a moving target"
	@echo "make test    install what is needed, then check format, lint and types and run all tests"
	@echo "make trial   install what is needed, then fly a thousand seeded flights with faults"
	@echo "make format  rewrite the sources in the project's format"
	@echo "make clean   remove the virtual environment and all caches"

demo: $(VENV)/.runtime
	@$(BIN)/fg-gcs fly missions/circle.toml

# Code is compiled on one core while the checks run on another. Tests take from a millisecond to half a minute: idle
# workers take tests from busy ones, and there is one more of them than cores, as many tests wait for real time
test: $(VENV)/.installed
	@$(MAKE) --no-print-directory --jobs=2 checks $(VENV)/.compiled
	@echo "== tests";   $(BIN)/pytest -n $$(( $$(nproc) + 1 )) --dist worksteal

checks: $(VENV)/.tools
	@echo "== format";  $(BIN)/ruff format --check .
	@echo "== lint";    $(BIN)/ruff check .
	@echo "== types";   $(BIN)/mypy

# A thousand flights with random faults, judged by the simulator's truth: some twenty minutes on two cores
trial: $(VENV)/.runtime
	@$(BIN)/fg-gcs trial missions/*.toml --count 1000 --jobs $$(nproc)

format: $(VENV)/.tools
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache *.egg-info

$(VENV)/bin/python:
	@test -n "$(PYTHON)" || { echo "fg-gcs needs Python 3.11 or newer and found none; name one: make PYTHON=..." >&2; exit 1; }
	@echo "Creating the virtual environment $(VENV) with $(PYTHON) ..."
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "Installing fg-gcs and what it runs on into $(VENV) (once, about half a minute) ..."
	@$(BIN)/python -m pip install $(FLAGS) -e .
	@touch $@

$(VENV)/.runtime: $(VENV)/.installed
	@echo "Compiling the planner (once, about half a minute) ..."
	@$(BIN)/python -c 'from pathlib import Path; from fg_gcs.mission import load_mission; \
		from fg_gcs.run.flying import prepare; prepare(load_mission(Path("missions/circle.toml")))'
	@touch $@

$(VENV)/.compiled: $(VENV)/.runtime
	@echo "Compiling what only the tests use (once, about half a minute) ..."
	@$(BIN)/python -c 'from fg_gcs.plan.compiled import build; build(("rigid", "free"))'
	@touch $@

$(VENV)/.tools: $(VENV)/.installed
	@echo "Installing the tools of the tests into $(VENV) (once) ..."
	@$(BIN)/python -m pip install $(FLAGS) -e '.[dev]'
	@touch $@
