# make setup | demo | test | fuzz | lint | bench | dist. Everything is installed from PyPI into .venv; see README.md.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
UV := $(shell command -v uv 2>/dev/null || echo build/uv/bin/uv)
STAMP := build/setup.stamp
INTERFACES := $(shell find interfaces -type f)
WHEELS := build/wheels/interfaces.stamp

.DELETE_ON_ERROR:
.PHONY: setup demo test fuzz lint bench mutants lock dist clean

setup: $(STAMP)

build/uv/bin/uv:
	$(PYTHON) -m venv build/uv
	build/uv/bin/python -m pip install --quiet --disable-pip-version-check uv

$(STAMP): pyproject.toml requirements.txt $(WHEELS)
	$(UV) venv --quiet --allow-existing --python '>=3.11,<3.15' $(VENV)
	@# The ROS wheels carry egg-infos, which a second sync would take for packages too many and remove, modules and all.
	rm -rf $(VENV)/lib/python3*/site-packages/*.egg-info
	$(UV) pip sync --quiet --compile-bytecode --python $(BIN)/python --require-hashes requirements.txt
	$(UV) pip install --quiet --python $(BIN)/python --no-deps --compile-bytecode --reinstall-package valor-interfaces build/wheels/*.whl
	$(UV) pip install --quiet --python $(BIN)/python --no-deps --editable . --editable bifrost
	@# Compiled once and not at every start of every service, even where PYTHONDONTWRITEBYTECODE is set.
	$(BIN)/python -m compileall -q bifrost services valor tests
	touch $@

# The ROS 2 message packages, compiled once. The compiler and the headers are looked for first: their absence would
# show much later, and darker.
$(WHEELS): $(INTERFACES) | $(if $(filter build/uv/bin/uv,$(UV)),build/uv/bin/uv)
	@command -v "$${CXX:-c++}" >/dev/null || \
	  { echo "make setup: no C++ compiler; the ROS 2 message packages need one (on Debian: g++)" >&2; exit 1; }
	$(UV) venv --quiet --allow-existing --python '>=3.11,<3.15' $(VENV)
	@$(BIN)/python -c "import os, sysconfig as s; exit(not os.path.exists(s.get_path('include') + '/Python.h'))" || \
	  { echo "make setup: no Python.h; the ROS 2 message packages need it (on Debian: python3-dev)" >&2; exit 1; }
	rm -rf build/wheels && mkdir -p build/wheels
	@echo "compiling the ROS 2 message packages, once: about half a minute on two cores"
	@$(UV) build --wheel --python $(BIN)/python --require-hashes \
	  --build-constraints interfaces/build-constraints.txt interfaces -o build/wheels >build/interfaces.log 2>&1 || \
	  { grep -v '^-- ' build/interfaces.log | tail -n 40 >&2; exit 1; }
	touch $@

demo: $(STAMP)
	$(BIN)/valorctl demo

# Everything that must hold: style, types, boundaries, then the tests. Those of the whole robot run one after another:
# they want the processor to themselves.
test: $(STAMP) lint
	@status=0; \
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal tests/unit tests/conformance tests/bifrost || status=1; \
	$(BIN)/python -m pytest tests/integration || status=1; \
	exit $$status

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

# The property tests with so many times the examples, other ones each time (`make fuzz FUZZ=100`). What fails is tried
# first by the next `make fuzz`, and is kept for good by an `@example`: libcst lets Hypothesis write that as a patch.
FUZZ ?= 20
fuzz: $(STAMP)
	$(UV) pip install --quiet --python $(BIN)/python --group fuzz
	OPENBLAS_NUM_THREADS=1 FUZZ=$(FUZZ) $(BIN)/python -m pytest -n 2 --dist worksteal --timeout 7200 -m hypothesis \
	  tests/unit tests/conformance tests/bifrost

# Numbers for docs/performance.md; never part of the tests.
bench: $(STAMP)
	$(UV) pip install --quiet --python $(BIN)/python --group bench
	$(BIN)/python benchmarks/ipc.py
	$(BIN)/python benchmarks/control.py
	$(BIN)/python benchmarks/standing.py
	$(BIN)/python benchmarks/pathways.py
	$(BIN)/python benchmarks/threads.py
	$(BIN)/python benchmarks/walking.py --quick

# How many wrong changes the fast tests of a package notice; packages are in pyproject.toml, `tool.mutants`.
mutants: $(STAMP)
	$(UV) pip install --quiet --python $(BIN)/python --group mutation
	OPENBLAS_NUM_THREADS=1 nice $(BIN)/python tests/mutants.py $(PACKAGE) --sample $(or $(SAMPLE),100) --seed $(or $(SEED),0)

# Versions and hashes of all that is installed, from the bounds in pyproject.toml.
lock:
	$(UV) pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-header --python-version 3.11 \
	  --no-emit-package valor-bifrost --no-emit-package valor-interfaces --group dev pyproject.toml -o requirements.txt
	$(BIN)/python -c "import tomllib; print(*tomllib.load(open('interfaces/pyproject.toml', 'rb'))['build-system']['requires'], 'cmake', 'ninja', sep='\n')" | \
	  $(UV) pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-header --no-annotate \
	  --python-version 3.11 - -o interfaces/build-constraints.txt

# Source distributions, and the wheels that they build into; that of the message packages, for .venv's Python alone, is there.
dist: $(STAMP)
	rm -rf dist
	for project in . bifrost; do $(UV) build --quiet --python $(BIN)/python $$project -o dist; done
	$(UV) build --quiet --sdist --python $(BIN)/python --require-hashes \
	  --build-constraints interfaces/build-constraints.txt interfaces -o dist
	cp $(dir $(WHEELS))*.whl dist
	$(UV) tool run --quiet --python $(BIN)/python --from 'twine>=6.1' twine check --strict dist/*.whl dist/*.tar.gz
	@du -h dist/*.whl dist/*.tar.gz

clean:
	rm -rf build dist $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis
