"""A pilot flies a vehicle whose companion stands by with `orders.flight_mode`; he alone orders a landing.

`own_take_off`: the autopilot's own take-off ends in the mode that orders, or goes through it. `link_back`:
the pilot orders a landing by that mode, the link is lost in it until the app has given up, and comes back
with the vehicle in that mode. What the app sends unasked counts from `WitnessedFlight.unasked_from_s` on.
"""

import asyncio
from collections.abc import Callable
from typing import Final

from benchmarks.faults.cases import StandingBy
from benchmarks.faults.witness import WitnessedFlight
from companion.app.app import App
from companion.base.clock import Clock
from companion.base.messages import Phase
from sitl.autopilot.flight.modes import CommandResult
from sitl.run.in_process import InProcess

HEIGHT_M: Final = 6.0
LOOK_S: Final = 0.1
READY_S: Final = 60.0
UP_S: Final = 40.0
ARMED_S: Final = 1.0
BY_HAND_S: Final = 3.0  # several heartbeats
OBEYED_S: Final = 60.0
GIVEN_UP_S: Final = 120.0
WATCHED_S: Final = 20.0  # heartbeats come once a second; what is chosen counts 3 s after a standby begins


class StoryFailed(RuntimeError):  # noqa: N818 - it reads as what happened
    """The story did not come to its point: the bench's fault, and no verdict on the app."""


async def play(story: StandingBy, app: App, vehicle: InProcess, record: WitnessedFlight) -> None:
    """Fly the story; the app, which stays, is running.

    Raises:
        StoryFailed: a step of it does not come about.
    """
    simulation, autopilot, clock = vehicle.simulation, vehicle.simulation.autopilot, Clock()

    async def until(holds: Callable[[], bool], most_s: float, what: str) -> None:
        by_s = simulation.world.time_s + most_s
        while not holds():
            if simulation.world.time_s >= by_s:
                raise StoryFailed(f"not within {most_s:g} s: {what}")
            await asyncio.sleep(LOOK_S)

    def ready() -> bool:
        state = app.estimator.vehicle(clock.now_s())
        aligned = state is not None and state.aligned and state.origin is not None
        return aligned and autopilot.ready_to_arm and app.session.state.home is not None

    px4 = autopilot.profile.name == "px4"
    vehicle.wants_frames = False
    await until(ready, READY_S, "ready")
    record.unasked_from_s = simulation.world.time_s
    if not px4:
        autopilot.set_mode_named("GUIDED")
    await until(lambda: autopilot.arm() is CommandResult.ACCEPTED, READY_S, "armed")
    await asyncio.sleep(ARMED_S)
    home_m = autopilot.geodetic(autopilot.home_ned_m)[2] if px4 else 0.0
    if autopilot.take_off(home_m + HEIGHT_M) is not CommandResult.ACCEPTED:
        raise StoryFailed("the take-off is refused")
    await until(lambda: -simulation.world.state.position_ned_m[2] > HEIGHT_M - 0.8, UP_S, "airborne")
    if story == "link_back":
        await asyncio.sleep(BY_HAND_S)
        autopilot.set_mode_named("POSCTL" if px4 else "LOITER")
        await asyncio.sleep(BY_HAND_S)
        record.unasked_from_s, vehicle.wants_frames = float("inf"), True
        autopilot.set_mode_named("AUTO_LOITER" if px4 else "GUIDED")
        await until(lambda: simulation.faults.all_begun, OBEYED_S, "the landing that was ordered")
        vehicle.wants_frames = False
        await until(lambda: app.phase is Phase.STANDBY, GIVEN_UP_S, "given up")
        record.unasked_from_s = simulation.world.time_s
        await until(lambda: app.session.state.connected, GIVEN_UP_S, "the link is back")
    await asyncio.sleep(WATCHED_S)
