# Everything a contributor runs. Each target sets up what it needs first: in .venv, and where PYTHON is given in an
# environment of that interpreter's version, such as .venv-3.13.
ifeq ($(origin PYTHON), undefined)
ENVIRONMENT := .venv
else
ENVIRONMENT := .venv-$(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
endif
PYTHON ?= python3
BIN := $(ENVIRONMENT)/bin
READY := $(ENVIRONMENT)/.ready
DEMO := $(ENVIRONMENT)/.demo

.PHONY: environment demo test test-slow sentences public-names test-newest wheel-test chaos lint types docs pictures bench gate house clean

# The virtual environment: with all that a contributor needs, or at first with what the demo needs alone.
$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit("mdm needs Python 3.11 or later" if sys.version_info < (3, 11) else 0)'
	@echo 'Making a virtual environment in $(ENVIRONMENT)'
	@$(PYTHON) -m venv $(ENVIRONMENT)

$(READY): pyproject.toml mdm/version.py constraints.txt | $(BIN)/python
	@echo 'Installing what tests, lint and types need; this takes a minute or two'
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@ $(DEMO)

$(DEMO): pyproject.toml mdm/version.py constraints.txt | $(BIN)/python
	@echo 'Installing what the demo needs: numpy, scipy and a simulator of robots'
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[demo]'
	@touch $@

environment: $(READY)

demo: $(DEMO)
	@echo 'A robot patrols a floor for 40 seconds (examples/patrol/patrol.py; --help tells more)'
	@$(BIN)/python examples/patrol/patrol.py $(DEMO_OPTIONS)

# In parallel, on a worker more than there are processors, for some tests wait for other processes; those of the outer
# ring do so for a third of their time: on twice as many. For one file, call pytest itself. Hundreds of tests start a
# Python of their own: without compiled modules on disk each of them compiles the package.
PROCESSES = os.cpu_count() + 1
WORKERS = -n $$($(PYTHON) -c 'import os; print(min(8, $(PROCESSES)))') --dist worksteal
test-slow: PROCESSES = os.cpu_count() * 2
test test-slow: export PYTHONDONTWRITEBYTECODE :=

# The default ring: every behaviour, no test of more than two processor seconds. The outer ring: what is long by nature.
# OPTIONS are pytest's.
test: $(READY)
	$(BIN)/python -m pytest $(WORKERS) -m 'not slow' $(OPTIONS)
test-slow: $(READY)
	$(BIN)/python -m pytest $(WORKERS) -m slow $(OPTIONS)

# The sentences of errors that tests are told, written anew: read the change of the files. For some tests alone:
# make sentences TESTS=tests/config
TESTS ?= tests
sentences: export PYTHONDONTWRITEBYTECODE :=
sentences: $(READY)
	MDM_SENTENCES=write $(BIN)/python -m pytest $(WORKERS) $(TESTS)

# The public names with what they take, written anew: a change of this file is a line of the CHANGELOG.
public-names: $(READY)
	MDM_PUBLIC_NAMES=write $(BIN)/python -m pytest -q tests/test_reference.py

# The default ring on the newest interpreter that there is.
test-newest:
	@newest=$$(.ci/newest); if [ -n "$$newest" ]; then $(MAKE) test PYTHON="$$newest"; \
	else echo 'There is no Python beyond 3.11 to test with: python3.14, python3.13 or python3.12, on the path or under pyenv.'; fi

# Every test against the package as it is installed from a wheel, in an environment of its own, from a copy of the tests
# beside which there is no other package.
WHEEL := build/wheel
wheel-test:
	rm -rf $(WHEEL)
	$(PYTHON) -m venv $(WHEEL)/env
	$(WHEEL)/env/bin/python -m pip wheel --quiet --disable-pip-version-check --no-deps -w $(WHEEL) .
	$(WHEEL)/env/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt "$$(echo $(WHEEL)/*.whl)[dev]"
	mkdir $(WHEEL)/copy
	cp -r tests examples benchmarks docs README.md CHANGELOG.md Makefile pyproject.toml $(WHEEL)/copy
	cd $(WHEEL)/copy && ../env/bin/mdm --version && ../env/bin/pytest $(WORKERS)

# Random systems under random faults in virtual time, watched by records, pages and logs that fail, and beside circles
# without end, then teams whose agents end and come back, then robots as real processes that get signals, two at a time; then
# teams that are sent forged messages; then all that may happen, in a few steps, to three ensembles above each other;
# then patrols of random floors, which must go on; then
# random schedules of what happens to a team's agreement; then random systems in wall time, which are recorded and
# replayed; then damaged records, which are read; then hours of many robots on a floor; then days of the demo, 6 minutes of a processor each; then
# goals, disturbances and a patrol beside real nodes of ROS 2.
# Violations are printed with their seeds.
MDM_CHAOS ?= 100000
MDM_CHAOS_PROCESSES ?= 1000
MDM_FORGED ?= 200000
MDM_LADDER ?= 20000
MDM_PATROLS ?= 2000
MDM_SCHEDULES ?= 100000
MDM_REPLAYS ?= 1000
MDM_DAMAGED ?= 10000
MDM_CROWDS ?= 3600
MDM_DAYS ?= 20
MDM_PURSUITS ?= 1000
MDM_ROS_SCHEDULES ?= 500
chaos: $(READY)
	PYTHONPATH=tests $(BIN)/python -m chaos $(MDM_CHAOS) $(MDM_CHAOS_PROCESSES)
	PYTHONPATH=tests $(BIN)/python -m team.forgery $(MDM_FORGED)
	PYTHONPATH=tests $(BIN)/python -m ladder $(MDM_LADDER)
	PYTHONPATH=tests $(BIN)/python -m patrols $(MDM_PATROLS)
	PYTHONPATH=tests $(BIN)/python -m team.schedules $(MDM_SCHEDULES)
	PYTHONPATH=tests $(BIN)/python -m replay $(MDM_REPLAYS)
	PYTHONPATH=tests $(BIN)/python -m damage $(MDM_DAMAGED)
	PYTHONPATH=tests $(BIN)/python -m crowds $(MDM_CROWDS)
	PYTHONPATH=tests $(BIN)/python -m days $(MDM_DAYS)
	PYTHONPATH=tests $(BIN)/python -m ros2.pursuits $(MDM_PURSUITS)
	PYTHONPATH=tests $(BIN)/python -m ros2.schedules $(MDM_ROS_SCHEDULES)
	PYTHONPATH=tests $(BIN)/python -m ros2.patrol 120

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(READY)
	$(BIN)/mypy

docs: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	$(BIN)/sphinx-build -W -b html docs docs/_build/html

# The pictures of the tutorial, drawn anew from what its programs do: look at them.
pictures: $(READY)
	$(BIN)/python docs/pictures/tutorial.py

gate: $(READY)
	$(BIN)/python benchmarks/gate.py

house: $(READY)
	$(BIN)/python tests/house.py

bench: $(READY)
	$(BIN)/python benchmarks/decision_latency.py
	$(BIN)/python benchmarks/ticks.py
	$(BIN)/python benchmarks/recording.py
	$(BIN)/python benchmarks/startup.py
	$(BIN)/python benchmarks/parse.py
	$(BIN)/python benchmarks/simulation.py
	$(BIN)/python benchmarks/belief.py
	$(BIN)/python benchmarks/policy.py
	$(BIN)/python benchmarks/monitors.py
	$(BIN)/python benchmarks/sarsop.py
	$(BIN)/python benchmarks/solvers.py
	$(BIN)/python benchmarks/verification.py
	$(BIN)/python benchmarks/tree_search.py
	$(BIN)/python benchmarks/communication.py
	$(BIN)/python benchmarks/places.py
	$(BIN)/python benchmarks/maps.py
	$(BIN)/python benchmarks/building.py
	$(BIN)/python benchmarks/ros2.py
	$(BIN)/python benchmarks/team_bridge.py
	$(BIN)/python benchmarks/team_latency.py
	$(BIN)/python benchmarks/team_memory.py
	$(BIN)/python benchmarks/team_radio.py

clean:
	rm -rf .venv .venv-* build dist docs/_build .mypy_cache .ruff_cache .pytest_cache .hypothesis
