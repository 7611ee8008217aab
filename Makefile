# make demo | test | lint | bench | conformance | blind | train | faults | soak | clean
#
# Needs make and a Python from 3.10 to 3.13; everything else, ROS 2 Jazzy included, comes from PyPI into .venv.
# PYTHON=python3.12 chooses the interpreter, VENV=.venv312 keeps its environment beside others,
# PIP_CONSTRAINT=FILE pins versions, WORKERS=1 runs tests one after the other, ARGS='-k name' goes to pytest or to the
# benchmarks, ARGS=stamps or ARGS=dds to the fault bench (four minutes), ARGS='tracing --count 2' to the blind studies:
# without it, recovery and tracing. That of tracing takes longer than a day on two slow cores (the 300 answers of a
# short run took 16 hours of one core); it can be interrupted. make train learns the model of tracing anew from the
# stored evidence, half an hour on two slow cores; bodies without it are simulated, 35 to 110 s of one core each.

PYTHON ?= python3
VENV ?= .venv
EXTRAS ?= all,dev
ARGS ?=
WORKERS ?= 3

BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
IN_ENVIRONMENT := $(BIN)/python -m biodyn_ros.base.environment --

# An interpreter that PYTHON names is not replaced by another.
ifeq ($(origin PYTHON),file)
CANDIDATES := $(PYTHON) python3.13 python3.12 python3.11 python3.10
else
CANDIDATES := $(PYTHON)
endif

SHELL := /bin/sh
.SHELLFLAGS := -ec

# Variables of the machine, cleared before the first Python starts; biodyn_ros.base.environment clears those of the runs.
unexport PYTHONPATH PYTHONHOME LD_LIBRARY_PATH AMENT_PREFIX_PATH COLCON_PREFIX_PATH
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport RMW_IMPLEMENTATION ROS_LOCALHOST_ONLY ROS_STATIC_PEERS ROS_DISCOVERY_SERVER
unexport FASTRTPS_DEFAULT_PROFILES_FILE FASTDDS_DEFAULT_PROFILES_FILE
# Without compiled modules every process of a test compiles all modules again.
unexport PYTHONDONTWRITEBYTECODE
# These three send pip's files elsewhere than into the environment.
unexport PIP_USER PIP_TARGET PIP_PREFIX

.PHONY: demo test lint rewritten bench conformance blind train faults soak clean
.DEFAULT_GOAL := test

demo: $(INSTALLED)
	@exec $(IN_ENVIRONMENT) biodyn demo

# glibc keeps freed memory: to return it and get it again took nearly half of the time in the system.
test: $(INSTALLED)
	@$(MAKE) --no-print-directory --jobs=2 lint rewritten
	@MALLOC_MMAP_THRESHOLD_=1073741824 MALLOC_TRIM_THRESHOLD_=1073741824 MALLOC_TOP_PAD_=67108864 \
	    exec $(IN_ENVIRONMENT) python -m pytest --numprocesses=$(WORKERS) --dist=loadfile $(ARGS)

lint: $(INSTALLED)
	@$(BIN)/python -m ruff check .
	@$(BIN)/python -m mypy

# pytest rewrites the assertions of test files and keeps their bytecode. One process does so beside lint; without it each
# worker would do all of it. An error is reported by the run itself.
rewritten: $(INSTALLED)
	@[ -d test/__pycache__ ] || $(IN_ENVIRONMENT) python -m pytest --collect-only -qq >/dev/null 2>&1 || true

bench: $(INSTALLED)
	@exec $(IN_ENVIRONMENT) python -m bench $(ARGS)

conformance: $(INSTALLED)
	@exec $(IN_ENVIRONMENT) python -m conformance

blind: $(INSTALLED)
	@exec $(IN_ENVIRONMENT) python -m blind $(ARGS)

train: $(INSTALLED)
	@exec $(IN_ENVIRONMENT) python -m blind train $(ARGS)

faults: $(INSTALLED)
	@exec $(IN_ENVIRONMENT) python -m faults $(ARGS)

soak: $(INSTALLED)
	@exec $(IN_ENVIRONMENT) python -m bench.soak $(ARGS)

clean:
	rm -rf $(VENV) build install log out *.egg-info .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# wheel comes first: without it an older pip warns of EmPy, which a newcomer can do nothing about.
$(INSTALLED): setup.py setup.cfg pyproject.toml package.xml
	@if [ -L "$(VENV)" ]; then \
	    echo "biodyn: $(VENV) is a link, and what it names would be deleted: remove the link, or use VENV=..." >&2; exit 1; \
	fi; \
	chosen=; \
	for candidate in $(CANDIDATES); do \
	    if "$$candidate" -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] < (3, 14))' 2>/dev/null; \
	    then chosen=$$candidate; break; fi; \
	done; \
	if [ -z "$$chosen" ]; then \
	    echo "biodyn: needs Python 3.10 to 3.13, and found it under none of: $(CANDIDATES); make PYTHON=... names another" >&2; \
	    exit 1; \
	fi; \
	if ! "$$chosen" -c 'import venv, ensurepip' 2>/dev/null; then \
	    echo "biodyn: $$chosen cannot make an environment: venv or ensurepip is missing; on Debian and Ubuntu: apt install python3-venv" >&2; \
	    exit 1; \
	fi; \
	echo "biodyn: making $(VENV) with $$("$$chosen" --version); this takes a few minutes" >&2; \
	"$$chosen" -m venv --clear "$(VENV)"; \
	"$(BIN)/python" -m pip install --quiet --disable-pip-version-check wheel; \
	"$(BIN)/python" -m pip install --quiet --disable-pip-version-check --editable ".[$(EXTRAS)]"; \
	"$(BIN)/biodyn" compile >&2 || echo "biodyn: the first start compiles" >&2; \
	touch "$@"
