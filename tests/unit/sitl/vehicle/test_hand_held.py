"""The vehicle that is carried by hand: exact sensors, truths that can be read, and who is served."""

import asyncio
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from companion.base.clock import Clock, run_in_virtual_time
from companion.base.formats.bus_format import REPLY_HEADER_BYTES, WriteRequest, encode_request
from companion.base.geometry import (
    FloatArray,
    Vector3,
    add,
    matrix_from_quat,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    rotation_vector_from_quat,
    scale,
    subtract,
)
from companion.base.messages import Frame, ImuSample, MagSample
from companion.config import (
    CameraConfig,
    ImuConfig,
    VehicleConfig,
    VisionConfig,
    find_file,
    load_model,
    validate,
)
from companion.pad import load_pad
from companion.sense.imu.mpu9250 import Mpu9250
from companion.sense.vision.pipeline import Vision
from sitl.devices.socket_servers import FrameServer, serve_registers
from sitl.run.in_process import InProcess, carried
from sitl.run.scene_camera import CameraTruth
from sitl.scenario.scenario import USUAL_HOMES, Scenario, load_scenario, magnetic_field_ned_ut
from sitl.sensors.sensors import ACCEL_OFFSET_M_S2, GYRO_OFFSET_RAD_S, HARD_IRON_UT
from sitl.vehicle import HandMotion
from sitl.world.hand_held import FACES, HandHeldWorld
from tests.programs import ProgramHere
from tests.unit.sitl.run.test_server import child_in
from tests.virtual_time import in_virtual_time

MAGNETIC_FIELD_NED_UT = magnetic_field_ned_ut(USUAL_HOMES["px4"])
STEP_S = 0.0025
STATIC = load_scenario("static")
STOPPED = (0.0, 0.0, 0.0, 0.0)


# ----------------
# The vehicle that is carried by hand: exact sensors, truths that can be read, and who is served.


def scenario(**values: Any) -> Scenario:
    """A scenario with a pad that stands."""
    pad = {"motion": {"kind": "static", "meet": {"point_ned_m": [10.0, 0.0]}}}
    return validate(Scenario, {"name": "x", "description": "x", "pad": pad, **values}, "x")


# ---------------------------------------------------------------- what the app's drivers get


async def read_imu(vehicle: InProcess, until_s: float) -> tuple[list[ImuSample], list[MagSample]]:
    """What the app's driver makes of the register bus."""
    clock, driver = Clock(), Mpu9250(vehicle.imu_bus, ImuConfig())
    imu, mag = list[ImuSample](), list[MagSample]()
    while clock.now_s() < until_s:
        inertial, magnetic = driver.poll(clock.now_s)
        imu += inertial
        mag += magnetic
        await clock.sleep_until(clock.now_s() + 0.01)
    return imu, mag


@in_virtual_time
async def test_the_drivers_read_a_still_vehicle_with_the_true_flaws() -> None:
    async with carried(scenario(sensors={"calibrated": False}), 5, "still", camera=False) as vehicle:
        imu, mag = await read_imu(vehicle, 4.0)
        truth, attitude = vehicle.simulation.sensor_truth.boards, vehicle.simulation.world.state.attitude
    sensor_from_body = truth.sensor_from_body
    up = sensor_from_body @ (0.0, 0.0, -9.80665)
    force = sensor_from_body @ np.mean([s.specific_force_body_m_s2 for s in imu], axis=0)
    assert force == pytest.approx(truth.accelerometer.matrix @ up + truth.accelerometer.offset, abs=0.03)
    rate = sensor_from_body @ np.mean([s.rate_body_rad_s for s in imu], axis=0)
    assert rate == pytest.approx(truth.gyroscope.offset, abs=math.radians(0.1))
    field_body = quat_rotate(quat_conjugate(attitude), MAGNETIC_FIELD_NED_UT)
    field = sensor_from_body @ np.mean([s.field_body_ut for s in mag], axis=0)
    expected = truth.magnetometer.matrix @ sensor_from_body @ field_body + truth.magnetometer.offset
    assert field == pytest.approx(expected, abs=0.5)


@pytest.mark.parametrize("seed", range(4))
@in_virtual_time
async def test_uncalibrated_is_as_bad_as_the_data_sheet_allows(seed: int) -> None:
    boards = InProcess(scenario(sensors={"calibrated": False}), seed).simulation.sensor_truth
    for truth in (boards.boards, boards.autopilot):
        assert np.abs(truth.accelerometer.offset).max() <= ACCEL_OFFSET_M_S2
        assert np.abs(truth.gyroscope.offset).max() <= GYRO_OFFSET_RAD_S
        assert np.abs(truth.accelerometer.matrix - np.eye(3)).max() <= 0.03
        iron = truth.magnetometer
        assert HARD_IRON_UT[0] <= np.linalg.norm(iron.offset) <= HARD_IRON_UT[1]
        assert iron.matrix == pytest.approx(iron.matrix.T)
        gains = np.linalg.eigvalsh(iron.matrix)
        assert 0.7 <= gains.min() < gains.max() <= 1.3
    assert not np.allclose(boards.boards.magnetometer.offset, boards.autopilot.magnetometer.offset)
    usual = InProcess(scenario(), seed).simulation.sensor_truth.boards
    assert np.linalg.norm(usual.magnetometer.offset) < 4.0


@in_virtual_time
async def test_a_camera_that_sits_askew_shows_the_pad_askew_and_stamps_late() -> None:
    """The sighting of a camera with a mount error is that of a right one, turned, at another time."""

    async def first_frame(**camera: Any) -> tuple[Frame, CameraTruth]:
        start_s = Clock().now_s()
        async with carried(scenario(camera={"calibration_error": 0.0, **camera}), 2, "over-pad") as vehicle:
            frame = await vehicle.frames.next()
            return replace(frame, time_s=frame.time_s - start_s), vehicle.simulation.sensor_truth.camera

    straight, nominal = await first_frame()
    askew, truth = await first_frame(mount_error_deg=[3.0, -2.0, 4.0], stamp_error_s=0.02)
    assert askew.time_s - straight.time_s == pytest.approx(0.02, abs=1e-9)
    error = matrix_from_quat(quat_from_euler(*(math.radians(a) for a in (3.0, -2.0, 4.0))))
    assert truth.body_from_camera == pytest.approx(error @ nominal.body_from_camera)
    camera = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
    mounted = load_model(VehicleConfig, find_file("vehicles", "x500"))
    vision = Vision(load_pad("moving_1300"), camera, mounted, VisionConfig())
    rights, offs = (vision.step(frame, None).sighting for frame in (straight, askew))
    assert rights is not None
    assert offs is not None
    # what is believed to be straight sees the pad turned by the inverse
    seen = matrix_from_quat(offs.body_from_pad) @ matrix_from_quat(rights.body_from_pad).T
    assert np.degrees(np.linalg.norm(seen - error.T)) < 0.8


@pytest.mark.parametrize(("motion", "length_s", "share"), [("sway", 20.0, 0.85), ("over-pad", 40.0, 0.97)])
@in_virtual_time
async def test_the_pad_stays_in_view(motion: HandMotion, length_s: float, share: float) -> None:
    camera = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
    mounted = load_model(VehicleConfig, find_file("vehicles", "x500"))
    vision, clock, seen = Vision(load_pad("moving_1300"), camera, mounted, VisionConfig()), Clock(), []
    async with carried(scenario(camera={"rate_hz": 5.0}), 1, motion) as vehicle:
        while clock.now_s() < length_s:
            frame = await vehicle.frames.next()
            # far and near pads are looked for in turn
            sightings = [vision.step(frame, None).sighting for _ in range(2)]
            seen.append(any(sighting is not None for sighting in sightings))
    assert np.mean(seen) >= share


def test_a_world_that_fails_is_reported() -> None:
    async def main() -> None:
        async with carried(STATIC, 0, "still", camera=False) as vehicle:
            vehicle.simulation.world.step = broken  # type: ignore[method-assign,assignment]
            await asyncio.sleep(1.0)

    def broken(*_: object) -> None:
        raise ArithmeticError("the world has ended")

    with pytest.raises(ExceptionGroup, match="TaskGroup") as caught:
        run_in_virtual_time(main())
    assert [str(each) for each in caught.value.exceptions] == ["the world has ended"]


# ---------------------------------------------------------------- waiting for somebody to look on


def carried_on(world: HandHeldWorld, time_s: float) -> list[Vector3]:
    """Where it has been, from now on."""
    places = []
    while world.time_s < time_s:
        world.step(STOPPED, STEP_S)
        places.append(world.state.position_ned_m)
    return places


def test_hands_that_wait_begin_when_they_are_reported_to_and_again_once_they_have_done_all() -> None:
    world = HandHeldWorld(STATIC, 3, "over-pad", waits=True)
    waited = np.array(carried_on(world, 15.0))
    assert np.ptp(waited, axis=0).max() < 0.03  # they tremble
    assert np.ptp(waited, axis=0).max() > 0.002
    world.begin()
    risen = np.array(carried_on(world, 30.0))
    world.begin()  # they do not begin anew half-way
    done = np.array(carried_on(world, 90.0))
    assert risen[-1, 2] < waited[-1, 2] - 0.3
    assert done[-1, 2] == pytest.approx(waited[-1, 2], abs=0.03)
    world.begin()
    once_more = np.array(carried_on(world, 105.0))
    assert once_more[-1, 2] == pytest.approx(risen[-1, 2], abs=0.03)
    # no jump anywhere
    steps = np.diff(np.concatenate([waited, risen, done, once_more]), axis=0)
    assert np.abs(steps).max() < 1.0 * STEP_S


def test_what_goes_on_for_ever_does_not_wait() -> None:
    at_once, waiting = HandHeldWorld(STATIC, 3, "tumble"), HandHeldWorld(STATIC, 3, "tumble", waits=True)
    assert carried_on(waiting, 0.5) == carried_on(at_once, 0.5)


class Taking:
    """A device that takes what is written."""

    def read(self, address: int, register: int, length: int) -> bytes:
        """Zeros."""
        return bytes(length)

    def write(self, address: int, register: int, value: int) -> None:
        """Nothing comes of it."""


def test_a_client_that_comes_for_frames_or_registers_is_reported(tmp_path: Path) -> None:
    async def main() -> list[str]:
        come: list[str] = []
        frames = FrameServer(tmp_path / "camera")
        await frames.start(lambda: come.append("frames"))
        registers = await serve_registers(Taking(), tmp_path / "registers", lambda: come.append("bus"))
        _, camera = await asyncio.open_unix_connection(tmp_path / "camera")
        reader, bus = await asyncio.open_unix_connection(tmp_path / "registers")
        for _ in range(2):
            bus.write(encode_request(WriteRequest(0x68, 0x6B, 0)))
            await reader.readexactly(REPLY_HEADER_BYTES)
        camera.close()
        bus.close()
        await frames.close()
        registers.close()
        return come

    assert sorted(asyncio.run(main())) == ["bus", "frames"]


# ---------------------------------------------------------------- as a process


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((), "Missing option '--motion'"),
        (("--motion", "juggle"), "Invalid value for '--motion'"),
        (("--motion", "still", "--scenario", "nowhere"), "scenarios: no 'nowhere'"),
        (("--motion", "still", "--folder", "/nowhere"), "--folder /nowhere: expected a folder"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    words: tuple[str, ...], expected: str, program: ProgramHere
) -> None:
    assert program("companion-sitl", "hand-held", *words).refusal.startswith(f"companion-sitl: {expected}")


def test_it_is_served_as_a_process(tmp_path: Path) -> None:
    with child_in(tmp_path, "hand-held", "--motion", "sway") as (process, _):
        process.communicate(timeout=20.0)
    assert process.returncode == 0


# ---------------- The motion of a vehicle that is carried by hand: plausible, and repeated by its seed


@pytest.mark.parametrize("motion", get_args(HandMotion))
def test_forces_and_rates_are_those_of_the_motion(motion: HandMotion) -> None:
    world = HandHeldWorld(STATIC, 4, motion)
    largest = 0.0
    for _ in range(4000):
        before = world.state
        world.step(STOPPED, STEP_S)
        after = world.state
        mean = scale(add(before.velocity_ned_m_s, after.velocity_ned_m_s), 0.5 * STEP_S)
        moved = subtract(after.position_ned_m, before.position_ned_m)
        assert subtract(moved, mean) == pytest.approx((0.0, 0.0, 0.0), abs=1e-5)
        turned = rotation_vector_from_quat(quat_multiply(quat_conjugate(before.attitude), after.attitude))
        rate = scale(add(before.rate_body_rad_s, after.rate_body_rad_s), 0.5)
        assert scale(turned, 1.0 / STEP_S) == pytest.approx(rate, abs=2e-4)
        felt = quat_rotate(after.attitude, after.specific_force_body_m_s2)
        gained = subtract(after.velocity_ned_m_s, before.velocity_ned_m_s)
        felt_gain = scale(add(felt, (0.0, 0.0, 9.80665)), STEP_S)
        # half a step's turn lies between the two
        assert gained == pytest.approx(felt_gain, abs=1e-4)
        jump = subtract(after.specific_force_body_m_s2, before.specific_force_body_m_s2)
        largest = max(largest, float(np.linalg.norm(jump)))
    assert largest < 0.2, "the force jumps"


def poses(motion: HandMotion, seed: int, length_s: float) -> list[tuple[FloatArray, FloatArray]]:
    """Position over the pad (m) and rotation (3, 3), every 50 ms."""
    world = HandHeldWorld(STATIC, seed, motion)
    steps, found = round(0.05 / STEP_S), []
    for k in range(round(length_s / STEP_S)):
        world.step(STOPPED, STEP_S)
        if k % steps == 0:
            offset = subtract(world.state.position_ned_m, world.pad_state.position_ned_m)
            found.append((np.array(offset), matrix_from_quat(world.state.attitude)))
    return found


@pytest.mark.parametrize("seed", range(3))
def test_tumbling_shows_the_field_every_side(seed: int) -> None:
    field = np.array(MAGNETIC_FIELD_NED_UT) / np.linalg.norm(MAGNETIC_FIELD_NED_UT)
    directions = np.array([rotation.T @ field for _, rotation in poses("tumble", seed, 60.0)])
    probes = np.random.default_rng(0).standard_normal((300, 3))
    probes /= np.linalg.norm(probes, axis=1, keepdims=True)
    nearest_deg = np.degrees(np.arccos((probes @ directions.T).clip(-1.0, 1.0))).min(axis=1)
    assert (nearest_deg < 25.0).mean() > 0.9


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("already_s", [0.0, 60.0])
def test_each_face_is_laid_down_in_a_round(seed: int, already_s: float) -> None:
    """Whenever one begins to look on."""
    seen = poses("faces", seed, already_s + 48.0)[round(already_s / 0.05) :]
    downs = np.array([rotation.T @ (0.0, 0.0, 1.0) for _, rotation in seen])
    for roll, pitch in FACES:
        own = matrix_from_quat(quat_from_euler(math.radians(roll), math.radians(pitch), 0.0)).T @ (0, 0, 1)
        assert (downs @ own > math.cos(math.radians(5.0))).sum() * 0.05 > 4.0


def test_seeds_differ_and_repeat() -> None:
    first, again, other = (poses("sway", seed, 2.0)[-1][0] for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.allclose(first, other, atol=0.01)
