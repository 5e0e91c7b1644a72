# make sitl    fly the bundled simulator from a fresh checkout
# make test    lint, types, architecture, unit, property and scenario tests
# make bench   where the time goes, the estimators' bars and the landing campaign's; or one alone:
# make bench-state           the estimators in flight: errors, consistency, faults, costs
# make bench-pad             the pad filter over made-up tracks
# make bench-sitl-speed      how fast one simulated vehicle runs, without and with its camera
# make bench-ahrs DATA=DIR   orientation over trials of BROAD, beside other projects' filters
PYTHON ?= python3
VENV   ?= .venv
SEEDS  ?= 10
# the estimators' consistency is judged over twice as many
STATE_SEEDS ?= 20
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
BENCH_STATE = $(BIN)/python -m tests.bench.bench_state --seeds $(STATE_SEEDS)

.PHONY: sitl test lint bench bench-state bench-pad bench-sitl-speed bench-ahrs clean

$(VENV)/.run: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "companion needs Python 3.11 or newer; set PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(PIP) -e .
	touch $@

$(VENV)/.dev: $(VENV)/.run
	$(PIP) -e '.[dev]'
	touch $@

sitl: $(VENV)/.run
	$(BIN)/companion --sitl --record flights/$$(date +%Y%m%d-%H%M%S)

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

test: lint
	$(BIN)/python -m pytest

# each prints its table beside the bars and ends in a line that says which hold; all of them run
bench: $(VENV)/.dev
	@status=0; \
	$(BIN)/python tests/bench/bench_time.py || status=1; \
	$(BENCH_STATE) || status=1; \
	$(BIN)/python -m tests.bench.bench_pad_filter || status=1; \
	$(BIN)/python -m sitl.campaign --seeds $(SEEDS) || status=1; \
	exit $$status

bench-state: $(VENV)/.dev
	$(BENCH_STATE)

bench-pad: $(VENV)/.dev
	$(BIN)/python -m tests.bench.bench_pad_filter

bench-sitl-speed: $(VENV)/.dev
	$(BIN)/python -m tests.bench.bench_sitl_speed

# the peers are for comparison alone: without them the bench judges by their published figures
bench-ahrs: $(VENV)/.dev
	@test -d "$(DATA)" || { echo "bench-ahrs: expected DATA=DIR, a folder of BROAD trials"; exit 2; }
	-$(PIP) -e '.[peers]'
	$(BIN)/python -m tests.bench.bench_ahrs $(DATA)

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
