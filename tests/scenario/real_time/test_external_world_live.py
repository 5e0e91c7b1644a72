"""The external world in real time, with a player of recorded poses as the vehicle, over UDP."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.clock import Clock
from companion.base.formats.frame_format import FrameHeader
from companion.base.formats.frame_stream import FrameStream
from companion.base.geometry import Vector3, ned_from_geodetic
from companion.base.messages import Outcome, Phase
from companion.config import CameraConfig, RangeConfig, VehicleConfig, find_file, load_model
from companion.link.codec import Codec, command_long
from companion.pad import load_pad
from companion.sense.range.ultrasonic import Ultrasonic
from companion.sense.serial_port import SerialPort
from sitl.camera import camera as lens
from sitl.camera.exposure import ImagingSettings
from sitl.devices.ports import PtyPort
from sitl.devices.socket_servers import FrameServer
from sitl.external import client as external_client
from sitl.external.link import open_link, open_relay
from sitl.external.session import ExternalConnections, ExternalSimulation
from sitl.scenario.scenario import Scenario
from tests.beside import beside
from tests.unit.sitl.external.external_bench import Player
from tests.unit.sitl.external.external_vehicle import ARDUPILOT, GROUND, LEVEL, PX4, Flight, heartbeat, hop

STANDING_M = 0.18
PAD = (2.0, 1.0)
SCENARIO = Scenario.model_validate(
    {
        "name": "recorded",
        "description": "t",
        "pad": {"heading": 30.0, "motion": {"kind": "static", "meet": {"point_ned_m": PAD, "spread_m": 0.0}}},
        "camera": {"noise_grey": 0.0, "calibration_error": 0.0, "latency_jitter_s": 0.0},
        "beacon": {"position_std_m": 0.0},
        "pass": {"vertical_speed_m_s": 1.8},
    }
)


@dataclass
class ExternalBench:
    simulation: ExternalSimulation
    player: Player
    frames: FrameStream
    range_path: str
    relay_port: int
    texts: list[str]
    taken: list[tuple[FrameHeader, Any]] = field(default_factory=list)

    async def film(self) -> None:
        while True:
            header = await self.frames.read_header()
            self.taken.append((header, await self.frames.read_image(header)))


@asynccontextmanager
async def bench(folder: Path, player: Player, scenario: Scenario = SCENARIO) -> AsyncIterator[ExternalBench]:
    await player.open()
    texts: list[str] = []
    link = await open_link(f"udp:127.0.0.1:{player.port}", texts.append)
    relay, relay_port = await open_relay()
    range_port, server = PtyPort(9600), FrameServer(folder / "camera")
    await server.start()
    simulation = ExternalSimulation(
        scenario, 0, ExternalConnections(link, relay, range_port, server), texts.append
    )
    stream = await FrameStream.open(server.address)
    built = ExternalBench(simulation, player, stream, range_port.path, relay_port, texts)
    try:
        async with beside(simulation.run(), built.film()):
            yield built
    finally:
        stream.close()
        await server.close()
        for end in (range_port, link, relay, player):
            end.close()


@cache
def model() -> lens.CameraModel:
    camera = load_model(CameraConfig, find_file("cameras", SCENARIO.camera.config))
    vehicle = load_model(VehicleConfig, find_file("vehicles", SCENARIO.airframe))
    settings = ImagingSettings(
        exposure_s=SCENARIO.camera.exposure_s, readout_s=SCENARIO.camera.readout_s, noise_grey=0.0
    )
    return lens.CameraModel(camera, vehicle, load_pad(SCENARIO.pad.name), settings, np.random.default_rng(0))


def rendered(position: Vector3) -> Any:
    """What a level vehicle there sees: from the recording, not from what the world made of it."""
    here = (position[0], position[1], position[2] - STANDING_M)
    scene = lens.ScenePose(here, LEVEL, (*PAD, 0.0), np.radians(30.0))
    return model().render(0.0, lambda _: scene)


def shift_px(one: Any, other: Any) -> float:
    """How far one picture is from the other, as phase correlation has it."""
    window = cv2.createHanningWindow((one.shape[1], one.shape[0]), cv2.CV_32F)
    (x, y), _ = cv2.phaseCorrelate(one.astype(np.float32), other.astype(np.float32), window)
    return float(np.hypot(x, y))


@pytest.mark.parametrize("autopilot", [ARDUPILOT, PX4])
async def test_a_recorded_landing_is_filmed_and_scored(autopilot: int, tmp_path: Path) -> None:
    flight, contact_s = hop(*PAD, top_m=2.0, sink_m_s=1.6)
    player = Player(autopilot, flight, contact_s + 0.3)
    async with bench(tmp_path, player, SCENARIO) as b:
        echoes: list[float] = []
        line, finder = SerialPort(b.range_path, 9600), Ultrasonic(RangeConfig())

        async def listen() -> None:
            while True:
                echoes.extend(s.distance_m for s in finder.feed(await line.read(), Clock().now_s()))

        async with beside(listen()):
            await player.run(2.0, contact_s + 0.8)  # it stands until the world is ready, on a busy machine
        line.close()
        report = b.simulation.report(Phase.LANDED)
        assert b.simulation.client.flown  # so its pose stays of one source
    assert_scored(report)
    assert_filmed(b, flight, contact_s)
    assert max(echoes) == pytest.approx(2.0 + STANDING_M, abs=0.3)
    names = {ARDUPILOT: "SIM_STATE", PX4: "HIL_STATE_QUATERNION"}
    assert f"vehicle 1 found by {names[autopilot]}; ground at latitude 46.9999" in b.texts[0].replace(
        "47.0000", "46.9999"
    )


def assert_scored(report: Any) -> None:
    assert report.outcome is Outcome.LANDED, report.failures
    assert report.touchdown["lateral_error_m"] < 0.02  # the messages' 11 mm and a corner cut by smoothing
    assert report.touchdown["vertical_speed_m_s"] == pytest.approx(1.6, abs=0.02)
    assert len(report.truth) > 50


def assert_filmed(b: ExternalBench, flight: Flight, contact_s: float) -> None:
    """Each picture is that of the recorded place at its own stamp, on a machine that kept up by and large."""
    errors, steps = [], np.diff([header.sequence for header, _ in b.taken])
    assert (steps > 0).all()
    for header, image in b.taken[::4]:
        assert header.time_s is not None
        time_s = header.time_s - b.player.start_s
        if 1.2 < time_s < contact_s - 0.8:
            errors.append(shift_px(image, rendered(flight(time_s)[0])))
    # at 2 m/s and 2 m up a millisecond is half a pixel; the median bears with a busy machine
    assert len(errors) >= 3
    assert np.median(errors) < 4.0, errors


async def test_the_app_shares_the_connection_and_hears_of_the_pad(tmp_path: Path) -> None:
    """What the app says reaches the vehicle; its question to the ground station is answered by the world."""
    flight, _ = hop(*PAD)
    player = Player(PX4, flight, 9.0)
    async with bench(tmp_path, player) as b:
        app, codec = await open_link(f"udp:127.0.0.1:{b.relay_port}", print), Codec(1, 191)
        kinds: dict[str, Any] = {}
        async with beside(player.run(0.2, 3.0)):
            await b.simulation.ready.wait()
            question = command_long(mavlink.MAV_CMD_REQUEST_MESSAGE, (144, 0, 0, 0, 0, 0, 0), 255, 190)
            app.write(codec.encode(question))
            while not {"FOLLOW_TARGET", "HEARTBEAT", "HIL_STATE_QUATERNION"} <= kinds.keys():
                for message in codec.decode(await asyncio.wait_for(app.read(), 5.0)):
                    kinds[message.get_type()] = message
        app.close()
    beacon = kinds["FOLLOW_TARGET"]
    place = ned_from_geodetic(beacon.lat * 1e-7, beacon.lon * 1e-7, beacon.alt, GROUND)
    assert place[:2] == pytest.approx(PAD, abs=1.0)  # with the noise of a receiver


async def test_the_autopilot_and_the_app_get_a_rangefinder(tmp_path: Path) -> None:
    """ArduPilot takes it with RNGFND1_TYPE 10, PX4 as it is."""
    flight, _ = hop(*PAD)
    player = Player(PX4, flight, 9.0)
    async with bench(tmp_path, player) as b:
        app, codec = await open_link(f"udp:127.0.0.1:{b.relay_port}", print), Codec(1, 191)
        async with beside(player.run(2.0, 3.0)):
            await b.simulation.ready.wait()
            told = await player.hear("DISTANCE_SENSOR")
            app.write(codec.encode(command_long(mavlink.MAV_CMD_RUN_PREARM_CHECKS, (0,) * 7, 1, 1)))
            kinds: set[str] = set()
            while "DISTANCE_SENSOR" not in kinds:
                heard = codec.decode(await asyncio.wait_for(app.read(), 5.0))
                kinds |= {message.get_type() for message in heard}
        app.close()
    assert told.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270
    sensor_m = load_model(VehicleConfig, find_file("vehicles", SCENARIO.airframe)).range_position_body_m
    assert told.current_distance == pytest.approx(100.0 * (STANDING_M - sensor_m[2]), abs=10.0)


async def pad_by_beacon(b: ExternalBench) -> Any:
    """What the ground station answers an app that asks where the pad is."""
    app, codec = await open_link(f"udp:127.0.0.1:{b.relay_port}", print), Codec(1, 191)
    question = command_long(mavlink.MAV_CMD_REQUEST_MESSAGE, (144, 0, 0, 0, 0, 0, 0), 255, 190)
    app.write(codec.encode(question))
    while True:
        for message in codec.decode(await asyncio.wait_for(app.read(), 5.0)):
            refused = message.get_type() == "COMMAND_ACK" and message.result != mavlink.MAV_RESULT_ACCEPTED
            if refused or message.get_type() == "FOLLOW_TARGET":
                app.close()
                return message


async def test_while_no_pose_comes_there_are_no_frames_and_then_there_are_again(tmp_path: Path) -> None:
    player = Player(ARDUPILOT, lambda _: ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 0.0)
    async with bench(tmp_path, player) as b:
        await player.run(0.6, 0.0)
        await asyncio.sleep(0.3)
        count = len(b.taken)
        assert count > 0
        await asyncio.sleep(0.5)
        assert len(b.taken) == count
        await player.run(0.6, 0.0)
        await asyncio.sleep(0.1)
        assert len(b.taken) > count


async def test_one_that_flies_already_has_its_ground_at_home(tmp_path: Path) -> None:
    home = mavlink.MAVLink_home_position_message(
        470000000, 80000000, 400000, 0.0, 0.0, 0.0, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0
    )
    player = Player(ARDUPILOT, lambda _: ((0.0, 0.0, -5.0), (0.0, 0.0, 0.0)), 99.0)
    async with bench(tmp_path, player) as b:
        await player.run(0.0, 0.3)
        assert not b.simulation.ready.is_set()
        player.say(home)
        await player.run(0.0, 0.3)
        assert b.simulation.ready.is_set()
        truth = b.simulation.world.truth_at(Clock().now_s())
    assert truth.vehicle_position_ned_m[2] == pytest.approx(-5.0 - STANDING_M, abs=0.01)
    assert b.texts[0].startswith("WARNING: the vehicle is armed already")


def stand_estimated(altitude_m: float) -> tuple[Any, ...]:
    """The autopilot's estimates of a vehicle at rest at GROUND, but for the altitude."""
    return (
        mavlink.MAVLink_attitude_quaternion_message(0, *LEVEL, 0.0, 0.0, 0.0),
        mavlink.MAVLink_global_position_int_message(
            0, round(GROUND[0] * 1e7), round(GROUND[1] * 1e7), round(altitude_m * 1e3), 0, 0, 0, 0, 0
        ),
        mavlink.MAVLink_local_position_ned_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    )


async def test_a_late_truth_has_a_ground_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The autopilot's estimate is 1.2 m too low: on its ground the vehicle would touch that far up."""
    monkeypatch.setattr(external_client, "PATIENCE_S", 0.1)
    player = Player(ARDUPILOT, lambda _: ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 0.0)
    async with bench(tmp_path, player) as b:
        while not b.simulation.ready.is_set():
            player.say(heartbeat(ARDUPILOT), *stand_estimated(altitude_m=GROUND[2] - 1.2))
            await asyncio.sleep(0.02)
        assert "and ATTITUDE_QUATERNION; ground at" in b.texts[1]
        estimated = b.simulation.world.origin
        await player.run(0.3, 0.0)
        truth = b.simulation.world.truth_at(Clock().now_s())
        true = b.simulation.world.origin
        asked = await pad_by_beacon(b)
    assert truth.vehicle_position_ned_m == pytest.approx((0.0, 0.0, -STANDING_M), abs=0.01)
    assert truth.in_contact
    assert estimated is not None
    assert true is not None
    assert true[2] - estimated[2] == pytest.approx(1.2, abs=0.01)
    assert b.texts[2].startswith("SIM_STATE comes after all")
    assert b.texts[3].startswith("vehicle 1 found by SIM_STATE; ground at")
    assert asked.alt == pytest.approx(GROUND[2], abs=0.6)  # with the noise of a receiver


async def test_what_the_scenario_says_of_beacon_and_camera_applies(tmp_path: Path) -> None:
    settings = SCENARIO.model_dump(by_alias=True)
    settings["beacon"] |= {"available": False}
    settings["camera"] |= {"lost_share": 0.999}
    player = Player(ARDUPILOT, lambda _: ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 0.0)
    async with bench(tmp_path, player, Scenario.model_validate(settings)) as b:
        playing = asyncio.create_task(player.run(2.0, 0.0))
        await b.simulation.ready.wait()
        answer = await pad_by_beacon(b)
        await playing
        assert b.taken == []
    assert (answer.get_type(), answer.result) == ("COMMAND_ACK", mavlink.MAV_RESULT_UNSUPPORTED)
