"""The check over the pad in virtual time, on a simulated vehicle that is carried as the check asks."""

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from companion.app.hardware import Hardware
from companion.base.clock import Clock
from companion.base.messages import Frame, ImuSample, MagSample, PadSighting, RangeSample
from companion.config import CONFIG_FOLDER, CompanionConfig, merge, validate
from companion.link.transport import memory_pair
from companion.sense.camera.source import FrameSource
from companion.sim.settings import SIMULATED_HARDWARE
from companion.tools.pad_check.causes import Mounting
from companion.tools.pad_check.moves import RecentSamples
from companion.tools.pad_check.session import PadCheck
from companion.tools.pad_check.wizard import Report, Say
from sitl.run.in_process import carried
from sitl.scenario.scenario import Scenario
from sitl.vehicle import HandMotion
from tests.virtual_time import in_virtual_time

SEED = 3
# as the shipped settings have it
MOUNTING = Mounting(
    vehicle="x500",
    camera="sitl_640x480",
    pad="moving_1300",
    camera_yaw_deg=0.0,
    camera_tilt_deg=0.0,
    body_from_sensor_deg=(180.0, 0.0, 0.0),
    range_position_body_m=(-0.03, 0.0, 0.08),
    field_ned_ut=(20.9, 0.6, 42.9),
)


@dataclass
class Checked:
    """A check that has ended, and what it said."""

    report: Report
    said: list[Say]
    heard: list[tuple[float, Any]]  # every sample, with the time when it came

    @property
    def failed(self) -> set[str]:
        """The names of what is not well."""
        return {finding.name for finding in self.report.findings if not finding.passed}

    def cause(self, name: str) -> str:
        """What a finding is put down to."""
        return self.report.causes[name]


class ChangedFrames:
    """A camera whose images are changed on their way."""

    def __init__(self, source: FrameSource, change: Callable[[Frame], Frame]) -> None:
        self._source, self._change = source, change

    async def next(self) -> Frame:
        """The next frame, changed."""
        return self._change(await self._source.next())

    def close(self) -> None:
        """Nothing to give back."""


class KeptSamples(RecentSamples):
    """Samples that also keep all of them in the order in which they came."""

    def __init__(self) -> None:
        super().__init__()
        self.all: list[tuple[float, Any]] = []
        self._clock = Clock()

    def _note(self, sample: Any) -> None:
        self.all.append((self._clock.now_s(), sample))

    def add_imu(self, sample: ImuSample, received_s: float = math.inf) -> None:
        """See `RecentSamples`."""
        self._note(sample)
        super().add_imu(sample)

    def add_mag(self, sample: MagSample) -> None:
        """See `RecentSamples`."""
        self._note(sample)
        super().add_mag(sample)

    def add_range(self, sample: RangeSample) -> None:
        """See `RecentSamples`."""
        self._note(sample)
        super().add_range(sample)

    def add_sighting(self, sighting: PadSighting) -> None:
        """See `RecentSamples`."""
        self._note(sighting)
        super().add_sighting(sighting)


def _nowhere(data: bytes) -> None:
    """Where what is written gets lost."""


def mirrored(frame: Frame) -> Frame:
    """As a flip in the driver makes it."""
    return replace(frame, image=np.ascontiguousarray(frame.image[:, ::-1]))


def settings(**overrides: Any) -> CompanionConfig:
    """The app's settings for the simulated boards."""
    return validate(CompanionConfig, merge(SIMULATED_HARDWARE, overrides), "test")


def vehicle_file(folder: Path, **values: Any) -> str:
    """The shipped vehicle's file with other values, as a path."""
    shipped = yaml.safe_load((CONFIG_FOLDER / "vehicles" / "x500.yaml").read_text())
    path = folder / "vehicle.yaml"
    path.write_text(yaml.safe_dump({**shipped, **values}))
    return str(path)


@in_virtual_time
async def check(
    config: CompanionConfig | None = None,
    *,
    motion: HandMotion = "over-pad",
    seed: int = SEED,
    change: Callable[[Frame], Frame] | None = None,
    linked: bool = False,
    deaf: bool = False,
    arm: bool = False,
    silent_from_s: float | None = None,
    **scenario: Any,
) -> Checked:
    """Run a whole check.

    `deaf`: nobody is at the other end of the line, `silent_from_s`: nobody any more, `arm`: the vehicle is
    armed.
    """
    pad = {"motion": {"kind": "static", "meet": {"point_ned_m": [10.0, 0.0]}}}
    # ten frames a second are enough, and quick
    camera = {"rate_hz": 12.0, **scenario.pop("camera", {})}
    described = {"name": "x", "description": "x", "pad": pad, "camera": camera, **scenario}
    carried_in = validate(Scenario, described, "test")
    said = list[Say]()
    app_end, vehicle_end = memory_pair()
    heard = KeptSamples()
    line = vehicle_end if linked and not deaf else None
    async with carried(carried_in, seed, motion, link=line) as vehicle:
        if arm:
            vehicle.simulation.autopilot.arm(force=True)
        if silent_from_s is not None:
            asyncio.get_running_loop().call_later(silent_from_s, setattr, vehicle_end, "write", _nowhere)
        frames = vehicle.frames if change is None else ChangedFrames(vehicle.frames, change)
        boards = config is None or config.sense.source == "boards"
        hardware = Hardware(
            app_end,
            frames,
            imu_bus=vehicle.imu_bus if boards else None,
            range_port=vehicle.range_port if boards else None,
        )
        checking = PadCheck(config or settings(), hardware, said.append, linked=linked, samples=heard)
        return Checked(await checking.run(), said, heard.all)
