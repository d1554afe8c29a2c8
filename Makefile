# make compare: set up, then let the IK expert, the PPO agent and random actions meet the same 200 episodes, of the test seed.
# make test:    set up with everything, then run the quick tests; make test-all: the slow ones too; make test-thorough: thousands of trials.
# make check:   lint, format, types, spelling. make lock: after a change of dependencies. make dist: sdist and wheel.
# make mutants: plant faults in the statistics and the verdict, one at a time, and list those that no quick test notices: hours.
# make coverage: the share of the lines and branches of stats and verdict that the quick tests of statistics, verdicts and studies run: at least 98 %.
# make docs:    the documentation as a site, in site/; make docs-serve: the same in the browser, while you write.
# For some of the tests: make test ARGS="tests/kinematics -k jacobian"

PYTHON ?= python3
# Where this is set, each start of armctl compiles all that it imports, and takes twice as long.
unexport PYTHONDONTWRITEBYTECODE
VENV := .venv
BIN := $(VENV)/bin
# uv installs in less than half of pip's time. It reads none of pip's settings; these two name where packages are, such as a mirror.
ifdef PIP_INDEX_URL
export UV_DEFAULT_INDEX ?= $(PIP_INDEX_URL)
endif
ifdef PIP_FIND_LINKS
export UV_FIND_LINKS ?= $(PIP_FIND_LINKS)
endif
UV := $(BIN)/uv
INSTALL := VIRTUAL_ENV=$(VENV) $(UV) pip install
LOCKED := --constraint constraints.txt
# Three at once on two cores, and four of all tests: they often wait, for the disk and for what they have started.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses 3 --dist worksteal
# Tests of what is measured: a third slower so, hence without those that kill, fill disks and reproduce.
COVERED := tests/stats tests/verdict tests/report/test_tables.py $(patsubst %,tests/study/test_%.py, \
  compare groups pairs sample_size spared suite sweep sweep_by_return task_verdict until_decided worst_case)
MKDOCS := NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs
# It asks for Gymnasium 0.29, and so cannot be resolved beside armctl; what examples/ use of it works with newer ones.
IMITATION := imitation==1.0.1
# It asks for Python before 3.11, and is run with newer libraries, unchanged, in examples/cleanrl_unmodified.py.
CLEANRL := cleanrl==1.2.0
# LeRobot's own reader, with which the tests read what armctl writes. It asks for older versions of much that armctl needs, so it is
# beside the other packages, not among them.
LEROBOT := lerobot==0.4.4 torchvision==0.25.0 accelerate==1.15.0 safetensors==0.8.0
EXPORT := $(UV) --quiet export --frozen --all-extras --no-emit-project --no-hashes --no-annotate

.PHONY: compare test test-all test-uncovered test-thorough coverage mutants check docs docs-serve lock check-lock dist benchmarks clean

compare: $(VENV)/core
	$(BIN)/armctl compare --seed test

test: $(VENV)/full
	$(PYTEST) $(ARGS)

test-all: $(VENV)/full
	$(PYTEST) --numprocesses 4 --all $(ARGS)

# In CI, beside `make coverage ARGS=--all`, which runs the others.
test-uncovered: $(VENV)/full
	$(PYTEST) --numprocesses 4 --all $(addprefix --ignore=,$(COVERED)) $(ARGS)

test-thorough: $(VENV)/full
	$(PYTEST) --all --thorough -m thorough -o faulthandler_timeout=0 $(ARGS)

coverage: $(VENV)/full
	OMP_NUM_THREADS=1 $(BIN)/coverage run -m pytest -q $(COVERED) $(ARGS)
	$(BIN)/coverage report

mutants: $(VENV)/full
	@$(INSTALL) --quiet $(LOCKED) mutmut==3.8.1
	OMP_NUM_THREADS=1 $(BIN)/mutmut run --max-children 2 $(ARGS)
	$(BIN)/mutmut results

check: $(VENV)/full
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/codespell src rl baselines docs README.md CONTRIBUTING.md CHANGELOG.md

docs: $(VENV)/full
	$(MKDOCS) build --strict

docs-serve: $(VENV)/full
	$(MKDOCS) serve

lock: $(VENV)/python
	$(UV) --quiet lock
	$(EXPORT) > constraints.txt

check-lock: $(VENV)/python
	@$(UV) --quiet lock --check || { echo "uv.lock is not what pyproject.toml asks for: make lock"; exit 1; }
	@$(EXPORT) | diff constraints.txt - || { echo "constraints.txt is not what uv.lock says: make lock"; exit 1; }

dist: $(VENV)/python
	rm -rf dist
	$(UV) --quiet build --python $(BIN)/python

benchmarks: $(VENV)/full
	$(BIN)/python benchmarks/throughput.py
	$(BIN)/python benchmarks/throughput.py --env armctl/BridgeCross-v0
	$(BIN)/python benchmarks/limits.py
	$(BIN)/python benchmarks/physics_step.py
	$(BIN)/python benchmarks/ik.py
	$(BIN)/python benchmarks/planning.py
	$(BIN)/python benchmarks/mpc.py
	$(BIN)/python benchmarks/drive_mpc.py
	$(BIN)/python benchmarks/optimality.py
	$(BIN)/python benchmarks/arm_planning.py
	$(BIN)/python benchmarks/capsules.py
	$(BIN)/python benchmarks/workers.py
	$(BIN)/python benchmarks/learners.py

clean:
	rm -rf $(VENV) build dist site *.egg-info src/*.egg-info

$(VENV)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "armctl needs Python 3.11 or newer as '$(PYTHON)'; name another one: make PYTHON=python3.12"; exit 1; }
	@$(PYTHON) -m venv $(VENV) || \
	  { rm -rf $(VENV); echo "'$(PYTHON) -m venv' failed; on Debian or Ubuntu: apt-get install python3-venv"; exit 1; }
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check uv==0.13.9 || \
	  { rm -rf $(VENV); echo "The installation of uv failed: see above."; exit 1; }
	@touch $@

$(VENV)/core: pyproject.toml constraints.txt | $(VENV)/python
	@echo "Installing armctl into $(VENV) ..."
	@$(INSTALL) $(LOCKED) --editable . || { echo "The installation failed: see above; it needs a package index and about 2 GB."; exit 1; }
	@touch $@

$(VENV)/full: pyproject.toml constraints.txt | $(VENV)/python
	@echo "Installing armctl with all extras into $(VENV) ..."
	@$(INSTALL) $(LOCKED) --editable '.[rl,dev]' || { echo "The installation failed: see above; it needs a package index and up to 9 GB."; exit 1; }
	@$(INSTALL) --quiet $(LOCKED) --no-deps $(IMITATION)
	@$(INSTALL) --quiet $(LOCKED) --no-deps --python-version 3.10 $(CLEANRL)
	@$(INSTALL) --quiet --no-deps --target $(VENV)/lerobot $(LEROBOT)
	@touch $@ $(VENV)/core
