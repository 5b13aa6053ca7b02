# Every target sets up what it needs, from a machine with Python >= 3.11 only.
VENV := .venv
BIN := $(VENV)/bin
RESULTS := results
# exact versions with hashes, of all Pythons; what newer releases break is found by `make pythons`
LOCK := .ci/lock.txt
COMMA := ,
# two methods of bodies and one of samples stand for all
TRADE_SMALL := $(if $(FASTATT_SMOKE),--quick --bodies 64 --methods rk4$(COMMA)exact$(COMMA)hold)
install = $(BIN)/uv pip install --quiet --python $(BIN)/python --constraints $(LOCK) \
	--build-constraints $(LOCK) --editable '.[$(1)]'

# the newest Python that works: it may be a stub, too old, or without venv and pip
PYTHON := $(shell for python in python3.13 python3.12 python3.11 python3; do \
	"$$python" -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' \
		2>/dev/null && echo "$$python" && break; done)

# what is compiled stays in the checkout
export FASTATT_CACHE ?= $(CURDIR)/.fastatt_cache
export NUMBA_CACHE_DIR ?= $(CURDIR)/.numba_cache
# bytecode too: else each of the tests' processes would compile all that it imports
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help venv lock test test-all fuzz pythons commands trade bench leaderboard extremes cases scale pictures hostile bench-smoke lint \
	format types layers docs readme clean

help:  ## this list
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/\1\t\2/p' $(MAKEFILE_LIST) | expand -t 14

$(VENV)/.made:
	@test -n "$(PYTHON)" || { echo "needs Python >= 3.11 with venv and ensurepip" >&2; exit 1; }
	$(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile uv
	@touch $@

$(VENV)/.trade: $(VENV)/.made pyproject.toml $(LOCK)
	$(call install,plot$(COMMA)progress)
	@touch $@

# without the lock: some of the others want older releases than it has
$(VENV)/.leaderboard: $(VENV)/.made pyproject.toml
	$(BIN)/uv pip install --quiet --python $(BIN)/python --editable '.[leaderboard]'
	@touch $@

$(VENV)/.test: $(VENV)/.made pyproject.toml $(LOCK)
	$(call install,test)
	@touch $@ $(VENV)/.trade

$(VENV)/.lint: $(VENV)/.test
	$(call install,lint)
	@touch $@

lock: $(VENV)/.made  ## renew the exact versions that all targets install: .ci/lock.txt
	echo hatchling | $(BIN)/uv pip compile --quiet --upgrade --universal --python-version 3.11 \
		--generate-hashes --no-header --no-annotate --extra test --extra lint pyproject.toml - \
		-o $(LOCK)

venv: $(VENV)/.lint  ## the environment of all other targets, in .venv

# to rewrite all assertions takes ten seconds: what fails runs again, and tells its values
tests = $(BIN)/pytest -n auto --dist worksteal -p no:benchmark --assert=plain $(1) \
	|| { $(BIN)/pytest --last-failed --last-failed-no-failures none -p no:benchmark; exit 1; }

test: $(VENV)/.test  ## the tests, the README's and the tutorial's examples among them
	$(call tests,-m "not slow")

test-all: $(VENV)/.test  ## the tests, the examples of all pages and the benches, small
	$(call tests)

fuzz: $(VENV)/.test  ## the random testers, MINUTES each, of other cases each day
	FASTATT_MINUTES=$(or $(MINUTES),10) $(BIN)/pytest -n auto -p no:benchmark -rA tests/testers \
		tests/test_undocumented.py

pythons: $(VENV)/.test  ## a part of the tests with other Pythons, and the lowest, locked and newest Numba and NumPy
	.ci/pythons

commands: $(VENV)/.test  ## every command that a page names, small, some minutes
	$(BIN)/python .ci/commands.py

readme: $(VENV)/.test  ## the README's examples only
	$(BIN)/pytest tests/test_readme.py

trade: $(VENV)/.trade  ## speed, error and drift of every method, two minutes: results/summary.md
	$(BIN)/fastatt trade --out $(RESULTS) $(TRADE_SMALL)

bench: $(VENV)/.test  ## speed and error, side by side with other libraries
	$(BIN)/pytest bench

leaderboard: $(VENV)/.leaderboard  ## time at equal error beside others, 9 minutes: bench/LEADERBOARD.md
	$(BIN)/python bench/leaderboard.py --out $(RESULTS) --page bench --pictures fastatt/docs/pictures

extremes: $(VENV)/.test  ## every method at the extremes, a minute: bench/EXTREMES.md; METHOD=, its rows
	$(BIN)/python bench/extremes_page.py \
		$(if $(METHOD),--method $(METHOD),$(if $(FASTATT_SMOKE),--quick,--long))

cases: $(VENV)/.test  ## cases that others published, beside ours: bench/CASES.md
	$(BIN)/python bench/cases.py

scale: $(VENV)/.test  ## cost against bodies, steps and threads, a minute: bench/SCALE.md
	$(BIN)/python bench/scale.py $(if $(FASTATT_SMOKE),--small)

pictures: $(VENV)/.test  ## the pages' pictures, five minutes: fastatt/docs/pictures
	$(BIN)/fastatt trade --out $(RESULTS) $(TRADE_SMALL)
	cp $(addprefix $(RESULTS)/,error-coning.png error-free.png drift-free.png) fastatt/docs/pictures
	$(BIN)/python bench/polhodes.py
	$(BIN)/python bench/leaderboard_picture.py
	$(BIN)/python bench/work_precision.py --draw

hostile: $(VENV)/.test  ## advice where a rate or torque jumps, six minutes: the table of explanations/trade.md
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
