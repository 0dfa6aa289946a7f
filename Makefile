# make setup | demo | check | test | test-all | test-hard | bench | docs | wheel | clean
SHELL := /bin/bash
VENV := .venv
BIN := $(VENV)/bin
# Compiled once for all the programs that tests start, whatever the environment says: 49 s, not 56.
PYTEST := env -u PYTHONDONTWRITEBYTECODE PYTHONPYCACHEPREFIX="$(CURDIR)/build/pycache" $(BIN)/pytest
# For the summary of tests/run.py; xunit1 names files. A file that cannot be imported is one failure.
REPORT = --continue-on-collection-errors -o junit_family=xunit1 --junitxml=build/tests/$@.xml
# Where tests are judged by the clock; tests/conftest.py marks them, and single ones that `judge`.
REAL_TIME := tests/diagrams/test_hardware_station.py tests/sims/real_machine
JUDGED = $(shell grep -rlw judge tests --include='test_*.py')
# Where tests need whole runs of experiments, which tests/conftest.py shares, or compute for long.
WHOLE_RUNS := tests/laws/test_chapters.py tests/laws/test_experiments.py tests/sims/levelling_platform tests/sims/machining_centre tests/sims/terrain_simulator tests/sims/walking_chair tests/sims/study tests/test_notebooks.py tests/your_own
# One process more than there are cores: tests of devices wait for them. Where none does, two,
# three and four processes took 43, 46 and 49 s on two cores.
TOGETHER := $(PYTEST) -n $(shell expr $$(getconf _NPROCESSORS_ONLN) + 1)
ARGS ?=
comma := ,
# Whether real-time programs may keep other programs away.
BESIDE := $(shell chrt --fifo 1 true 2>/dev/null && echo yes)
# pytest's answer where there is none of the tests that are asked for.
NONE := [ $$? = 5 ]
# What can run beside each other does, on all cores; what is judged by the clock then runs alone, or,
# where real-time programs may keep others away, beside what computes for long.
STAGES := $(if $(BESIDE),together clocked$(comma)whole-runs$(comma)types,together$(comma)types clocked)

# The newest interpreter that is new enough; PYTHON=/path/to/python overrides it.
PYTHON ?= $(shell for p in python3.14 python3.13 python3.12 python3; do \
  if $$p -c 'import sys; sys.exit(sys.version_info < (3, 12))' >/dev/null 2>&1; then command -v $$p; break; fi; done)

.PHONY: setup demo check test tests test-all test-hard lint types together everyday clocked whole-runs slow bench docs wheel clean
.DEFAULT_GOAL := setup

setup: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml
	@if [ -z "$(PYTHON)" ]; then \
	  echo "parapod needs Python 3.12 or newer (Drake has no wheels for older ones), and none was found."; \
	  echo "Install one (apt install python3.12 python3.12-venv, brew install python@3.13, pyenv install 3.12, uv python install 3.12)"; \
	  echo "or name it: make setup PYTHON=/path/to/python3.12"; exit 1; fi
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 12))' >/dev/null 2>&1 || { \
	  echo "$(PYTHON) is not Python 3.12 or newer, which parapod needs: $$($(PYTHON) --version 2>&1)"; exit 1; }
	@echo "setting up $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv --clear $(VENV) || { echo "$(PYTHON) has no venv module: install it (apt install python3-venv)"; exit 1; }
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --upgrade "pip>=24"
	@PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --editable ".[test]"
	@touch $@

demo: setup
	@mkdir -p out
	$(BIN)/parapod run level --meshcat --html out/level.html --json out/level.json $(ARGS)

# For everyday work: no devices on their emulators, and no whole run of an experiment.
check: setup
	$(BIN)/python tests/run.py lint everyday$(comma)types

# All phases, whatever one of them finds, and one summary.
test: setup
	$(BIN)/python tests/run.py $(or $(PHASES),lint $(STAGES))

# With the tests that are left out of the everyday ones.
test-all: setup
	$(BIN)/python tests/run.py lint $(STAGES) slow

# The tests alone.
tests: setup
	$(BIN)/python tests/run.py $(STAGES:$(comma)types=)

# Under conditions of other computers: CONDITIONS="busy user", see tests/hard.py; not for every day.
test-hard: export ARGS := $(ARGS)
test-hard: setup
	$(BIN)/python tests/hard.py $(CONDITIONS)

lint: setup
	@$(BIN)/ruff check .; checked=$$?; $(BIN)/ruff format --check . && exit $$checked

# The folders are mapped to the package parapod by setuptools; these tools see them through links.
types: setup
	@mkdir -p build/types/parapod
	@for room in systems diagrams urdf sims; do ln -sfn ../../../$$room build/types/parapod/$$room; done
	@ln -sfn ../../../__init__.py build/types/parapod/__init__.py
	PYTHONPATH=build/types $(BIN)/lint-imports --no-logo --cache-dir build/imports
	MYPYPATH=build/types:. $(BIN)/mypy -p parapod -p benchmarks

# Once, and not by each process of the tests while the others do it too; these tell what fails.
build/compiled: $(VENV)/.installed
	@mkdir -p build
	@$(PYTEST) --collect-only --quiet > $@.part && mv $@.part $@ || true

together: build/compiled
	$(TOGETHER) $(REPORT) -m "not real_time and not slow $(if $(BESIDE),and not whole_run)" $(ARGS) || $(NONE)

everyday: build/compiled
	$(TOGETHER) $(REPORT) -m "not real_time and not slow and not whole_run" tests/laws tests/systems \
	  --ignore tests/laws/test_devices.py --ignore tests/systems/hardware

clocked: setup
	$(PYTEST) $(REPORT) -m "real_time and not slow" $(or $(ARGS),$(REAL_TIME) $(JUDGED)) || $(NONE)

whole-runs: setup
	$(PYTEST) -n 2 $(REPORT) -m "whole_run and not slow" $(or $(ARGS),$(WHOLE_RUNS)) || $(NONE)

slow: setup
	$(PYTEST) $(REPORT) -m slow $(ARGS) || $(NONE)

bench: setup
	$(BIN)/python -m benchmarks $(ARGS)

# The site: static pages that need neither a server nor a network.
docs: setup
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[docs]"
	$(BIN)/python docs/site/build.py $(ARGS)

wheel: setup
	rm -rf build/lib build/bdist.*
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist .

clean:
	rm -rf $(VENV) build dist out *.egg-info .pytest_cache .mypy_cache .ruff_cache
