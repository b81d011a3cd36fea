# Set-up and checks. `make help` lists the targets; only Python 3.11 or newer is needed beforehand.
#
# The environment lives in .venv and is made by the targets that need it: again when the
# interpreter, pyproject.toml or a lock file in requirements/ has changed, and not otherwise.

SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: help demo format check test-fast test fuzz verify kill docs benchmark lock clean FORCE

# `make test PYTHON=/path/to/python3` chooses another interpreter.
ifndef PYTHON
PYTHON := $(shell for p in python3.11 python3 python3.12 python3.13 python3.14; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && { echo "$$p"; exit; }; \
	done; echo python3)
endif
VENV := .venv
BIN := $(VENV)/bin
# Arguments for pytest: `make test PYTEST_ARGS='-k pendulum'`.
PYTEST_ARGS ?=
# Number of processes that share the tests; each process takes about 2 GB of memory.
TEST_PROCESSES ?= 2
# Number of inputs that `make fuzz` tries.
FUZZ_INPUTS ?= 1000000
# Number of random problems that `make verify` compares with brute force.
VERIFY_PROBLEMS ?= 5000
# Number of kills that `make kill` tries.
KILLS ?= 1000
# Arguments for `swerve demo`.
DEMO_ARGS ?=
# Arguments for the resolver: `make lock LOCK_ARGS=--upgrade` takes the newest releases.
LOCK_ARGS ?=

PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input -qq
LOCKED := $(PIP) install --require-hashes --only-binary :all: -r

# Folders and files that `make test-fast` leaves out, beside the tests marked slow: nearly all of their
# tests learn or sample. The rest takes about 170 s of processor time, shared by the processes.
SLOW_TESTS := benchmarks fuzz brute_force cli demonstrators fitting kill monitoring reproduce sampling solvers whole work \
	evidence/test_at_beta.py evidence/test_stored_before.py

# Most of the time of the tests goes into compiling, and this way of XLA compiles sooner; the numbers
# are the same but for rounding. `make verify` and `make kill` compile as users do.
test test-fast: export XLA_FLAGS := --xla_cpu_use_fusion_emitters=false $(XLA_FLAGS)

# Silences the advertisement that mkdocs-material prints for MkDocs 2; it is not a warning of ours.
export NO_MKDOCS_2_WARNING := 1

# A recipe between BEGIN and END goes on after a failure, so that one call shows all failures.
BEGIN := failed=; run() { echo "==> $$*"; $(BIN)/python -m "$$@" || failed="$$failed $$1"; };
STYLE_AND_TYPES := run ruff check .; run ruff format --check .; run pyright;
DOCS := run mkdocs build --strict;
# The processes take the files in their order: by default those with few tests, which are the long
# ones, would come last, and one process would wait for the other.
PYTEST := run pytest --numprocesses $(TEST_PROCESSES) --dist loadfile --no-loadscope-reorder
END := if [ -n "$$failed" ]; then echo "==> failed:$$failed" >&2; exit 1; fi

help:  ## List the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*##/\t/' | expand -t 12

demo: $(VENV)/runtime.stamp  ## Run the quick start: infer a constraint from bundled demonstrations
	@$(BIN)/swerve demo $(DEMO_ARGS)

format: $(VENV)/dev.stamp  ## Format the code and mend what ruff can mend
	@$(BEGIN) run ruff check --fix .; run ruff format .; $(END)

check: $(VENV)/dev.stamp  ## Check style and types
	@$(BEGIN) $(STYLE_AND_TYPES) $(END)

test-fast: $(VENV)/dev.stamp  ## Run the tests that are quick, in under two minutes
	@$(BEGIN) $(PYTEST) -m "not slow" $(SLOW_TESTS:%=--ignore=tests/%) $(PYTEST_ARGS); $(END)

test: $(VENV)/dev.stamp  ## Check style, types, documentation and behaviour; all failures are shown
	@$(BEGIN) $(STYLE_AND_TYPES) $(DOCS) $(PYTEST) $(PYTEST_ARGS); $(END)

fuzz: $(VENV)/dev.stamp  ## Try a million inputs that others might send: files, streams and settings
	@PYTHONPATH=tests $(BIN)/python -m fuzz --inputs $(FUZZ_INPUTS) --processes $(TEST_PROCESSES)

verify: $(VENV)/dev.stamp  ## Compare every public number with brute force on 5,000 random problems
	@SWERVE_BRUTE_FORCE=$(VERIFY_PROBLEMS) $(BIN)/python -m pytest tests/brute_force --verbose \
		--numprocesses $(TEST_PROCESSES) --dist load $(PYTEST_ARGS)

kill: $(VENV)/dev.stamp  ## Kill 1,000 times, at every file operation and at random moments: nothing is lost
	@SWERVE_KILLS=$(KILLS) $(BIN)/python -m pytest tests/kill --verbose \
		--numprocesses $(TEST_PROCESSES) --dist load $(PYTEST_ARGS)

docs: $(VENV)/dev.stamp  ## Build the documentation into site/; a warning is an error
	@$(BEGIN) $(DOCS) $(END)
	@echo "the documentation is in site/index.html"

benchmark: $(VENV)/benchmark.stamp  ## Set up what benchmarks/ compares with (torch, Stable-Baselines3)
	@echo "ready; for instance: $(BIN)/python benchmarks/stable_baselines.py"

clean:  ## Remove the environment and everything that is built
	rm -rf $(VENV) $(LOCK_VENV) build dist site .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# -- the environment ---------------------------------------------------------------------------

# Changes, and so makes everything below again, when an existing .venv would be of no use: another
# Python, or a repository that was moved. The base interpreter makes the environment, because the
# one found first may be that of the .venv which is about to be replaced.
$(VENV)/interpreter: FORCE
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
		echo "Swerve needs Python 3.11 or newer; $(PYTHON) is" \
			"$$("$(PYTHON)" -c 'import sys; print("Python", sys.version.split()[0])' 2>/dev/null || echo "not there")." \
			"Name one that is: make $(MAKECMDGOALS) PYTHON=/path/to/python3.11" >&2; exit 1; }
	@id=$$("$(PYTHON)" -c 'import os, sys; print(sys.version.split()[0], sys.base_prefix, os.getcwd())'); \
	if [ "$$(cat $@ 2>/dev/null)" != "$$id" ]; then \
		base=$$("$(PYTHON)" -c 'import sys; print(sys._base_executable)'); \
		echo "==> Creating $(VENV) with $$base"; \
		rm -rf $(VENV); \
		"$$base" -m venv $(VENV) || { rm -rf $(VENV); \
			echo "$$base cannot create environments; on Debian and Ubuntu install python3-venv" >&2; exit 1; }; \
		echo "$$id" > $@; \
	fi

$(VENV)/runtime.stamp: requirements/runtime.txt pyproject.toml $(VENV)/interpreter
	@echo "==> Installing Swerve and what it runs on (a minute or two; 1 GB on disk)"
	@$(LOCKED) $<
	@$(PIP) install --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/dev.stamp: requirements/dev.txt $(VENV)/runtime.stamp
	@echo "==> Installing the tools for tests and documentation"
	@$(LOCKED) $<
	@touch $@

# The lock holds no CUDA packages, so that pip stops instead of fetching gigabytes that a benchmark
# on the CPU does not use.
$(VENV)/benchmark.stamp: requirements/benchmark.txt $(VENV)/runtime.stamp
	@echo "==> Installing torch (CPU build) and Stable-Baselines3"
	@$(LOCKED) $< || { printf '%s\n' \
		"" \
		"The lock is for torch's CPU build. On Linux that is not on the default index: either set" \
		"PIP_EXTRA_INDEX_URL to the CPU index that torch's installation page names (x86-64, Python 3.11)," \
		"or take the default build, unlocked and with several GB of CUDA packages:" \
		"    $(BIN)/python -m pip install '.[benchmark]'" >&2; exit 1; }
	@touch $@

# -- the lock files ----------------------------------------------------------------------------

LOCK_VENV := .lock-venv
UV_VERSION := 0.13.9
# torch 2.13.0+cpu for CPython 3.11 on Linux x86-64, which the default index does not list.
TORCH_CPU_HASH := 6746dbcbeb526eb61330b76b41ff1b4eb848951103a892eeb080dfa2b264667b
# One version of each package for every Python from 3.11 on; wheels alone, with their hashes.
COMPILE := $(LOCK_VENV)/bin/uv pip compile --no-config --quiet --python-version 3.11 \
	--generate-hashes --only-binary :all: --no-emit-package pip \
	--custom-compile-command "make lock" $(LOCK_ARGS)
UNIVERSAL := $(COMPILE) --universal --fork-strategy fewest

lock: $(VENV)/interpreter  ## Resolve pyproject.toml into requirements/*.txt again
	@echo "==> Installing uv $(UV_VERSION) into $(LOCK_VENV)"
	@$(BIN)/python -m venv $(LOCK_VENV)
	@$(LOCK_VENV)/bin/python -m pip --disable-pip-version-check -qq install uv==$(UV_VERSION)
	@echo "==> Resolving requirements/runtime.txt, dev.txt and benchmark.txt"
	@$(UNIVERSAL) pyproject.toml requirements/build.in -o requirements/runtime.txt
	@$(UNIVERSAL) pyproject.toml requirements/build.in --extra control --extra dev --extra docs \
		-c requirements/runtime.txt -o requirements/dev.txt
	@# Resolved as if for macOS, where torch has no CUDA dependencies to leave out; then torch is
	@# split into the CPU build for Linux on x86-64 and the default one for the rest.
	@rm -f requirements/benchmark.txt
	@MACOSX_DEPLOYMENT_TARGET=14.0 $(COMPILE) --python-platform aarch64-apple-darwin pyproject.toml requirements/build.in \
		requirements/benchmark.in --extra benchmark -c requirements/dev.txt -o requirements/benchmark.txt
	@awk '/^torch==/ { \
			cpu = "sys_platform == \"linux\" and platform_machine == \"x86_64\""; \
			rest = "sys_platform != \"linux\" or platform_machine != \"x86_64\""; \
			print $$1 "+cpu ; " cpu " \\\n    --hash=sha256:$(TORCH_CPU_HASH)"; \
			print $$1 " ; " rest " \\"; next \
		} { print }' requirements/benchmark.txt > requirements/benchmark.tmp
	@mv requirements/benchmark.tmp requirements/benchmark.txt
	@rm -rf $(LOCK_VENV)
