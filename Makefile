# Every target sets up what it needs, from a machine with Python >= 3.11 only.
VENV := .venv
BIN := $(VENV)/bin
RESULTS := results
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
UV := $(BIN)/uv pip install --quiet --python $(BIN)/python
# uv takes a third of pip's time; where it is not to be had, or fails, pip goes on
install = { test -x $(BIN)/uv && $(UV) $(1); } || $(PIP) $(1)

# the newest Python that works: it may be a stub, too old, or without venv and pip
PYTHON := $(shell for python in python3.13 python3.12 python3.11 python3; do \
	"$$python" -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' \
		2>/dev/null && echo "$$python" && break; done)

# what is compiled stays in the checkout
export FASTATT_CACHE ?= $(CURDIR)/.fastatt_cache
export NUMBA_CACHE_DIR ?= $(CURDIR)/.numba_cache
# bytecode too: else each of the tests' processes would compile all that it imports
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help venv test pythons commands trade bench leaderboard extremes cases scale pictures hostile bench-smoke lint \
	format types layers docs readme clean

help:  ## this list
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/\1\t\2/p' $(MAKEFILE_LIST) | expand -t 14

$(VENV)/.made:
	@test -n "$(PYTHON)" || { echo "needs Python >= 3.11 with venv and ensurepip" >&2; exit 1; }
	$(PYTHON) -m venv --clear $(VENV)
	-$(PIP) uv
	@touch $@

$(VENV)/.trade: $(VENV)/.made pyproject.toml
	$(call install,--editable '.[trade]')
	@touch $@

$(VENV)/.leaderboard: $(VENV)/.made pyproject.toml
	$(call install,--editable '.[leaderboard]')
	@touch $@

$(VENV)/.test: $(VENV)/.made pyproject.toml
	$(call install,--editable '.[test]')
	@touch $@ $(VENV)/.trade

$(VENV)/.lint: $(VENV)/.test
	$(call install,--editable '.[lint]')
	@touch $@

venv: $(VENV)/.lint  ## the environment of all other targets, in .venv

test: $(VENV)/.test  ## the tests, the README's examples among them
	@# to rewrite all assertions takes ten seconds: what fails runs again, and tells its values
	$(BIN)/pytest -n auto --dist worksteal -p no:benchmark --assert=plain \
		|| { $(BIN)/pytest --last-failed --last-failed-no-failures none -p no:benchmark; exit 1; }

pythons: $(VENV)/.test  ## a part of the tests with other Pythons, and with the lowest Numba and NumPy
	.ci/pythons

commands: $(VENV)/.test  ## every command that a page names, small, some minutes
	$(BIN)/python .ci/commands.py

readme: $(VENV)/.test  ## the README's examples only
	$(BIN)/pytest tests/test_readme.py

trade: $(VENV)/.trade  ## every method on the default scene: table, picture and CSV in results/
	$(BIN)/fastatt trade --out $(RESULTS) $(if $(FASTATT_SMOKE),--quick)

bench: $(VENV)/.test  ## speed and error, side by side with other libraries
	$(BIN)/pytest bench

leaderboard: $(VENV)/.leaderboard  ## time at equal error beside others, 9 minutes: bench/LEADERBOARD.md
	PYTHONPATH=tests $(BIN)/python bench/leaderboard.py --out $(RESULTS) --page bench --pictures fastatt/docs/pictures

extremes: $(VENV)/.test  ## every method at the extremes, a minute: bench/EXTREMES.md
	PYTHONPATH=tests $(BIN)/python -m extremes $(if $(FASTATT_SMOKE),--quick,--long)

cases: $(VENV)/.test  ## cases that others published, beside ours: bench/CASES.md
	$(BIN)/python bench/cases.py

scale: $(VENV)/.test  ## cost against bodies, steps and threads, a minute: bench/SCALE.md
	$(BIN)/python bench/scale.py $(if $(FASTATT_SMOKE),--small)

pictures: $(VENV)/.test  ## the pages' pictures, five minutes: fastatt/docs/pictures
	$(BIN)/fastatt trade --scene coning --scene free --scene top --scene torqued --out $(RESULTS) \
		$(if $(FASTATT_SMOKE),--quick)
	cp $(RESULTS)/trade.png $(RESULTS)/bodies.png fastatt/docs/pictures
	$(BIN)/python bench/polhodes.py
	$(BIN)/python bench/tumbling.py
	$(BIN)/python bench/leaderboard_picture.py
	$(BIN)/python bench/work_precision.py --draw

hostile: $(VENV)/.test  ## advice where a rate or torque jumps, some 20 minutes: the table of explanations/trade.md
	$(BIN)/python bench/hostile.py

bench-smoke: $(VENV)/.test  ## every bench once, small and untimed
	@if ls bench/bench_*.py >/dev/null 2>&1; \
	then FASTATT_SMOKE=1 $(BIN)/pytest bench --benchmark-disable; \
	else echo "bench-smoke: bench/ has no bench_*.py"; fi

lint: $(VENV)/.lint  ## ruff: rules and format
	$(BIN)/ruff check
	$(BIN)/ruff format --check

format: $(VENV)/.lint  ## rewrite files as lint wants them
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

types: $(VENV)/.lint  ## mypy
	$(BIN)/mypy

layers: $(VENV)/.lint  ## which module may import which
	$(BIN)/lint-imports

docs: $(VENV)/.lint  ## the pages and the reference of all public names, as a site: results/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

clean:  ## remove the environment, caches and results
	rm -rf $(VENV) .fastatt_cache .numba_cache .pytest_cache .mypy_cache .ruff_cache .import_linter_cache \
		.hypothesis .benchmarks build dist $(RESULTS)
	find fastatt tests $(wildcard bench) -name __pycache__ -type d -prune -exec rm -rf {} +
