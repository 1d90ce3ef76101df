# Every command of the project. `make drive` and `make test` need nothing but Python and a network at their first call;
# later calls find .venv ready and start at once.

# The first of these that runs, is new enough and can make virtual environments; `make test PYTHON=python3.12` chooses.
CANDIDATES := python3.12 python3.11 python3 python3.13 python3.14 python
SUITABLE := import sys, ensurepip, venv; sys.exit(sys.version_info < (3, 11))
PYTHON ?= $(firstword $(foreach name,$(CANDIDATES),$(shell $(name) -c '$(SUITABLE)' 2>/dev/null && echo $(name))))

VENV := .venv
RUN := $(VENV)/bin
WORKERS ?= 2
# pip shows what it downloads: the first installation takes minutes.
INSTALL = $(RUN)/python -m pip install --disable-pip-version-check --constraint constraints.txt --editable
# One thread per process: the tests already use every core, and linear algebra here is small.
# A process that dies fails the run at once: with a new one in its place pytest-xdist can wait forever.
# Files are started in the order of tests/conftest.py: the longest first.
PYTEST = OPENBLAS_NUM_THREADS=1 $(RUN)/python -m pytest --numprocesses $(WORKERS) --dist loadfile \
         --no-loadscope-reorder --max-worker-restart 0
ARGS ?=

.PHONY: help drive notebooks test quick test-all times check lint fuzz docs bench clean

help:
	@echo "make drive     drive a Chevrolet Bolt one lap of the test track (ARGS='--set duration=20' for options)"
	@echo "make notebooks JupyterLab with the notebooks (ARGS=--no-browser for options)"
	@echo "make test      the fast tests (about 9 min on 2 cores)"
	@echo "make quick     the tests that take about a minute together, for each small change"
	@echo "make test-all  all tests"
	@echo "make check     formatting, lint, types and the fast tests"
	@echo "make lint      formatting, lint and types"
	@echo "make times     the fast tests; records their processor times in tests/times.json"
	@echo "make fuzz      10 000 mutated files of every format through the commands (ARGS='--cases 500 --seed 1')"
	@echo "make docs      the documentation site, into build/site/; runs all notebooks (about 5 min)"
	@echo "make bench     benchmarks against other simulators (ARGS=... for options)"
	@echo "make clean     remove .venv, builds and caches; runs/ stays"
	@echo "PYTHON=python3.12 chooses the Python of .venv, WORKERS=4 the number of test processes"

drive: $(VENV)/ready
	$(RUN)/mirdrake run bolt_test_track $(ARGS)

# With these settings running the notebooks changes nothing in Git.
notebooks: $(VENV)/ready-notebooks
	$(RUN)/jupyter-lab --config=notebooks/jupyter_server_config.py notebooks $(ARGS)

test: $(VENV)/ready-dev
	$(PYTEST) $(ARGS)

quick: $(VENV)/ready-dev
	$(PYTEST) --quick $(ARGS)

times: $(VENV)/ready-dev
	$(PYTEST) --times tests/times.json $(ARGS)

test-all: $(VENV)/ready-dev
	$(PYTEST) -m "slow or not slow" $(ARGS)

check: lint test

lint: $(VENV)/ready-dev
	$(RUN)/ruff format --check .
	$(RUN)/ruff check .
	$(RUN)/mypy

fuzz: $(VENV)/ready-dev
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(RUN)/python -m tests.fuzz_files $(ARGS)

docs: $(VENV)/ready-docs
	OPENBLAS_NUM_THREADS=1 $(RUN)/python -m tools.site build/site $(ARGS)
	@echo "build/site/index.html"

bench: $(VENV)/ready-bench
	OPENBLAS_NUM_THREADS=1 $(RUN)/python benchmarks/run.py $(ARGS)

clean:
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(RUN)/pip:
	@test -n "$(strip $(PYTHON))" || { \
	  echo "error: no Python 3.11 or newer with venv and pip found; install one (Debian: apt install python3 python3-venv)" \
	       "or name it: make PYTHON=/path/to/python3" >&2; exit 1; }
	@$(PYTHON) -c '$(SUITABLE)' 2>/dev/null || { \
	  echo "error: $(PYTHON) is not Python 3.11 or newer with venv and pip; choose another: make PYTHON=python3.12" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/ready: pyproject.toml constraints.txt | $(RUN)/pip
	$(INSTALL) .
	@touch $@

$(VENV)/ready-notebooks: pyproject.toml constraints.txt | $(RUN)/pip
	$(INSTALL) '.[drawing,notebook,tuning]' jupyterlab
	@touch $@ $(VENV)/ready

$(VENV)/ready-dev: pyproject.toml constraints.txt | $(RUN)/pip
	$(INSTALL) '.[dev]'
	@touch $@ $(VENV)/ready

$(VENV)/ready-docs: pyproject.toml constraints.txt | $(RUN)/pip
	$(INSTALL) '.[docs]'
	@touch $@ $(VENV)/ready

$(VENV)/ready-bench: pyproject.toml constraints.txt | $(RUN)/pip
	$(INSTALL) '.[bench]'
	@touch $@ $(VENV)/ready
