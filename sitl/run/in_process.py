"""A simulated vehicle in the caller's own process and on its loop, in virtual time or in real time.

The app's drivers get what hardware gives them: a register bus, two serial lines and a camera. For flights in
SITL, for campaigns, and for tools with a vehicle that stands or is carried by hand:

    async def main() -> None:
        async with carried("static", seed=0, motion="tumble") as vehicle:
            driver = Mpu9250(vehicle.imu_bus, ImuConfig())
            ...                               # await asyncio.sleep(...), poll, await vehicle.frames.next()
            truth = vehicle.simulation.sensor_truth

    run_in_virtual_time(main())
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

from companion.base.messages import Frame
from sitl.devices.ports import AppEnd, MemoryPort
from sitl.faults.targets import ComputerFaults
from sitl.firmware.spec import FirmwareSpec
from sitl.run.mavlink_line import ByteLink
from sitl.run.simulation import Simulation
from sitl.scenario.scenario import Scenario, load_scenario
from sitl.vehicle import HandMotion

GPS_BAUD: Final = 38400
RANGE_BAUD: Final = 9600


class MemoryFrames:
    """The camera of an app in the same process: the newest frame replaces the one before."""

    def __init__(self) -> None:
        self._frame: Frame | None = None
        self._arrived = asyncio.Event()

    def deliver(self, frame: Frame) -> None:
        self._frame = frame
        self._arrived.set()

    async def next(self) -> Frame:
        """Wait for a frame newer than the last. For one reader."""
        await self._arrived.wait()
        self._arrived.clear()
        assert self._frame is not None
        return self._frame

    def close(self) -> None:
        """Nothing to release."""


class InProcess:
    """A simulation with its devices. Make it inside the running loop; its world begins with `simulation.run`.

    Set `wants_frames` to False when no frames are needed: rendering is most of a simulation's cost.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        *,
        motion: HandMotion | None = None,
        link: ByteLink | None = None,
        gps_baud: int = GPS_BAUD,
        firmware: FirmwareSpec | None = None,
        computer: ComputerFaults | None = None,
        signing_key: bytes | None = None,
        keep_truth: bool = True,
    ) -> None:
        """Build it; `motion`: it is carried by hand; `link` is the vehicle's end of the MAVLink line.

        Without `keep_truth` nothing is stored for `simulation.report`, which a long flight would fill up.
        A `firmware` flies it in lockstep; `simulation.close` ends that. `computer` takes the faults of the
        companion computer, for a harness that applies them to the app. With a `signing_key` the vehicle's
        links are signed.

        Raises:
            ConfigError: a settings file that the scenario names is missing or wrong.
        """
        self.wants_frames = True
        self.frames = MemoryFrames()
        gps_line, range_line = MemoryPort(gps_baud), MemoryPort(RANGE_BAUD)
        self.gps_port: AppEnd = gps_line.app
        self.range_port: AppEnd = range_line.app
        self.simulation = Simulation(
            scenario,
            seed,
            motion=motion,
            link=link,
            gps_port=gps_line,
            range_port=range_line,
            deliver_frame=self.frames.deliver,
            camera_wanted=lambda: self.wants_frames,
            firmware=firmware,
            computer=computer,
            signing_key=signing_key,
            keep_truth=keep_truth,
        )
        self.imu_bus = self.simulation.imu_bus  # the register bus with the MPU9250 on it


@asynccontextmanager
async def carried(
    scenario: str | Path | Scenario,
    seed: int,
    motion: HandMotion,
    *,
    link: ByteLink | None = None,
    camera: bool = True,
) -> AsyncIterator[InProcess]:
    """A vehicle that is carried by hand, as a context; see the module's docstring.

    Args:
        scenario: a name, a file or a scenario: its pad, camera, sensors and autopilot profile.
        seed: repeats it.
        motion: how it is carried.
        link: the vehicle's end of a MAVLink line, None without one.
        camera: whether frames are rendered.

    Raises:
        ConfigError: the scenario, or a file that it names, is missing or wrong.
        Exception: whatever ended the world while inside, on leaving.
    """
    loaded = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    vehicle = InProcess(loaded, seed, motion=motion, link=link)
    vehicle.wants_frames = camera
    world: asyncio.Task[Any] = asyncio.create_task(vehicle.simulation.run())
    try:
        yield vehicle
    finally:
        world.cancel()
        await asyncio.wait([world])
    if not world.cancelled():
        world.result()  # it has failed
