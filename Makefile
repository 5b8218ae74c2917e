# `make run` and `make test` need only python3.11 (or newer), venv and make; nothing else is assumed.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV   := .venv
BIN    := $(VENV)/bin
TYPES  := build/types
ADAPTERS := build/adapters

unexport PYTHONDONTWRITEBYTECODE  # tests start hundreds of processes: each would compile all it imports

.DEFAULT_GOAL := help
.PHONY: help setup run test test-long review test-live test-adapters test-browser peers attacks hostile lint lock proto docs mutants hashes bench
.PHONY: bench-compiled wheel client

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

setup: $(VENV)/.installed $(VENV)/.native  ## make .venv from the hashed lock file (again only when it changes)

$(VENV)/.installed: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "hil needs Python 3.11 or newer; found $$($(PYTHON) --version)"; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "installing pinned packages (about a minute the first time)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

# The stage in C, where there is a compiler: without it all computes the same in Python.
$(VENV)/.native: $(VENV)/.installed $(wildcard sim_plant/native/*)
	@$(BIN)/python -m sim_plant.native || true
	@touch $@

run: setup  ## run the microscope rig on an emulated stage, live, about 20 s
	@$(BIN)/hil demo deploy/rigs/microscope.toml

test: setup  ## unit tests, and the whole loop in virtual time (about three minutes)
	@$(BIN)/python -m pytest -n 2 --dist worksteal -m "not long and not live and not slow and not vcan and not controller"

test-long: setup  ## those that take a second or more, two minutes in all; SLICE=4: one in four, drawn by the commit
	@$(BIN)/python -m pytest -n 2 --dist worksteal -m "long and not live and not slow and not vcan and not controller" --slice $(or $(SLICE),1)

review: setup  ## what the goldens of tests/golden would change: of all rooms, or `make review ROOM`
	@$(BIN)/python -m tests.golden $(ROOM)

ifeq (review,$(firstword $(MAKECMDGOALS)))  # the words behind it are a room, not goals
ROOM := $(wordlist 2,9,$(MAKECMDGOALS))
$(ROOM): review
	@:
endif

test-live: setup  ## the same as real processes on the local bus: started, killed, watched (about two minutes)
	@$(BIN)/python -m pytest -n 2 --dist worksteal -m "live and not slow and not vcan and not controller" $(ARGS)

# Their packages are large: they come into an environment of their own, on top of ours.
test-adapters: $(ADAPTERS)/.installed  ## Micro-Manager's and Bluesky's devices on an emulated rig (a minute, most of it to install)
	@$(ADAPTERS)/bin/python -m pytest -m "not slow" tests/adapters $(ARGS)

$(ADAPTERS)/.installed: $(VENV)/.native tests/adapters/requirements.lock
	@$(PYTHON) -m venv $(ADAPTERS)
	@$(ADAPTERS)/bin/python -c "import sys, sysconfig; print(sys.argv[1], file=open(sysconfig.get_path('purelib') + '/ours.pth', 'w'))" \
	    "$$($(BIN)/python -c "import sysconfig; print(sysconfig.get_path('purelib'))")"
	@$(ADAPTERS)/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r tests/adapters/requirements.lock
	@$(ADAPTERS)/bin/python -m sim_plant.native || true
	@touch $@
test-browser: setup  ## the page in Chromium and Firefox, with pictures in build/browser (those installed; not in .ci/run)
	@$(BIN)/python -m pytest -m browser tests/page $(ARGS)

peers: setup  ## peers' own tests and readers against ours; ARGS="--few", FILES=FOLDER; not in .ci/run as a whole
	@$(BIN)/python -m tests.peers $(ARGS) $(if $(FILES),--files $(FILES))

attacks: setup  ## try every attack on a live rig: commands, goals, Zenoh, files, processes (needs root; about six minutes)
	@$(BIN)/python -m tests.attacks attacks.json

hostile: setup  ## commands on full disks, with closed streams, early signals, as other users; MINUTES=600: all of it
	@$(BIN)/python -m tests.hostile --minutes $(or $(MINUTES),2.5) $(ARGS)

lint: setup $(TYPES)/.installed  ## ruff, mypy --strict, prose, commit messages; users' programs as mypy and pyright see them
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/python -m tests.project.prose
	@$(BIN)/python -m tests.users
	@$(BIN)/python -m tests.project.commit_messages

$(TYPES)/.installed: tests/users/requirements.lock
	@$(PYTHON) -m venv $(TYPES)
	@$(TYPES)/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r $<
	@touch $@

lock:  ## renew the lock files and the wheel's SBOM (needs uv)
	uv pip compile pyproject.toml $(foreach name,dashboard cluster bench dev,--extra $(name)) --universal --python-version 3.11 --generate-hashes \
	    --no-annotate --custom-compile-command "make lock" -q -o requirements.lock
	uv pip compile tests/mutation/requirements.in -c requirements.lock --universal --python-version 3.11 \
	    --generate-hashes --no-annotate --custom-compile-command "make lock" -q \
	    -o tests/mutation/requirements.lock
	uv pip compile deploy/site/requirements.in -c requirements.lock --universal --python-version 3.11 \
	    --generate-hashes --no-annotate --custom-compile-command "make lock" -q -o deploy/site/requirements.lock
	uv pip compile tests/users/requirements.in -c requirements.lock --universal --python-version 3.11 \
	    --generate-hashes --no-annotate --custom-compile-command "make lock" -q \
	    -o tests/users/requirements.lock
	grep -E '^[a-zA-Z].*==' requirements.lock | grep -vE '^(fsspec|python-dateutil)==' | sed 's/ *\\$$//' > build/constraints.txt
	uv pip compile tests/adapters/requirements.in -c build/constraints.txt --universal --python-version 3.11 \
	    --generate-hashes --no-annotate --custom-compile-command "make lock" -q -o tests/adapters/requirements.lock
	uv pip compile tests/peers/requirements.in -c build/constraints.txt --universal --python-version 3.11 \
	    --generate-hashes --no-annotate --custom-compile-command "make lock" -q \
	    $(foreach name,$(shell sed -nE 's/^([a-zA-Z][^=]*)==.*/\1/p' requirements.lock),--no-emit-package $(name)) -o tests/peers/requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m deploy.wheel.sbom

include deploy/vm/vm.mk
include deploy/package.mk
include deploy/compiled.mk

proto: setup  ## renew the generated protobuf module
	@$(BIN)/python -m grpc_tools.protoc --proto_path=. --python_out=. --pyi_out=. hil/telemetry/telemetry.proto hil/telemetry/events.proto

docs: setup  ## renew the pages that are made from code, and build the site into build/site
	@$(BIN)/python -m docs.make_fault_numbers
	@$(BIN)/python -m docs.make_pages
	@$(BIN)/python -m docs.pictures
	@$(BIN)/python -c "import material" 2>/dev/null || \
	    $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r deploy/site/requirements.lock
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict -f deploy/site/mkdocs.yml
	@echo "site: build/site/index.html"

mutants: setup  ## every mutant of gate and state machine; ARGS="--count 100": a random sample of all rooms, or --help
	@$(if $(ARGS),$(BIN)/python -m tests.mutation $(ARGS),tests/mutation/mutants.sh)

hashes: setup  ## a run of TICKS (10^6) has one hash: idle, loaded, other hash seeds, old processors, Python 3.11 to 3.13
	@$(BIN)/python -m tests.support.hashes --everywhere --build --ticks $(or $(TICKS),1000000) --runs "$(or $(RUNS),microscope)"

bench: setup  ## a benchmark: ARGS="tick --json FILE"; without ARGS, their list. bench-compiled: of the compiled build
	@$(BIN)/python -m tests.benchmarks $(or $(ARGS),--help)

bench-compiled: setup compiled
	@PYTHONSAFEPATH=1 $(COMPILED)/bin/python -m tests.benchmarks $(or $(ARGS),--help)

client: setup  ## dist/hil_client-VERSION-py3-none-any.whl: what other machines watch and move rigs with
	@$(BIN)/python -m deploy.client.build dist

wheel: setup  ## dist/hil-VERSION-py3-none-any.whl and the sdist; HIL_COMPILED=1: the wheel of this platform, compiled
	@$(BIN)/python -m hatchling build -d dist
