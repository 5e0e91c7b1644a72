"""A companion in standby against the bundled simulator, in virtual time, with a pilot and a ground station.

A story is a coroutine that flies the vehicle by its own autopilot and gives orders; the companion and the
world run beside it. All of it speaks MAVLink over the one link, as behind a router.
"""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import closing
from pathlib import Path
from typing import Any, Final

from companion.app.app import App
from companion.app.hardware import make_own_actions
from companion.base.autopilots import mode_parameters
from companion.base.clock import Clock, run_in_virtual_time
from companion.base.messages import LandedState, Phase
from companion.config import CONFIG_FOLDER, merge, validate
from companion.flightlog.flights_recorder import FlightsRecorder
from companion.link.codec import Codec, command_long, mavlink
from companion.link.transport import MemoryTransport, memory_pair
from companion.sense.vision.opencv import prepare_opencv
from companion.sim.runner import hardware_of
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from sitl.run.in_process import InProcess
from sitl.scenario.scenario import Scenario

GROUND, COMPONENT = 255, 191
LOOK_S: Final = 0.1


class Tapped:
    """The app's end of the link; what it sends is kept, as messages."""

    def __init__(self, end: MemoryTransport) -> None:
        self._end, self._codec = end, Codec(GROUND)
        self.sent: list[Any] = []

    async def read(self) -> bytes:
        return await self._end.read()

    def write(self, data: bytes) -> None:
        self.sent += self._codec.decode(data)
        self._end.write(data)

    def close(self) -> None:
        self._end.close()


class StoryField:
    """What a story sees and does."""

    def __init__(
        self, start: Callable[[], App], vehicle: InProcess, tapped: Tapped, to_app: MemoryTransport
    ) -> None:
        self._start, self.vehicle, self._tapped, self._to_app = start, vehicle, tapped, to_app
        self._codec = Codec(GROUND, 190)
        self.clock = Clock()
        self.app = start()
        self.running = asyncio.create_task(self.app.run())

    async def restart(self) -> None:
        """End the app as a kill does, in the middle of whatever it does, and start another."""
        self.running.cancel()
        await asyncio.wait([self.running])
        self.app = self._start()
        self.running = asyncio.create_task(self.app.run())

    async def until_it_ends(self) -> None:
        """Wait for the app's end, which is a failure; a restart is none."""
        while True:
            await asyncio.wait([self.running])
            if not self.running.cancelled():
                self.running.result()
                return
            await asyncio.sleep(LOOK_S)

    @property
    def autopilot(self) -> Any:
        """What the app knows of the autopilot."""
        return self.app.session.state

    @property
    def notices(self) -> list[str]:
        """The last texts told."""
        return [notice.text for notice in self.app.announcer.recent]

    def acks(self, number: int) -> list[int]:
        """The results of the COMMAND_ACKs to the ground station for a command, in order."""
        return [
            m.result
            for m in self._tapped.sent
            if m.get_type() == "COMMAND_ACK" and m.command == number and m.target_system == GROUND
        ]

    def forget(self) -> None:
        """Drop what was kept for the story, which would fill up the memory of a long one."""
        self._tapped.sent.clear()

    def commands(self) -> list[int]:
        """The commands that the app sent the autopilot, but for requests of messages."""
        asking = {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE}
        found = [m for m in self._tapped.sent if m.get_type() in ("COMMAND_LONG", "COMMAND_INT")]
        return [m.command for m in found if m.command not in asking]

    def texts(self) -> list[str]:
        """The texts that the app sent, each put together from its chunks."""
        whole: dict[tuple[int, int], str] = {}
        for number, m in enumerate(m for m in self._tapped.sent if m.get_type() == "STATUSTEXT"):
            key = (m.id, 0 if m.id else number)
            whole[key] = whole.get(key, "") + m.text
        return list(whole.values())

    def setpoints(self) -> int:
        """How many setpoints the app has sent."""
        return sum(m.get_type().startswith("SET_") for m in self._tapped.sent)

    async def until(self, holds: Callable[[], bool], most_s: float, what: str) -> None:
        """Wait for something to hold."""
        by_s = self.clock.now_s() + most_s
        while not holds():
            assert self.clock.now_s() < by_s, f"not within {most_s:g} s: {what}; {self.notices[-6:]}"
            await asyncio.sleep(LOOK_S)

    async def ready(self) -> None:
        """Until an order could be followed once the vehicle flies."""
        await self.until(lambda: self.autopilot.ready_to_arm, 60.0, "ready to arm")
        await self.until(lambda: self.autopilot.ekf_ready is not False, 60.0, "the autopilot's estimate")
        await self.until(lambda: self.autopilot.home is not None, 60.0, "home")
        await self.until(self.aligned, 60.0, "aligned")

    def aligned(self) -> bool:
        """Whether our own estimate is there."""
        vehicle = self.app.estimator.vehicle(self.clock.now_s())
        return vehicle is not None and vehicle.aligned and vehicle.origin is not None

    async def phase(self, phase: Phase, most_s: float = 60.0) -> None:
        """Until the companion is in a phase."""
        await self.until(lambda: self.app.phase is phase, most_s, phase.value)

    def pilot(self, number: int, *parameters: float) -> None:
        """A command of the ground station's to the autopilot."""
        filled = (*parameters, *(0.0,) * (7 - len(parameters)))
        self._tapped._end.write(self._codec.encode(command_long(number, filled, 1, 1)))

    def pilot_mode(self, mode: str) -> None:
        """The pilot's flight mode."""
        assert self.autopilot.autopilot_kind is not None
        self.pilot(mavlink.MAV_CMD_DO_SET_MODE, *mode_parameters(self.autopilot.autopilot_kind, mode))

    async def take_off(self, height_m: float = 6.0) -> None:
        """The pilot takes off, and the autopilot hovers."""
        guided = self.autopilot.autopilot_kind == "ardupilot"
        if guided:  # ArduPilot takes off in no other mode
            self.pilot_mode("GUIDED")
            await self.until(lambda: self.autopilot.mode == "GUIDED", 10.0, "GUIDED")
        self.pilot(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        await self.until(lambda: self.autopilot.armed, 10.0, "armed")
        home_m = 0.0 if guided else self.autopilot.home[2]
        self.pilot(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, float("nan"), *_NOWHERE, home_m + height_m)
        await self.until(lambda: self.height_m > height_m - 0.6, 40.0, "airborne")
        await asyncio.sleep(3.0)

    @property
    def height_m(self) -> float:
        """Over home, as the autopilot has it."""
        state = self.autopilot
        if state.global_position is None or state.home is None:
            return 0.0
        return float(state.global_position[2] - state.home[2])

    def order(self, number: int = mavlink.MAV_CMD_NAV_LAND, *parameters: float) -> None:
        """An order of the ground station's to the companion."""
        self.to_companion(command_long(number, parameters, 1, COMPONENT))

    def to_companion(self, message: Any, codec: Codec | None = None) -> None:
        """A message on the link."""
        self._to_app.write((codec or self._codec).encode(message))

    async def landed(self, most_s: float = 120.0) -> None:
        """Until the vehicle was landed by the companion, is disarmed, and the companion stands by again."""
        await self.until(lambda: self.app.phase is not Phase.STANDBY, 5.0, "taken")
        await self.phase(Phase.LANDED, most_s)
        assert not self.autopilot.armed
        # the motors may be off before the autopilot's own detector has made up its mind
        await self.until(lambda: self.autopilot.landed is LandedState.ON_GROUND, 5.0, "on the ground")
        await self.phase(Phase.STANDBY, 20.0)


_NOWHERE: Final = (float("nan"), float("nan"))
Story = Callable[[StoryField], Awaitable[None]]


def stand_by(
    story: Story,
    changes: dict[str, Any] | None = None,
    *,
    settings: dict[str, Any] | None = None,
    record: Path | None = None,
    base: str = "static",
) -> None:
    """Play a story with `changes` to a shipped scenario and `settings` over the app's own."""
    prepare_opencv()
    run_in_virtual_time(_stand_by(story, changes or {}, settings or {}, record, base))


async def _stand_by(
    story: Story, changes: dict[str, Any], settings: dict[str, Any], record: Path | None, base: str
) -> None:
    trial = Trial.load(base, 0)
    scenario = validate(
        Scenario, merge(trial.scenario.model_dump(), {"time_limit_s": 900.0, **changes}), "story"
    )
    trial = Trial(trial.path, scenario, 0)
    flown = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)
    # as on the vehicle, not as on the desk
    ours = merge({"plan": {"mission": {"may_arm": False}}}, settings)
    config = validate(type(flown), merge(flown.model_dump(), ours), "story")
    app_end, vehicle_end = memory_pair()
    tapped = Tapped(app_end)
    vehicle = InProcess(scenario, 0, link=vehicle_end, gps_baud=config.sense.gps.baud, keep_truth=False)
    hardware = hardware_of(vehicle, tapped, config)
    log = FlightsRecorder(record, lambda: 1.7e9)

    def start() -> App:
        return App(config, hardware, log, make_own_actions, stays=True)

    with closing(vehicle.simulation), closing(log):
        world = asyncio.create_task(vehicle.simulation.run())
        field = StoryField(start, vehicle, tapped, vehicle_end)
        watched = [world, asyncio.create_task(field.until_it_ends())]
        told = asyncio.create_task(_told(story, field))
        try:
            await asyncio.wait([*watched, told], return_when=asyncio.FIRST_COMPLETED)
            for task in watched:
                if task.done():
                    task.result()  # a failure of the app's or the world's is the story's
            await told
        finally:
            ended: list[asyncio.Task[Any]] = [*watched, field.running, told]
            for task in ended:
                task.cancel()
            await asyncio.gather(*ended, return_exceptions=True)


async def _told(story: Story, field: StoryField) -> None:
    await story(field)
