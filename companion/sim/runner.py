"""Flights on the desk: the app against the bundled simulator, in virtual or in real time.

Virtual (`--fast`): app and simulator share one process and one virtual-time loop, MAVLink goes through an
in-process pipe. Real: the simulator is a process of its own; MAVLink goes over UDP, the serial sensors
over ptys, registers and frames over local sockets. Either way the app cannot tell, and the truth comes out
at the end, for the score.

With an external autopilot (an ArduPilot or PX4 SITL of the user's) that process is the world alone: pad,
camera and ultrasonic about the user's vehicle, whose own sensors the app takes by telemetry.
"""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from companion.app.app import App, Status
from companion.app.hardware import Hardware, make_actions, make_own_actions, open_hardware
from companion.base.clock import Clock, run_in_virtual_time, wall_clock_s
from companion.base.messages import Phase
from companion.config import (
    CameraConfig,
    CompanionConfig,
    ConfigError,
    GpsConfig,
    ImuConfig,
    find_file,
    load_config,
    load_model,
    merge,
    validate,
)
from companion.flightlog.record import FlightLog
from companion.link.inbox import MemoryTransport, memory_pair
from companion.sim.external import External
from sitl.firmware.process import FirmwareError
from sitl.firmware.spec import FirmwareSpec
from sitl.run.in_process import InProcess
from sitl.run.report import SimulationReport, read_report
from sitl.scenario.scenario import Scenario, load_scenario

START_TIMEOUT_S: Final = 20.0
# an external autopilot may still be booting, and finding its position before it arms
EXTERNAL_START_TIMEOUT_S: Final = 60.0
EXTERNAL_PATIENCE_S: Final = 60.0
# a firmware that is never ready says so itself before
FIRMWARE_START_TIMEOUT_S: Final = 150.0
WORDS_PERIOD_S: Final = 0.3
END_TIMEOUT_S: Final = 10.0
CLEAR_UP_S: Final = 3.0
# what a settings file for a real vehicle may say otherwise, and the simulated one is; a real one's
# calibrations would put wrong what is right here (a scenario of flawed sensors names its own over these)
SIMULATED_HARDWARE: Final[dict[str, Any]] = {
    "mount": None,
    "sense": {
        "imu": ImuConfig().model_dump(
            include={
                "address",
                "body_from_sensor_deg",
                "inertial_calibration",
                "magnetometer_calibration",
            }
        ),
        "gps": GpsConfig().model_dump(include={"antenna_position_body_m"}),
        "autopilot": {"magnetometer_calibration": None},
    },
}

StatusCallback = Callable[[Status], None]


class SimulatorError(Exception):
    """The simulator's process failed; the text is the one line to show."""


# what the app is to be told when its IMU, compass and GPS are those of the user's own autopilot
_BY_TELEMETRY: Final[dict[str, Any]] = {
    "sense": {"source": "autopilot", "autopilot": {"range_source": "boards"}},
    # it is a simulator's: nobody is surprised by what is set there
    "link": {"set_parameters": True},
}


@dataclass(frozen=True, slots=True)
class Trial:
    """What is to be flown: a scenario (and the file it came from) under a seed, on whose autopilot."""

    path: Path
    scenario: Scenario
    seed: int
    external: External | None = None
    firmware: FirmwareSpec | None = None

    @classmethod
    def load(
        cls, name: str, seed: int, external: External | None = None, firmware: FirmwareSpec | None = None
    ) -> Trial:
        """Take a scenario by name or path; a firmware flies as itself, whatever the scenario says.

        Raises:
            ConfigError: no such scenario, its file breaks a rule, or somebody else's vehicle is to fly by a
                firmware of ours.
        """
        if external is not None and firmware is not None:
            raise ConfigError("--firmware: expected to be left out with --autopilot external")
        path = find_file("scenarios", name)
        scenario = load_scenario(path)
        if firmware is not None:
            scenario = scenario.model_copy(update={"autopilot": firmware.kind})
        return cls(path, scenario, seed, external, firmware)

    @property
    def time_limit_s(self) -> float:
        """How long the flight may take, from the app's start."""
        patience_s = 0.0 if self.external is None else EXTERNAL_PATIENCE_S
        return self.scenario.time_limit_s + patience_s


@dataclass(frozen=True, slots=True)
class DeskFlight:
    """A flight that has ended: what the simulator reports, how fast it ran, how often the app was late."""

    report: SimulationReport
    real_time_factor: float
    late_share: float


def desk_settings(config_path: Path, trial: Trial, *, fast: bool) -> CompanionConfig:
    """The app's settings for a trial: the file, and over it what the scenario's operator knows.

    Raises:
        ConfigError: the file or the scenario's overrides are wrong, or the two do not go together.
    """
    link: dict[str, Any] = {"link": {"system_id": 1, "set_parameters": True}}
    if trial.external is not None:
        link = {}  # somebody's own autopilot has the number that their settings give
    elif trial.firmware is not None:
        link = {"link": {"system_id": 0}}  # PX4 numbers itself by its instance
    hardware = merge(merge(SIMULATED_HARDWARE, link), _wiring(trial.scenario))
    overrides = merge(hardware, trial.scenario.companion)
    if fast:
        # MAVSDK has threads and a clock of its own; the same actions by our own messages in virtual time
        overrides = merge(overrides, {"link": {"actions": "pymavlink"}})
    if trial.external is not None:
        overrides = merge(overrides, _BY_TELEMETRY)
    # the file by itself first, so that a mistake is reported where it was made
    settings = load_config(config_path).model_dump()
    config = validate(CompanionConfig, merge(settings, overrides), f"{trial.path}: companion")
    _check_pad(config, trial)
    _check_camera(config, trial)
    return config


def calibrations_left_out(config_path: Path, flown: CompanionConfig) -> list[str]:
    """Which calibration files the settings name for a real vehicle that the simulated one does not fly by."""
    named, used = (_files(config) for config in (load_config(config_path), flown))
    return [key for key, file in named.items() if file is not None and used[key] != file]


def _files(config: CompanionConfig) -> dict[str, str | None]:
    sense = config.sense
    return {
        "mount": config.mount,
        "sense.imu.inertial_calibration": sense.imu.inertial_calibration,
        "sense.imu.magnetometer_calibration": sense.imu.magnetometer_calibration,
        "sense.autopilot.magnetometer_calibration": sense.autopilot.magnetometer_calibration,
    }


def _wiring(scenario: Scenario) -> dict[str, Any]:
    """The app's settings that go with how the simulated sensors are connected."""
    bus = {"i2c": "i2c:1", "spi": "spi:0.0"}[scenario.sensors.imu_interface]
    return {"sense": {"imu": {"bus": bus}, "range": {"kind": scenario.sensors.ultrasonic}}}


def _check_pad(config: CompanionConfig, trial: Trial) -> None:
    """A pad that the app does not know is never found, which a flight would take minutes to say."""
    there, sought = find_file("pads", trial.scenario.pad.name), find_file("pads", config.pad)
    if there.resolve() != sought.resolve():
        raise ConfigError(
            f"{trial.path}: pad.name is '{trial.scenario.pad.name}' but the app looks for '{config.pad}'; "
            f"expected the same, for instance 'companion: {{pad: {trial.scenario.pad.name}}}'"
        )


def _check_camera(config: CompanionConfig, trial: Trial) -> None:
    """Calibrations may differ, as they do in life; the size of the images may not."""
    theirs = load_model(CameraConfig, find_file("cameras", trial.scenario.camera.config))
    ours = load_model(CameraConfig, find_file("cameras", config.camera))
    if (theirs.width_px, theirs.height_px) != (ours.width_px, ours.height_px):
        raise ConfigError(
            f"{trial.path}: camera.config '{theirs.name}' is {theirs.width_px}x{theirs.height_px} px but the "
            f"app's camera '{ours.name}' {ours.width_px}x{ours.height_px} px; expected the same size"
        )


def fly(
    config: CompanionConfig, trial: Trial, log: FlightLog, on_status: StatusCallback, *, fast: bool
) -> DeskFlight:
    """Fly a trial; fast, the same seed gives the same flight. No process is left behind.

    Raises:
        ConfigError: the settings do not go together, or the simulator does not start.
        SimulatorError: the simulator's process, or the firmware that it flies, ended in flight.
    """
    if fast:
        try:
            return run_in_virtual_time(_virtual_flight(config, trial, log, on_status))
        except FirmwareError as error:
            raise SimulatorError(str(error)) from error
    return asyncio.run(_real_flight(config, trial, log, on_status))


async def _fly(app: App, time_limit_s: float, world: asyncio.Task[None]) -> Phase:
    """Run the app to its end or to the time limit; Ctrl-C and SIGTERM hold, hand back and end.

    `world` goes on for ever; when it fails, so does the flight.
    """
    flight = asyncio.create_task(app.run())
    try:
        with stopping_on_signals(app.request_stop):
            await asyncio.wait([flight, world], timeout=time_limit_s, return_when=asyncio.FIRST_COMPLETED)
        if world.done():
            world.result()
        return flight.result() if flight.done() else app.phase
    finally:
        await _cancel(flight)


async def _cancel(task: asyncio.Task[Any]) -> None:
    """End a task and wait for it; a failure of its own is dropped, since another one is being told."""
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


@contextmanager
def stopping_on_signals(stop: Callable[[], None]) -> Iterator[None]:
    """While inside, SIGINT, SIGTERM and SIGHUP (the terminal has gone) call `stop` on the running loop."""
    loop = asyncio.get_running_loop()
    wanted = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    for number in wanted:
        loop.add_signal_handler(number, stop)
    try:
        yield
    finally:
        for number in wanted:
            loop.remove_signal_handler(number)


# ---------------------------------------------------------------- virtual time


async def _virtual_flight(
    config: CompanionConfig, trial: Trial, log: FlightLog, on_status: StatusCallback
) -> DeskFlight:
    app_end, vehicle_end = memory_pair()
    vehicle = InProcess(
        trial.scenario,
        trial.seed,
        link=vehicle_end,
        gps_baud=config.sense.gps.baud,
        range_baud=config.sense.range.baud,
        firmware=trial.firmware,
    )
    with closing(vehicle.simulation):
        return await _fly_in_process(vehicle, app_end, config, trial, log, on_status)


async def _fly_in_process(
    vehicle: InProcess,
    app_end: MemoryTransport,
    config: CompanionConfig,
    trial: Trial,
    log: FlightLog,
    on_status: StatusCallback,
) -> DeskFlight:
    boards = config.sense.source == "boards"
    hardware = Hardware(
        app_end,
        vehicle.frames,
        imu_bus=vehicle.imu_bus if boards else None,
        gps_port=vehicle.gps_port if boards else None,
        range_port=None if config.sense.range_by_telemetry else vehicle.range_port,
    )
    app = App(config, hardware, log, make_own_actions, on_status)
    started_s = wall_clock_s()
    world = asyncio.create_task(vehicle.simulation.run())
    try:
        phase = await _fly(app, trial.scenario.time_limit_s, world)
    finally:
        await _cancel(world)
    factor = Clock().now_s() / (wall_clock_s() - started_s)
    return DeskFlight(vehicle.simulation.report(phase), factor, app.late_share)


# ---------------------------------------------------------------- real time


async def _real_flight(
    config: CompanionConfig, trial: Trial, log: FlightLog, on_status: StatusCallback
) -> DeskFlight:
    with tempfile.TemporaryDirectory(prefix="companion-") as folder:
        simulator = await SimulatorProcess.start(trial, Path(folder))
        try:
            return await _fly_against(simulator, config, trial, log, on_status)
        finally:
            await simulator.kill()


async def _fly_against(
    simulator: SimulatorProcess,
    config: CompanionConfig,
    trial: Trial,
    log: FlightLog,
    on_status: StatusCallback,
) -> DeskFlight:
    wired = validate(
        CompanionConfig, merge(config.model_dump(), simulator.endpoints), "the simulator's endpoints"
    )
    world = asyncio.create_task(simulator.watch())
    try:
        async with open_hardware(wired) as hardware:
            app = App(wired, hardware, log, make_actions, on_status)
            phase = await _fly(app, trial.time_limit_s, world)
    finally:
        await _cancel(world)
    report = await simulator.finish(phase)
    # both processes count by the same clock of the kernel's
    elapsed_s = Clock().now_s() - report.truth[0].time_s
    return DeskFlight(report, report.duration_s / elapsed_s, app.late_share)


def _world_options(trial: Trial) -> tuple[str, ...]:
    """How the simulator is told of the user's autopilot, or of the firmware that flies."""
    if trial.external is not None:
        return ("--external", trial.external.world or trial.external.app)
    return () if trial.firmware is None else trial.firmware.options


class SimulatorProcess:
    """The simulator running as a child; it dies with its standard input, so it cannot outlive us."""

    def __init__(self, process: asyncio.subprocess.Process, endpoints: dict[str, Any], words: Path) -> None:
        """Take a child that has said where it listens; `words` is the file of its standard error."""
        self.endpoints = endpoints
        self._process = process
        self._words = words
        self._finished = False

    @classmethod
    async def start(cls, trial: Trial, folder: Path) -> SimulatorProcess:
        """Start it and wait until it says where it listens; its sockets go into `folder`.

        Raises:
            ConfigError: it ended or said nothing in time; the line is its own.
        """
        words = folder / "stderr"
        with words.open("wb") as stderr:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "sitl.cli", "--child", "--scenario", str(trial.path)),
                *("--seed", str(trial.seed), "--folder", str(folder)),
                *_world_options(trial),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=stderr,
                # Ctrl-C is ours to handle: the vehicle is to be flown to a hold before its world ends
                start_new_session=True,
            )
        simulator = cls(process, {}, words)
        try:
            if trial.external is None:
                # a firmware boots before it is served
                patience_s = START_TIMEOUT_S if trial.firmware is None else FIRMWARE_START_TIMEOUT_S
                simulator.endpoints = await simulator._listen(patience_s)
            else:
                simulator.endpoints = await simulator._find(trial.external)
        except BaseException as error:
            await simulator.kill()
            if isinstance(error, SimulatorError):
                raise ConfigError(f"the simulator did not start: {error}") from error
            raise
        return simulator

    async def _find(self, external: External) -> dict[str, Any]:
        """Where the world listens, once it has found the vehicle; what it says meanwhile is passed on."""
        passing_on = asyncio.create_task(self._pass_words_on())
        try:
            endpoints = await self._listen(EXTERNAL_START_TIMEOUT_S)
        finally:
            passing_on.cancel()
        if external.world is not None:
            endpoints["link"]["connection"] = external.app
        return endpoints

    async def _pass_words_on(self) -> None:
        """A minute of silence would leave a person guessing what is waited for."""
        with self._words.open(errors="replace") as words:
            while True:
                print(words.read(), end="", file=sys.stderr, flush=True)
                await asyncio.sleep(WORDS_PERIOD_S)

    async def watch(self) -> None:
        """Wait for the end that should not come.

        Raises:
            SimulatorError: it has come.
        """
        await self._process.wait()
        raise SimulatorError(f"the simulator ended in flight: {self._last_words()}")

    async def finish(self, phase: Phase) -> SimulationReport:
        """Have the flight judged and take the report.

        Raises:
            SimulatorError: it has crashed or does not answer.
        """
        assert self._process.stdin is not None
        self._process.stdin.write(f"finish {phase.value}\n".encode())
        self._finished = True
        return read_report(Path((await self._listen(END_TIMEOUT_S))["report"]))

    async def kill(self) -> None:
        """End it, whatever state it is in: it may clear up first."""
        if self._process.returncode is None:
            if not self._finished:
                self._process.terminate()
            with suppress(TimeoutError):
                await asyncio.wait_for(self._process.wait(), CLEAR_UP_S)
        if self._process.returncode is None:
            self._process.kill()
        await self._process.wait()

    async def _listen(self, timeout_s: float) -> dict[str, Any]:
        """Its next line."""
        assert self._process.stdout is not None
        try:
            line = await asyncio.wait_for(self._process.stdout.readline(), timeout_s)
        except TimeoutError as error:
            raise SimulatorError(f"nothing for {timeout_s:g} s: {self._last_words()}") from error
        if not line:
            raise SimulatorError(self._last_words())
        said: dict[str, Any] = json.loads(line)
        return said

    def _last_words(self) -> str:
        words = self._words.read_text(errors="replace").strip().splitlines()
        return words[-1] if words else "no reason given"
