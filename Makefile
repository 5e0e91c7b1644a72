# make sitl    fly the bundled simulator from a fresh checkout
# make test    lint, types, architecture, unit, property and scenario tests
# make release ARCHITECTURES=aarch64  bundles that install without a network on Debian 12 and 13, into dist/
# make test-deploy DEPLOY=DIR  the service in a container that boots systemd, the app on arm64 by qemu; needs root
# make bench   where the time goes, the estimators' bars and the landing campaign's; or one alone:
# make bench-state           the estimators in flight: errors, consistency, faults, costs
# make bench-deck            landings on a rolling ship: seen, landed, tilt at contact
# make bench-pad             the pad filter over made-up tracks
# make bench-obstacles       ways round random obstacles: clearance, what is held before, cost
# make bench-cpu             what the app costs in a landing, by part, and what blocks its event loop
# make bench-long-life       an hour of virtual flight in one run: memory and the control step's cost
# make bench-mpc             what a step of the MPC costs, beside setting it up anew
# make bench-response PX4=BIN ARDUCOPTER=BIN  how the autopilots answer setpoints, beside what is believed
# make bench-descents RUNS=100  descents of random landings by the fuzzy speed controller and by fixed speeds
# make bench-grant ARDUCOPTER=BIN  the fall as control is taken, whatever hover thrust was told
# make bench-margins         landings with a response, a delay, stamps and a mass other than believed
# make bench-campaign        how much faster a campaign is on two jobs
# make bench-precision       the autopilots' own precision landing, beside what the real firmware did
# make bench-landing RUNS=200  random landings, and the cases of the autopilots' own precision landing
# make bench-firmware PX4=BIN ARDUCOPTER=BIN  landings on the real firmwares, in lockstep
# make bench-external PX4=BIN ARDUCOPTER=BIN  landings on the firmwares' own simulators, in real time
# make bench-faults          every fault in every phase of a flight: how it ends, and whether it is safe
# make bench-service         the service: start, CPU, memory, ten orders in one run
# make bench-page            the live page: from exposure to pixel, CPU, the control loop with three viewers
# make bench-interruptions   kills, stalls and stops at random moments of a flight in real time
# make bench-mutations       a million spoilt inputs to drivers, link, settings and scenario files
# make bench-mutants         small changes to the last gate: which of them would its tests not notice
# make bench-fuzz            a million wrong MAVLink frames into the simulated vehicle
# make bench-sitl DATA=DIR   the simulated vehicle beside recordings of PX4 and ArduPilot
# make bench-sitl-speed      how fast one simulated vehicle runs, without and with its camera
# make bench-calibration DATA=DIR  the calibration tools on made-up truth, and on real logs and photos
# make bench-experiments     Fig. 14 over twenty seeds: MPC, the paper's recursion and PID on one reference
# make bench-vision DATA=DIR the vision: recall, errors, clutter, flips, speed; on real photos with DATA
# make bench-photoreal DATA=DIR  the vision on photoreal pictures of pads, beside OpenCV's
# make bench-sweep           the vision from every height: each shipped pad before each shipped camera
# make bench-ahrs DATA=DIR   orientation over trials of BROAD, beside other projects' filters
PYTHON ?= python3
VENV   ?= .venv
SEEDS  ?= 10
# of the campaign that is flown on one job and then on two
CAMPAIGN_RUNS ?= 100
# random landings
RUNS ?= 200
# spoilt inputs
MUTATIONS ?= 1000000
# the estimators' consistency is judged over twice as many
STATE_SEEDS ?= 20
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
BENCH_STATE = $(BIN)/python -m tests.bench.state.bench_state --seeds $(STATE_SEEDS)

.PHONY: sitl test lint bench bench-cpu bench-long-life bench-experiments bench-state bench-deck bench-pad bench-obstacles bench-mpc bench-descents bench-grant bench-margins bench-response bench-campaign bench-precision bench-landing bench-firmware bench-faults bench-service bench-page bench-interruptions bench-mutations bench-mutants bench-fuzz bench-sitl-speed bench-calibration bench-ahrs bench-vision bench-photoreal bench-sweep bench-sitl clean

$(VENV)/.run: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "companion needs Python 3.11 or newer; set PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(PIP) -e '.[report]'
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
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest

# without ARCHITECTURES both; fetches every dependency's wheels
.PHONY: release
release: $(VENV)/.dev
	PYTHON=$(abspath $(BIN)/python) systemd/release.sh dist $(ARCHITECTURES)

# fetches Debian roots into DEPLOY and keeps them there; what this machine cannot do is skipped, with the reason
.PHONY: test-deploy
test-deploy: $(VENV)/.dev
	COMPANION_DEPLOY=$(or $(DEPLOY),/var/tmp/companion-deploy) $(BIN)/python -m pytest -n 0 -rs tests/deploy

# each prints its table beside the bars and ends in a line that says which hold; all of them run
bench: $(VENV)/.dev
	@status=0; \
	$(BIN)/python -m tests.bench.cpu.bench_time || status=1; \
	$(BENCH_STATE) || status=1; \
	$(BIN)/python -m tests.bench.state.bench_pad_filter || status=1; \
	$(BIN)/python -m tests.bench.control.bench_mpc || status=1; \
	$(BIN)/python -m tests.bench.mavlink.bench_fuzz || status=1; \
	$(BIN)/companion-sitl campaign --runs $(SEEDS) --bars || status=1; \
	exit $$status

bench-state: $(VENV)/.dev
	$(BENCH_STATE)

bench-deck: $(VENV)/.dev
	$(BIN)/python -m tests.bench.state.bench_deck --seeds $(SEEDS)

# half an hour's flights on two processes take about ten minutes; Fig. 14's picture is left beside
bench-experiments: $(VENV)/.dev
	$(BIN)/python -m companion.research.command fig14 --seed 100 --seeds $(STATE_SEEDS) --jobs 2 -o fig14.png

bench-pad: $(VENV)/.dev
	$(BIN)/python -m tests.bench.state.bench_pad_filter

bench-obstacles: $(VENV)/.dev
	$(BIN)/python -m tests.bench.control.bench_obstacles

# a landing in real time: the other core is the simulator's
bench-cpu: $(VENV)/.dev
	$(BIN)/python -m tests.bench.cpu.bench_cpu --record

# twenty minutes
bench-long-life: $(VENV)/.dev
	$(BIN)/python -m tests.bench.cpu.bench_long_life

# twenty minutes on two cores for the bundled behaviour alone
bench-grant: $(VENV)/.dev
	$(BIN)/python -m tests.bench.control.bench_grant $(if $(ARDUCOPTER),--arducopter $(ARDUCOPTER))

# an hour on two cores; give it again after an interruption, and it goes on
bench-margins: $(VENV)/.dev
	$(BIN)/python -m tests.bench.campaign.bench_margins

bench-mpc: $(VENV)/.dev
	$(BIN)/python -m tests.bench.control.bench_mpc

# half an hour of a core for sixty; give it again after an interruption, and it goes on
bench-descents: $(VENV)/.dev
	$(BIN)/python -m tests.bench.control.bench_descents --runs $(RUNS)

# needs the machine to itself, for half an hour
bench-campaign: $(VENV)/.dev
	$(BIN)/python -m tests.bench.campaign.bench_campaign --runs $(CAMPAIGN_RUNS)

bench-precision: $(VENV)/.dev
	$(BIN)/python -m tests.bench.autopilot.bench_precision_landing

# an hour on two cores; give it again after an interruption, and it goes on
bench-landing: $(VENV)/.dev
	$(BIN)/python -m tests.bench.campaign.bench_landing --runs $(RUNS)

# three quarters of an hour on two cores; give it again after an interruption, and it goes on
bench-firmware: $(VENV)/.dev
	$(BIN)/python -m tests.bench.firmware.bench_firmware $(if $(PX4),--px4 $(PX4)) $(if $(ARDUCOPTER),--arducopter $(ARDUCOPTER)) --seeds $(SEEDS)

# in real time, one after another, on a quiet machine; give it again after an interruption, and it goes on
.PHONY: bench-external
bench-external: $(VENV)/.dev
	$(BIN)/python -m tests.bench.firmware.bench_external $(if $(PX4),--px4 $(PX4)) $(if $(ARDUCOPTER),--arducopter $(ARDUCOPTER))

bench-response: $(VENV)/.dev
	$(BIN)/python -m tests.bench.autopilot.bench_response $(if $(PX4),--px4 $(PX4)) $(if $(ARDUCOPTER),--arducopter $(ARDUCOPTER))

# hours on two cores; give it again after an interruption, and it goes on
bench-faults: $(VENV)/.dev
	$(BIN)/python -m tests.bench.faults.bench_faults --jobs 2

# needs the machine to itself: real time, two processes
bench-service: $(VENV)/.dev
	$(BIN)/python -m tests.bench.service.bench_service

bench-page: $(VENV)/.dev
	$(BIN)/python -m tests.bench.service.bench_page

# three quarters of an hour, likewise; give it again after an interruption, and it goes on
bench-interruptions: $(VENV)/.dev
	$(BIN)/python -m tests.bench.service.bench_interruptions --trials 20

bench-mutations: $(VENV)/.dev
	$(BIN)/python -m tests.bench.mutations.bench_mutations --count $(MUTATIONS)

# a quarter of an hour
bench-mutants: $(VENV)/.dev
	$(BIN)/python -m tests.bench.mutants.bench_mutants

bench-fuzz: $(VENV)/.dev
	$(BIN)/python -m tests.bench.mavlink.bench_fuzz

bench-sitl-speed: $(VENV)/.dev
	$(BIN)/python -m tests.bench.cpu.bench_sitl_speed

# real logs and photos are in DATA's folders magnetometer and aruco; without DATA: made-up truth alone
bench-calibration: $(VENV)/.dev
	@status=0; \
	$(BIN)/python -m tests.bench.calibration.bench_magnetometer $(DATA) || status=1; \
	$(BIN)/python -m tests.bench.calibration.bench_camera $(DATA) || status=1; \
	$(BIN)/python -m tests.bench.calibration.bench_mount || status=1; \
	exit $$status

# ten minutes on two cores, the timing alone at the end; real photos are in DATA's folder aruco; QUICK=--quick
# looks at few frames
bench-vision: $(VENV)/.dev
	$(BIN)/python -m tests.bench.vision.bench_vision $(DATA) $(QUICK)

bench-photoreal: $(VENV)/.dev
	@test -d "$(DATA)/photoreal" || { echo "bench-photoreal: expected DATA=DIR, a folder with photoreal in it"; exit 2; }
	$(BIN)/python -m tests.bench.vision.bench_vision $(DATA) --only photoreal

# twenty minutes on two cores
bench-sweep: $(VENV)/.dev
	$(BIN)/python -m tests.bench.vision.bench_vision --only sweep $(QUICK)

# the peers are for comparison alone: without them the bench judges by their published figures
bench-ahrs: $(VENV)/.dev
	@test -d "$(DATA)" || { echo "bench-ahrs: expected DATA=DIR, a folder of BROAD trials"; exit 2; }
	-$(PIP) -e '.[peers]'
	$(BIN)/python -m tests.bench.state.bench_ahrs $(DATA)

bench-sitl: $(VENV)/.dev
	@test -d "$(DATA)" || { echo "bench-sitl: expected DATA=DIR, a folder of arducopter.tlog and px4.tlog"; exit 2; }
	$(BIN)/python -m tests.bench.autopilot.bench_sitl $(DATA)

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
