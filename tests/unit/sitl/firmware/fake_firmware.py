"""Firmwares that are none: programs with the other side of each protocol, and what they may be told."""

import json
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import Vector3
from companion.config import find_file, load_model
from companion.link.codec import mavlink
from sitl.firmware.process import Firmware, Moment, Setup
from sitl.firmware.px4 import Barometer
from sitl.firmware.spec import FirmwareSpec
from sitl.firmware.vehicle import start_firmware
from sitl.mavlink.framing import FrameReader
from sitl.scenario.scenario import AirframeConfig
from sitl.sensors.autopilot_sensors import Field, Fix, ImuReading, SimulatedAutopilotSensors
from sitl.sensors.sensors import GpsReading
from sitl.vehicle.quadrotor import QuadrotorState, resting_state
from tests.scenario.flying import alive
from tests.waiting import soon

SOURCE = Path(__file__).with_name("fake_program.py")
HOME: Vector3 = (47.0, 8.0, 400.0)
FIELD_NED_UT: Vector3 = (20.9, 0.6, 42.9)
STEP_S = 1.0 / 400.0
DEFAULTS: dict[str, Any] = {
    "says": "booting",
    "calls": True,
    "boot_steps": 0,
    "ready": True,
    "armed": False,
    "text": "",
    "motors": None,
    "repeats": 0,
    "silent_after": None,
    "ends_after": None,  # -1: at once
    "status": 3,
}


@dataclass(frozen=True)
class Fake:
    """A program that was written; `spec` names it."""

    spec: FirmwareSpec

    @property
    def instances(self) -> list[int]:
        """Those that have been started, in order."""
        paths = self.spec.path.parent.glob("*.started")
        return sorted(int(path.stem.rpartition("-")[2]) for path in paths)

    @property
    def started(self) -> dict[str, Any]:
        """How the only one was started: its words, its folder and what it was told."""
        (instance,) = self.instances
        told: dict[str, Any] = json.loads(self._beside(instance, "started").read_text())
        return told

    @property
    def is_gone(self) -> bool:
        """Whether no process and no temporary folder is left of it, which a moment later may still be."""
        started = [json.loads(self._beside(i, "started").read_text()) for i in self.instances]
        return soon(lambda: not any(alive(told["pid"]) or Path(told["folder"]).exists() for told in started))

    @property
    def sensors(self) -> list[Any]:
        """PX4: messages; ArduCopter: what the lines of JSON hold."""
        (instance,) = self.instances
        data = self._beside(instance, "sensors").read_bytes()
        return messages(data) if self.spec.kind == "px4" else [json.loads(s) for s in data.splitlines()]

    @property
    def mavlink(self) -> list[Any]:
        """What it heard by its MAVLink."""
        (instance,) = self.instances
        return messages(self._beside(instance, "mavlink").read_bytes())

    def _beside(self, instance: int, what: str) -> Path:
        return self.spec.path.with_name(f"{self.spec.path.name}-{instance}.{what}")


def fake(
    kind: AutopilotKind, folder: Path, parameters: dict[str, float] | None = None, **behaviour: Any
) -> Fake:
    """Write a program as a SITL build has it; see DEFAULTS for how it may behave."""
    assert set(behaviour) <= set(DEFAULTS)
    path = folder / kind / "bin" / {"px4": "px4", "ardupilot": "arducopter"}[kind]
    path.parent.mkdir(parents=True)
    path.write_text(f"#!{sys.executable} -IS\n{SOURCE.read_text()}")
    path.chmod(0o755)
    path.with_name(f"{path.name}.json").write_text(json.dumps({**DEFAULTS, **behaviour}))
    if kind == "px4":
        script = folder / kind / "etc" / "init.d-posix" / "rcS"
        script.parent.mkdir(parents=True)
        script.touch()
    return Fake(FirmwareSpec(kind, path.resolve(), tuple((parameters or {}).items())))


@contextmanager
def running(program: Fake, setup: Setup | None = None) -> Iterator[Firmware]:
    """Start it as the simulation does, which has not let it boot."""
    firmware = start_firmware(
        program.spec, setup or setup_of(program.spec), Barometer(np.random.default_rng(0))
    )
    with closing(firmware):
        yield firmware


def setup_of(spec: FirmwareSpec, **changes: Any) -> Setup:
    airframe = load_model(AirframeConfig, find_file("airframes", "x500"))
    setup = Setup(airframe, HOME, 0.12, dict(spec.parameters))
    return setup._replace(**changes)


def sensors_at_rest(seed: int = 1) -> SimulatedAutopilotSensors:
    return SimulatedAutopilotSensors(
        np.random.default_rng(seed), STEP_S, home=HOME, field_ned_ut=FIELD_NED_UT, imu_filter=1
    )


def moment(clock_s: float, state: QuadrotorState | None = None, **sensed: Any) -> Moment:
    """A time with made-up sensors; `sensed` may have force, rate, field and fix."""
    sensors = sensors_at_rest()
    force, rate = sensed.get("force", (0.0, 0.0, -9.8)), sensed.get("rate", (0.0, 0.0, 0.0))
    sensors.imu = ImuReading(clock_s, force, rate)
    sensors.mag = Field(sensed.get("mag_s", clock_s), sensed.get("field", FIELD_NED_UT))
    sensors.gps = sensed.get("fix")
    return Moment(clock_s, sensors, state or resting_state((0.0, 0.0, 0.0), 0.0))


def fix(time_s: float, velocity_ned_m_s: Vector3) -> Fix:
    """A receiver's epoch at a place with that velocity."""
    return Fix(time_s, GpsReading(47.1234567, -8.7654321, 432.1, velocity_ned_m_s, 2.5, 3.8, 0.3, 11))


def moments(count: int, first_s: float = STEP_S) -> list[Moment]:
    """So many in a row, one a step."""
    return [moment(first_s + n * STEP_S) for n in range(count)]


def step_on(firmware: Firmware, count: int) -> None:
    """So many steps."""
    for at in moments(count):
        firmware.step(at)


def messages(data: bytes) -> list[Any]:
    """MAVLink out of bytes."""
    decoder = mavlink.MAVLink(None)
    return [decoder.decode(bytearray(frame.data)) for frame in FrameReader().read(data, 0.0)]


def open_files() -> int:
    """How many files this process has open."""
    return len(list(Path("/proc/self/fd").iterdir()))


def given(program: Fake, setup: Setup | None = None) -> dict[str, str]:
    """The parameters that it is started with, by name, as they are written."""
    with running(program, setup):
        pass
    if program.spec.kind == "ardupilot":
        return dict(line.split() for line in program.started["parameters"].splitlines())
    prefix = "PX4_PARAM_"
    return {n.removeprefix(prefix): value for n, value in program.started.items() if n.startswith(prefix)}


def heard(firmware: Firmware) -> list[Any]:
    """What it says by its MAVLink."""
    return messages(b"".join(firmware.read()))
