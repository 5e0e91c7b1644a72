"""MAVSDK against `companion-sitl`, as PX4 and as ArduPilot in real time: a flight.

Low and short. MAVSDK listens, as its tutorials have it: the vehicle finds it.
"""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing, asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.mission_raw import MissionItem
from mavsdk.plugins.offboard import AccelerationNed, Attitude, PositionNedYaw, VelocityNedYaw

from companion.base.autopilot_kind import AutopilotKind
from tests.scenario.real_time.serving import serving
from tests.unit.link.transport.transport_ends import free_port

PATIENCE_S = 60.0  # on a busy machine the vehicle slows down
HEIGHT_M = 3.0
RELATIVE_INT, WAYPOINT = 6, 16  # MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, MAV_CMD_NAV_WAYPOINT
FURTHER_DEG = 4e-5  # 4.4 m of latitude
SPEED_PARAMETERS: dict[AutopilotKind, str] = {"px4": "MPC_XY_CRUISE", "ardupilot": "WPNAV_SPEED"}


async def until(stream: Any, holds: Callable[[Any], bool]) -> Any:
    """The first of a telemetry stream's messages of which something holds."""
    async with asyncio.timeout(PATIENCE_S), aclosing(stream) as messages:
        async for message in messages:
            if holds(message):
                return message
    raise AssertionError("the stream has ended")


@asynccontextmanager
async def connected(port: int) -> AsyncIterator[Any]:
    """MAVSDK's system behind a port that it listens at."""
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    mavsdk = Mavsdk(configuration)
    configuration.destroy()
    try:
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = await mavsdk.first_autopilot(PATIENCE_S)
        assert system is not None
        yield system
    finally:
        await asyncio.to_thread(mavsdk.destroy)


async def fly_by_actions(system: Any, autopilot_kind: AutopilotKind, telemetry: TelemetryAsync) -> None:
    """Parameters, arm, take off, go to a place."""
    param, action = ParamAsync(system), ActionAsync(system)
    name = SPEED_PARAMETERS[autopilot_kind]
    value = await param.get_param_float(name)
    await param.set_param_float(name, value + 1.0)
    assert await param.get_param_float(name) == value + 1.0
    await until(telemetry.subscribe_health_all_ok(), bool)
    await action.set_takeoff_altitude(HEIGHT_M)
    await action.arm()
    await action.takeoff()
    place = await until(telemetry.subscribe_position(), lambda p: p.relative_altitude_m > HEIGHT_M - 0.4)
    assert await until(telemetry.subscribe_in_air(), bool)
    await action.goto_location(place.latitude_deg + 3e-5, place.longitude_deg, place.absolute_altitude_m, 0.0)
    await until(
        telemetry.subscribe_position(), lambda p: abs(p.latitude_deg - place.latitude_deg - 3e-5) < 5e-6
    )


async def fly_by_setpoints(system: Any, telemetry: TelemetryAsync) -> None:
    """Offboard: a position, a velocity, an acceleration and an attitude, one after the other."""
    offboard = OffboardAsync(system)
    here = (await until(telemetry.subscribe_position_velocity_ned(), lambda _: True)).position
    await offboard.set_position_ned(PositionNedYaw(here.north_m, here.east_m + 1.5, here.down_m, 0.0))
    await offboard.start()
    await until(
        telemetry.subscribe_position_velocity_ned(),
        lambda now: abs(now.position.east_m - here.east_m - 1.5) < 0.3,
    )
    await offboard.set_velocity_ned(VelocityNedYaw(-0.8, 0.0, 0.0, 0.0))
    await until(telemetry.subscribe_velocity_ned(), lambda v: v.north_m_s < -0.6)
    await offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    await until(telemetry.subscribe_velocity_ned(), lambda v: abs(v.north_m_s) < 0.2)
    await offboard.set_acceleration_ned(AccelerationNed(1.0, 0.0, 0.0))
    await until(telemetry.subscribe_velocity_ned(), lambda v: v.north_m_s > 0.5)
    await offboard.set_attitude(Attitude(0.0, 8.0, 0.0, 0.5))
    await until(telemetry.subscribe_attitude_euler(), lambda a: a.pitch_deg > 6.0)
    await offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    await until(telemetry.subscribe_velocity_ned(), lambda v: abs(v.north_m_s) < 0.2)
    await offboard.stop()


def waypoint(number: int, latitude_deg: float, longitude_deg: float) -> MissionItem:
    """An item at the flight's height; the vehicle goes on when it is within half a metre."""
    place = (round(latitude_deg * 1e7), round(longitude_deg * 1e7), HEIGHT_M)
    first = int(number == 0)
    return MissionItem(number, RELATIVE_INT, WAYPOINT, first, 1, 0.0, 0.5, 0.0, 0.0, *place, 0)


async def fly_a_mission(system: Any, autopilot_kind: AutopilotKind, telemetry: TelemetryAsync) -> None:
    """Upload, read back, fly to the north and half the way back."""
    mission = MissionRawAsync(system)
    here = await until(telemetry.subscribe_position(), lambda _: True)
    goals = [here.latitude_deg + FURTHER_DEG, here.latitude_deg + 0.5 * FURTHER_DEG]
    places = [here.latitude_deg, *goals] if autopilot_kind == "ardupilot" else goals  # its item 0 is home
    items = [waypoint(n, latitude, here.longitude_deg) for n, latitude in enumerate(places)]
    await mission.upload_mission(items)
    read = await mission.download_mission()
    assert [item.x for item in read[-2:]] == [item.x for item in items[-2:]]
    await mission.start_mission()
    for goal_deg in goals:
        await until(telemetry.subscribe_position(), partial(is_near, goal_deg))


def is_near(latitude_deg: float, position: Any) -> bool:
    """Whether a telemetry position is within a metre or so of a latitude."""
    return bool(abs(position.latitude_deg - latitude_deg) < 1e-5)


async def land(system: Any, telemetry: TelemetryAsync) -> None:
    """Land, and wait until it has disarmed itself."""
    await ActionAsync(system).land()
    await until(telemetry.subscribe_armed(), lambda armed: not armed)
    assert not await until(telemetry.subscribe_in_air(), lambda _: True)


async def whole_flight(autopilot_kind: AutopilotKind, folder: Path) -> None:
    port = free_port()
    with serving(autopilot_kind, "--port", port, "--folder", folder):
        async with connected(port) as system:
            telemetry = TelemetryAsync(system)
            await fly_by_actions(system, autopilot_kind, telemetry)
            await fly_by_setpoints(system, telemetry)
            await fly_a_mission(system, autopilot_kind, telemetry)
            await land(system, telemetry)


async def test_mavsdk_flies_both_autopilots(tmp_path: Path) -> None:
    folders = tmp_path / "p", tmp_path / "a"
    for folder in folders:
        folder.mkdir()
    async with asyncio.TaskGroup() as group:
        group.create_task(whole_flight("px4", folders[0]))
        group.create_task(whole_flight("ardupilot", folders[1]))
