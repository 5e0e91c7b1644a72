"""One flight with a fault: app and simulator in one process, in virtual time, watched to its real end.

When the app has ended, the world goes on until the vehicle is disarmed or has held for a while: what the
autopilot makes of what it was handed belongs to how the flight ended.
"""

import asyncio
import secrets
import tempfile
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypeVar

from benchmarks.faults.branches import ForkedSchedule
from benchmarks.faults.cases import CASES, FaultRun, StandingBy, changed, faultless, faults_of, scenario_of
from benchmarks.faults.computer import applied
from benchmarks.faults.forks import Forks
from benchmarks.faults.judge import HOLD_MODES, SafetyBounds, SafetyVerdict, judge
from benchmarks.faults.sent_limits import OBEYED_MODES
from benchmarks.faults.standing_by import play
from benchmarks.faults.witness import Commanded, FaultWitness, SentSetpoint, TruthSample, WitnessedFlight
from benchmarks.in_process import app_and_vehicle
from companion.app.app import App
from companion.base.autopilot_kind import AutopilotKind
from companion.base.clock import run_in_virtual_time
from companion.base.messages import ControlReport, VehicleState
from companion.config import CONFIG_FOLDER, CompanionConfig, ConfigError
from companion.flightlog.flights_recorder import FlightsRecorder
from companion.flightlog.record import FlightLog
from companion.link.signing import KEY_BYTES
from companion.sense.vision.opencv import prepare_opencv
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from sitl.autopilot.flight.autopilot import PROFILES
from sitl.faults.faults import PilotMode
from sitl.faults.targets import ComputerFaults
from sitl.mavlink.framing import read_key
from sitl.run.in_process import InProcess
from sitl.run.process_control import interrupted_at_once
from sitl.run.simulation import Simulation
from sitl.scenario.scenario import Scenario
from tests.beside import beside

Told = TypeVar("Told", bound=VehicleState | ControlReport)
HELD_S: Final = 4.0
AFTERMATH_S: Final = 60.0
DRIFTS_S: Final = 240.0  # so long it is left to what ends a flight without setpoints
LOOK_S: Final = 0.1
# what stands on the pad so long with its motors on, nothing disarms: longer than the touchdown's time-out
STANDS_S: Final = 55.0
# a pad that has just braked rocks what stands on it
SETTLES_S: Final = 5.0


# docs/reference/autopilot-parameters.md: what the autopilot is to do when setpoints stop, where a case says
# nothing else. PX4 holds; ArduPilot returns where it drifts to the fence of the app (`plan.mission.fence_m`).
SETPOINTS_LOST: Final[dict[AutopilotKind, dict[str, float]]] = {
    "px4": {},
    "ardupilot": {"GUID_TIMEOUT": 1.0, "FENCE_ENABLE": 1.0, "FENCE_RADIUS": 150.0},
}


def _as_is(_simulation: Simulation) -> None:
    """The scenario's own faults."""


def fly_run(run: FaultRun) -> tuple[SafetyVerdict, WitnessedFlight]:
    """Fly one from its start and judge it."""
    prepare_opencv()
    case = CASES[run.fault]
    with _key(case.signed) as changes:
        scenario = changed(scenario_of(run), changes)
        record, config = fly(scenario, run.seed, on_disk=case.on_disk, story=case.stands_by)
    return judged(run, record, config), record


def fly_together(
    runs: Sequence[FaultRun], forks: Forks[Any], changes: dict[str, Any] | None = None
) -> Iterator[tuple[FaultRun, SafetyVerdict, WitnessedFlight]]:
    """Fly runs of one scenario (with changes) and seed, each from its fault on in a process of its own.

    Yields in each process what was flown there: in a child its run, in the first the runs whose fault has
    never begun.
    """
    prepare_opencv()
    branches: list[ForkedSchedule] = []

    def branch(simulation: Simulation) -> None:
        branches.append(ForkedSchedule(simulation, runs, forks))
        simulation.faults = branches[0]

    shared = {"autopilot": runs[0].autopilot, **(changes or {})}
    record, config = fly(faultless(runs[0].scenario, shared), runs[0].seed, prepare=branch)
    for run in branches[0].left if forks.mine is None else [forks.mine]:
        yield run, judged(run, record, config), record


def judged(run: FaultRun, record: WitnessedFlight, config: CompanionConfig) -> SafetyVerdict:
    """How it ended."""
    # where the flight was over before the fault, the end is not the pilot's
    record.pilot_took_over = run.fault.startswith("pilot") and record.fault_began
    for fault in faults_of(run):
        if isinstance(fault, PilotMode):
            record.pilot_mode = fault.chosen(PROFILES[run.autopilot])
    return judge(record, bounds_of(config))


def bounds_of(config: CompanionConfig) -> SafetyBounds:
    """What the settings promise."""
    mission = config.plan.mission
    return SafetyBounds(config.control.limits, mission.fence_m, mission.ceiling_m)


def fly(
    scenario: Scenario,
    seed: int,
    *,
    on_disk: bool = False,
    story: StandingBy | None = None,
    prepare: Callable[[Simulation], None] = _as_is,
) -> tuple[WitnessedFlight, CompanionConfig]:
    """Fly a scenario, or a story of an app that stands by, to its end.

    Returns what was seen and the settings that it was flown with.
    """
    trial = Trial(Path(f"{scenario.name}.yaml"), scenario, seed)
    config = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)
    faults = ComputerFaults()
    with _log(on_disk, story) as log, applied(faults):
        record = run_in_virtual_time(_interruptible(_fly(trial, config, log, faults, prepare, story)))
        faults.clear_faults()  # what is left of the log is written
        log.close()
    return record, config


@contextmanager
def _key(signed: bool) -> Iterator[dict[str, Any]]:
    """What a scenario's app is to be told while inside, for a link that is signed."""
    if not signed:
        yield {}
        return
    with tempfile.NamedTemporaryFile(prefix="bench-faults-key-") as file:
        file.write(secrets.token_bytes(KEY_BYTES))
        file.flush()
        yield {"companion": {"link": {"signing_key": file.name}}}


@contextmanager
def _log(on_disk: bool, story: StandingBy | None) -> Iterator[FlightLog]:
    if not on_disk:
        yield FlightLog(None, start_unix_s=0.0) if story is None else FlightsRecorder(None, lambda: 0.0)
        return
    with tempfile.TemporaryDirectory(prefix="bench-faults-") as folder:
        yield FlightLog(Path(folder), start_unix_s=0.0)


async def _interruptible(flight: Awaitable[WitnessedFlight]) -> WitnessedFlight:
    """Fly, ended by a signal at once: the loop's own word of it goes to any process that shares its pipe."""
    with interrupted_at_once():
        return await flight


async def _fly(
    trial: Trial,
    config: CompanionConfig,
    log: FlightLog,
    faults: ComputerFaults,
    prepare: Callable[[Simulation], None],
    story: StandingBy | None,
) -> WitnessedFlight:
    key = None if config.link.signing_key is None else read_key(config.link.signing_key)
    stays = story is not None
    app, vehicle = app_and_vehicle(trial, config, log, stays=stays, computer=faults, signing_key=key)
    simulation = vehicle.simulation
    for name, value in SETPOINTS_LOST[trial.scenario.autopilot].items():
        chosen = trial.scenario.autopilot_parameters.get(name, value)
        if not simulation.autopilot.parameters.set(name, chosen):
            raise ConfigError(f"{name}: expected a parameter of the autopilot")
    prepare(simulation)
    witness = FaultWitness(simulation)
    simulation.on_step = witness.step
    simulation.line.listeners.append(witness.hear)
    async with beside(simulation.run()):
        if story is None:
            await _run_app(app, trial.scenario.time_limit_s, vehicle, witness.record)
            vehicle.wants_frames = False
            await _aftermath(vehicle, witness.record)
        else:
            await _play(story, app, vehicle, witness.record)
    record = witness.record
    record.commanded = [
        Commanded(plan.time_s, plan.reference.origin, float(plan.reference.position_m[0, 2]))
        for plan in log.kept["plan"]
        if plan.reference is not None
    ]
    record.samples = list(with_belief(record.samples, log.kept["vehicle"]))
    record.setpoints = list(with_pressure(record.setpoints, log.kept["control_report"]))
    record.fault_began = simulation.faults.all_begun
    record.texts = list(simulation.status_text_monitor.texts)
    record.crashed, record.at_rest_on_pad = simulation.world.watch.crashed, simulation.world.at_rest_on_pad
    record.contacts = list(simulation.world.watch.contacts)
    return record


def with_belief(samples: Sequence[TruthSample], believed: Sequence[VehicleState]) -> Iterator[TruthSample]:
    """The samples with how much too low the app believes itself by its newest estimate."""
    for sample, state in zip(samples, _newest(samples, believed), strict=True):
        low_m = 0.0 if state is None else state.position_ned_m[2] - sample.position_ned_m[2]
        yield sample._replace(believed_low_m=low_m)


def with_pressure(
    setpoints: Sequence[SentSetpoint], reports: Sequence[ControlReport]
) -> Iterator[SentSetpoint]:
    """The setpoints with what the app felt press on the vehicle by the report of their control cycle."""
    for sent, report in zip(setpoints, _newest(setpoints, reports), strict=True):
        pressed_m_s2 = 0.0 if report is None else max(0.0, report.disturbance_ned_m_s2[2])
        yield sent._replace(pressed_m_s2=pressed_m_s2)


def _newest(at: Sequence[TruthSample | SentSetpoint], told: Sequence[Told]) -> Iterator[Told | None]:
    """What was told last at the time of each; both are in their order."""
    following = iter((*told, None))
    last, after = None, next(following)
    for each in at:
        while after is not None and after.time_s <= each.time_s:
            last, after = after, next(following)
        yield last


async def _play(story: StandingBy, app: App, vehicle: InProcess, record: WitnessedFlight) -> None:
    """Run an app that stays beside a story; a failed app is the bench's failure too."""
    async with beside(app.run(), play(story, app, vehicle, record)) as tasks:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        next(task for task in tasks if task.done()).result()


async def _run_app(app: App, limit_s: float, vehicle: InProcess, record: WitnessedFlight) -> None:
    """Let it run to its end, to a crash, to the limit or to what will not change; a failed app is noted."""
    world, autopilot = vehicle.simulation.world, vehicle.simulation.autopilot
    watch, moved_s = world.watch, 0.0
    async with beside(app.run()) as (flight,):
        while not flight.done() and world.time_s < min(limit_s, moved_s + STANDS_S) and not watch.crashed:
            if not (world.at_rest_on_pad and autopilot.armed):
                moved_s = world.time_s
            await asyncio.wait([flight], timeout=LOOK_S)
        if flight.done() or watch.crashed:
            record.app_ended_s = world.time_s
        else:
            record.app_stopped_s = world.time_s
        if flight.done() and (failure := flight.exception()) is not None:
            record.app_failed = _words(failure)


def _words(failure: BaseException) -> str:
    while isinstance(failure, BaseExceptionGroup):
        failure = failure.exceptions[0]
    return f"{type(failure).__name__}: {failure}"


async def _aftermath(vehicle: InProcess, record: WitnessedFlight) -> None:
    """Go on until it is disarmed and at rest, has held for a while, or has crashed."""
    world, autopilot = vehicle.simulation.world, vehicle.simulation.autopilot
    began_s = ended_s = held_s = world.time_s
    while autopilot.armed and not world.watch.crashed and world.time_s < ended_s + AFTERMATH_S:
        if autopilot.mode in OBEYED_MODES and world.time_s < began_s + DRIFTS_S:
            ended_s = world.time_s
        if autopilot.mode not in HOLD_MODES:
            held_s = world.time_s
        if world.time_s >= held_s + HELD_S:
            return
        await asyncio.sleep(LOOK_S)
    await asyncio.sleep(1.0)
    for _ in range(round(SETTLES_S / LOOK_S)):
        if world.at_rest_on_pad or not world.contact.on_board:
            return
        await asyncio.sleep(LOOK_S)
