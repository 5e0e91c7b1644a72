"""What was made fast is what it was: sleeping chips, surfaces out of reach, geodetic places, ticks."""

from __future__ import annotations

import asyncio
import math

import numpy as np
import pymap3d
import pytest

from companion.base.clock import Clock, run_in_virtual_time
from companion.base.geometry import GRAVITY_M_S2, Vector3, geodetic_from_ned, quat_from_euler
from companion.base.messages import Frame, Phase
from sitl.devices.mpu9250 import Ak8963Device, Mpu9250Device
from sitl.devices.ports import MemoryPort
from sitl.run.simulation import Simulation
from sitl.scenario.scenario import load_scenario
from sitl.sensors.inertial import ImuErrors, ImuSensor
from sitl.sensors.sensors import MagErrors, MagSensor
from sitl.vehicle.quadrotor import QuadrotorState
from sitl.world.world import World

CHIP = 0x68
STEP_S = 1.0 / 400.0
# longer than a sleeping chip notes, so that it has to forget, and not a multiple of it
SLEPT_STEPS = 9377


def noisy_chip() -> Mpu9250Device:
    rng, mag_rng = np.random.default_rng(3).spawn(2)
    magnetometer = Ak8963Device(MagSensor(MagErrors(), mag_rng, np.eye(3)))
    return Mpu9250Device(ImuSensor(ImuErrors(), rng, STEP_S, np.eye(3)), magnetometer, clock_error=0.0031)


def feel(chip: Mpu9250Device, first: int, last: int) -> None:
    for k in range(first, last):
        t = k * STEP_S
        force = (math.sin(3.0 * t), 0.4 * math.cos(t), -GRAVITY_M_S2)
        chip.step(t, force, (0.1 * math.sin(t), 0.2, -0.1), (20.0, 1.0, 40.0), 0.3 + 0.2 * math.sin(t))


@pytest.mark.parametrize("slept", [7, 400, SLEPT_STEPS])
def test_a_reader_cannot_tell_that_the_chip_has_slept(slept: int) -> None:
    def told(*, awake: bool) -> bytes:
        chip = noisy_chip()
        if awake:
            chip.wake()
        feel(chip, 0, slept)
        told = chip.read(CHIP, 0x3A, 15)
        for register, value in ((0x19, 1), (0x1A, 0x42), (0x23, 0xF8), (0x6A, 0x04), (0x6A, 0x40)):
            chip.write(CHIP, register, value)
        feel(chip, slept, slept + 12)
        return told + chip.read(CHIP, 0x74, 200)

    asleep, awake = told(awake=False), told(awake=True)
    assert any(asleep[1:])
    assert asleep == awake


def test_without_a_fifo_the_newest_sample_is_the_one_of_a_chip_that_keeps_all() -> None:
    chips = noisy_chip(), noisy_chip()
    for chip in chips:
        chip.write(CHIP, 0x1A, 0x02)
    chips[1].write(CHIP, 0x6A, 0x40)
    for k in range(50):
        for chip in chips:
            feel(chip, k, k + 1)
        assert chips[0].read(CHIP, 0x3B, 14) == chips[1].read(CHIP, 0x3B, 14)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (850.0, -1200.0, -75.0), (-3.0, 4.0, 30.0)])
@pytest.mark.parametrize("origin", [(47.0, 8.0, 400.0), (-35.4, 149.2, 584.0), (0.0, -179.9, -20.0)])
def test_places_on_the_ellipsoid_are_the_librarys(place: Vector3, origin: Vector3) -> None:
    latitude, longitude, altitude = geodetic_from_ned(place, origin)
    expected = [float(value) for value in pymap3d.ned2geodetic(*place, *origin)]
    assert (latitude, longitude) == pytest.approx(expected[:2], abs=1e-12)
    assert altitude == pytest.approx(expected[2], abs=1e-7)


def test_what_was_touched_is_forgotten_out_of_reach() -> None:
    world = World(load_scenario("static"), 0)
    for _ in range(40):
        world.step((0.0, 0.0, 0.0, 0.0), STEP_S)
    stood = world.truth().in_contact
    state = world.state
    # as if thrown up within a step: nothing may be left of the contact
    world._state = QuadrotorState((*state.position_ned_m[:2], -5.0), attitude=quat_from_euler(0.0, 0.0, 0.0))
    world.step((0.0, 0.0, 0.0, 0.0), STEP_S)
    assert (stood, world.truth().in_contact) == (True, False)
    assert world.state.specific_force_body_m_s2 == pytest.approx((0.0, 0.0, 0.0), abs=0.05)


# ---------------------------------------------------------------- a vehicle served alone


class DeafLink:
    """A line on which nobody speaks."""

    def __init__(self) -> None:
        self.sent = b""

    async def read(self) -> bytes:
        await asyncio.Event().wait()
        return b""

    def write(self, data: bytes) -> None:
        self.sent += data


def simulation(link: DeafLink, frames: list[Frame], *, camera: bool) -> Simulation:
    return Simulation(
        load_scenario("static"),
        0,
        link=link,
        gps_port=MemoryPort(9600),
        range_port=MemoryPort(9600),
        deliver_frame=frames.append,
        camera_wanted=lambda: camera,
    )


def served(*, camera: bool) -> tuple[bytes, list[Frame]]:
    link, frames = DeafLink(), list[Frame]()

    async def serve() -> None:
        world = asyncio.create_task(simulation(link, frames, camera=camera).run())
        await Clock().sleep_until(0.5)
        world.cancel()

    run_in_virtual_time(serve())
    return link.sent, frames


def test_a_camera_that_nobody_wants_renders_nothing_and_changes_nothing_else() -> None:
    without, no_frames = served(camera=False)
    sent, frames = served(camera=True)
    assert not no_frames
    assert len(frames) > 10
    assert without == sent


def test_a_world_that_fails_ends_the_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: World, *_arguments: object) -> None:
        raise ArithmeticError("no such world")

    async def serve() -> None:
        world = simulation(DeafLink(), [], camera=False)
        monkeypatch.setattr(World, "step", fail)
        await world.run()

    with pytest.raises(ExceptionGroup, match="unhandled errors") as caught:
        run_in_virtual_time(serve())
    assert caught.group_contains(ArithmeticError, match="no such world")


def test_a_cancelled_simulation_ticks_no_more() -> None:
    async def serve() -> float:
        world = simulation(DeafLink(), [], camera=False)
        task = asyncio.create_task(world.run())
        await Clock().sleep_until(0.2)
        task.cancel()
        await Clock().sleep_until(1.0)
        return world.report(Phase.ABORT).duration_s

    assert run_in_virtual_time(serve()) < 0.25
