# `make run` and `make test` need only python3.11 (or newer), venv and make; nothing else is assumed.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV   := .venv
BIN    := $(VENV)/bin

.DEFAULT_GOAL := help
.PHONY: help setup run test test-live attacks lint lock proto docs mutants hashes bench bench-compiled wheel

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

setup: $(VENV)/.installed  ## make .venv from the hashed lock file (again only when it changes)

$(VENV)/.installed: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "hil needs Python 3.11 or newer; found $$($(PYTHON) --version)"; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "installing pinned packages (about a minute the first time)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

run: setup  ## run the microscope rig on an emulated stage, live, about 20 s
	@$(BIN)/hil demo deploy/rigs/microscope.toml

test: setup  ## unit tests, and the whole loop in virtual time (about four minutes)
	@$(BIN)/python -m pytest -n 2 --dist worksteal -m "not live and not slow and not vcan and not controller"

test-live: setup  ## the same as real processes on the local bus: started, killed, watched (about two minutes)
	@$(BIN)/python -m pytest -n 2 --dist worksteal -m "live and not slow and not vcan and not controller"

attacks: setup  ## try every attack on a live rig: commands, Zenoh, files, processes (needs root; about five minutes)
	@$(BIN)/python -m tests.attacks attacks.json

lint: setup  ## ruff and mypy --strict
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

lock:  ## renew the lock files (needs uv)
	uv pip compile pyproject.toml --all-extras --universal --python-version 3.11 --generate-hashes \
	    --no-annotate --custom-compile-command "make lock" -q -o requirements.lock
	uv pip compile tests/mutation/requirements.in -c requirements.lock --universal --python-version 3.11 \
	    --generate-hashes --no-annotate --custom-compile-command "make lock" -q \
	    -o tests/mutation/requirements.lock

include deploy/vm/vm.mk
include deploy/package.mk
include deploy/compiled.mk

proto: setup  ## renew the generated protobuf module
	@$(BIN)/python -m grpc_tools.protoc --proto_path=. --python_out=. --pyi_out=. hil/telemetry/telemetry.proto hil/telemetry/events.proto

docs: setup  ## renew the pages that are made from tables in code
	@$(BIN)/python -m docs.make_pages

mutants: setup  ## every mutant of gate and state machine; ARGS="--count 100": a random sample of all rooms, or --help
	@$(if $(ARGS),$(BIN)/python -m tests.mutation $(ARGS),tests/mutation/mutants.sh)

hashes: setup  ## a run of TICKS (10^6) has one hash: idle, loaded, other hash seeds, old processors, Python 3.11 to 3.13
	@$(BIN)/python -m tests.support.hashes --everywhere --build --ticks $(or $(TICKS),1000000) --runs "$(or $(RUNS),microscope)"

bench: setup  ## a benchmark: ARGS="tick --json FILE"; without ARGS, their list. bench-compiled: of the compiled build
	@$(BIN)/python -m tests.benchmarks $(or $(ARGS),--help)

bench-compiled: setup compiled
	@PYTHONSAFEPATH=1 $(COMPILED)/bin/python -m tests.benchmarks $(or $(ARGS),--help)

wheel: setup  ## dist/hil-VERSION-py3-none-any.whl and the sdist; HIL_COMPILED=1: the wheel of this platform, compiled
	@$(BIN)/python -m hatchling build -d dist
