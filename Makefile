# make sitl    fly the bundled simulator from a fresh checkout
# make test    lint, types, architecture, unit and property tests, eight landings, every documented command
# make test-all  what make test leaves out: real time, clients of others, firmware, further seeds, the laboratory
# make durations  both, and how long each test takes, by which they are ordered and split
# make docs    the documentation as a site, site/index.html
# make release ARCHITECTURES=aarch64  bundles that install without a network on Debian 12 and 13, into dist/
# make test-deploy DEPLOY=DIR  the service in a container that boots systemd, the app on arm64 by qemu; needs root
# make bench   where the time goes, the estimators' bars and the landing campaign's
# make bench-NAME ARGS=...   one benchmark; `python -m benchmarks` lists them. DATA=DIR, PX4=BIN, ARDUCOPTER=BIN, RUNS=N
#              and SEEDS=N go to those that know them, ARGS to any: make bench-vision DATA=DIR ARGS="--only sweep"
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
BENCH   = $(BIN)/python -m benchmarks
PYTEST  = PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest

.PHONY: sitl test lint bench clean

$(VENV)/.run: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "companion needs Python 3.11 or newer; set PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(PIP) -e .
	touch $@

$(VENV)/.dev: $(VENV)/.run
	$(PIP) -e '.[dev]'
	# a real client for the tests; what it says it needs holds another OpenCV, which would overwrite ours
	$(PIP) --no-deps MAVProxy
	touch $@

sitl: $(VENV)/.run
	$(BIN)/companion --sitl --record flights/$$(date +%Y%m%d-%H%M%S)

# side by side: mypy takes half a minute from scratch, on one core
lint: $(VENV)/.dev
	@$(MAKE) --no-print-directory --jobs 2 types style

.PHONY: types style
types:
	$(BIN)/mypy

style:
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

# types and import rules are tests too (tests/architecture), beside the others; the tests start our programs many
# times: what the first compiles, the others take from its cache
test: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(PYTEST) -m 'not slow' $(ARGS)

.PHONY: test-all durations
test-all: $(VENV)/.dev
	$(PYTEST) -m slow $(ARGS)

# only those of a second and more are kept
durations: $(VENV)/.dev
	$(PYTEST) --store-durations --clean-durations
	$(BIN)/python -c 'import json, pathlib; path = pathlib.Path(".test_durations"); \
		kept = {test: round(s, 1) for test, s in sorted(json.loads(path.read_text()).items()) if s >= 1}; \
		path.write_text(json.dumps(kept, indent=4) + "\n")'

.PHONY: docs
docs: $(VENV)/.dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

# without ARCHITECTURES both; fetches every dependency's wheels
.PHONY: release
release: $(VENV)/.dev
	PYTHON=$(abspath $(BIN)/python) systemd/release.sh dist $(ARCHITECTURES)

# fetches Debian roots into DEPLOY and keeps them there; what this machine cannot do is skipped, with the reason
.PHONY: test-deploy
test-deploy: $(VENV)/.dev
	COMPANION_DEPLOY=$(or $(DEPLOY),/var/tmp/companion-deploy) $(BIN)/python -m pytest -n 0 -rs tests/deploy

# each prints its table beside the bars and ends in one line that says which hold; all of them run
bench: $(VENV)/.dev
	@status=0; \
	for name in time state pad mpc fuzz; do $(BENCH) $$name || status=1; done; \
	$(BIN)/companion-sitl campaign --runs 10 --bars || status=1; \
	exit $$status

# resumable ones go on where they stopped when the command is given again
bench-%: $(VENV)/.dev
	$(BENCH) $* $(DATA) $(if $(PX4),--px4 $(PX4)) $(if $(ARDUCOPTER),--arducopter $(ARDUCOPTER)) \
		$(if $(RUNS),--runs $(RUNS)) $(if $(SEEDS),--seeds $(SEEDS)) $(ARGS)

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
