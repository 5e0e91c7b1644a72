"""Connections to somebody else's vehicle: over UDP and TCP, and gone and back."""

import asyncio
import json
import math
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, closing, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.base.geometry import ned_from_geodetic, quat_from_euler, rotation_vector_from_quat
from companion.base.messages import Outcome
from companion.base.udp_socket import UdpSocket
from companion.config import CONFIG_FOLDER, ConfigError
from sitl.external import link as external_link
from sitl.external import pose as external_pose
from sitl.external.link import check_connection, open_link, open_relay, pump
from sitl.external.pose import LONGEST_GUESS_S, Pose, PoseTrack
from sitl.run.process_control import read_report
from tests.beside import beside
from tests.programs import ProgramHere
from tests.unit.link.transport.transport_ends import free_port
from tests.unit.sitl.external.external_bench import Player
from tests.unit.sitl.external.external_vehicle import GROUND, LEVEL, PX4, hil_state, sim_state


@pytest.mark.parametrize(
    "spec",
    [
        *("udp:127.0.0.1", "udp:127.0.0.1:0", "udp:127.0.0.1:70000"),
        *("serial:/dev/tty:57600", "", "tcp::1", "tcp:a..b:1", "udp:a..b:1"),
    ],
)
def test_what_is_no_connection_is_refused_in_one_line(spec: str) -> None:
    with pytest.raises(ConfigError) as caught:
        check_connection(spec, "--external")
    assert "expected udp:HOST:PORT, udpin:HOST:PORT or tcp:HOST:PORT" in str(caught.value)
    assert "\n" not in str(caught.value)


async def read(end: external_link.ExternalLink) -> bytes:
    return await asyncio.wait_for(end.read(), 5.0)


@asynccontextmanager
async def called() -> AsyncIterator[tuple[UdpSocket, external_link.ExternalLink]]:
    """A relay, and who calls it."""
    relay, port = await open_relay()
    caller = await open_link(f"udp:127.0.0.1:{port}", print)
    yield relay, caller
    caller.close()
    relay.close()


async def test_udp_calls_and_udpin_listens() -> None:
    async with called() as (relay, caller):
        assert not relay.has_peer
        relay.write(b"nobody hears that")
        caller.write(b"here I am")
        assert await read(relay) == b"here I am"
        relay.write(b"and I")
        assert await read(caller) == b"and I"


async def test_udpin_takes_a_port_and_a_port_in_use_is_reported() -> None:
    with bound_socket() as other, pytest.raises(ConfigError, match="in use; expected a free port"):
        await open_link(f"udpin:127.0.0.1:{other.getsockname()[1]}", print)


async def test_a_call_that_nobody_answers_yet_goes_on() -> None:
    port = free_port()
    caller = await open_link(f"udp:127.0.0.1:{port}", print)
    caller.write(b"refused")
    await asyncio.sleep(0.05)
    late = await open_link(f"udpin:127.0.0.1:{port}", print)
    caller.write(b"heard")
    assert await read(late) == b"heard"
    caller.close()
    late.close()


async def test_tcp_calls_again_and_tells_it_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(external_link, "RETRY_S", 0.02)
    came: asyncio.Queue[asyncio.StreamWriter] = asyncio.Queue()

    async def vehicle(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"hello")
        came.put_nowait(writer)

    server = await asyncio.start_server(vehicle, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    texts: list[str] = []
    link = await open_link(f"tcp:127.0.0.1:{port}", texts.append)
    assert await read(link) == b"hello"
    first = await came.get()
    server.close()
    first.transport.abort()
    while len(texts) < 1:  # noqa: ASYNC110 - it has no event for it
        await asyncio.sleep(0.01)
    link.write(b"nobody hears that")
    await asyncio.sleep(0.1)  # several calls in vain, of which nothing is said
    assert len(texts) == 1
    assert texts[0].startswith(f"tcp:127.0.0.1:{port}: ")
    assert texts[0].endswith("; trying again every 0.02 s")
    server = await asyncio.start_server(vehicle, "127.0.0.1", port)
    assert await read(link) == b"hello"
    assert texts[1:] == [f"tcp:127.0.0.1:{port}: connected again"]
    link.close()
    (await came.get()).close()
    server.close()


async def test_pumped_bytes_reach_every_sink_and_what_makes_no_sense_is_reported_once() -> None:
    told: list[str] = []
    handed_on: list[asyncio.Queue[bytes]] = [asyncio.Queue(), asyncio.Queue()]

    def reckon(data: bytes) -> None:
        raise ValueError("math domain error")

    async with called() as (relay, caller):
        one, other = (queue.put_nowait for queue in handed_on)
        async with beside(pump(relay, one, reckon, other, tell=told.append)):
            for data in (b"wild", b"wilder"):
                caller.write(data)
                for queue in handed_on:
                    assert await asyncio.wait_for(queue.get(), 5.0) == data
            assert told == ["WARNING: ignored invalid data (math domain error)"]


# ---------------- The external world as a process: its words, its end, and its verdict


def test_the_command_refuses_what_is_no_connection_in_one_line(program: ProgramHere) -> None:
    line = program("companion-sitl", "--external", "udpin:127.0.0.1:0").refusal
    assert line.startswith("companion-sitl: --external udpin:127.0.0.1:0: expected udp:HOST:PORT")


def test_for_people_it_waits_until_it_is_stopped_and_judges_then(tmp_path: Path) -> None:
    with subprocess.Popen(
        (sys.executable, "-m", "sitl.cli", "--external", f"udpin:127.0.0.1:{free_port()}",
         "--folder", str(tmp_path)),
        cwd=CONFIG_FOLDER.parent, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True,
    ) as process:  # fmt: skip
        assert process.stderr is not None
        assert "pad lies flush" in process.stderr.readline()
        assert "waiting for a vehicle" in process.stderr.readline()
        process.send_signal(signal.SIGINT)
        said, words = process.communicate(timeout=20.0)
    assert (process.returncode, words) == (0, "")
    assert read_report(Path(json.loads(said)["report"])).failures == ("never touched down",)


@contextmanager
def bound_socket() -> Iterator[socket.socket]:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as bound:
        bound.bind(("127.0.0.1", 0))
        yield bound


async def test_as_a_process_it_serves_and_judges(tmp_path: Path) -> None:
    player = Player(PX4, lambda _: ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 0.0)
    await player.open()
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "sitl.cli", "--external", f"udp:127.0.0.1:{player.port}"),
        *("--scenario", "line", "--folder", str(tmp_path), "--child"),
        cwd=CONFIG_FOLDER.parent,
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    async with beside(player.run(20.0, 0.0)):
        assert process.stdout is not None
        endpoints = json.loads(await asyncio.wait_for(process.stdout.readline(), 20.0))
        assert endpoints["sense"]["source"] == "autopilot"
        assert endpoints["sense"]["range"]["port"].startswith("/dev/")
        assert endpoints["sense"]["vision"]["source"] == f"socket:{tmp_path / 'camera'}"
        said, words = await asyncio.wait_for(process.communicate(b"finish search\n"), 20.0)
    player.close()
    assert process.returncode == 0
    assert read_report(Path(json.loads(said)["report"])).outcome is Outcome.TIMEOUT
    lines = words.decode().splitlines()
    assert "pad.surface_height_m 0.3 is taken as 0" in lines[0]
    assert lines[1].endswith(f"waiting for a vehicle on udp:127.0.0.1:{player.port}")


# ---------------- Poses of somebody else's vehicle: read from its messages, and between them

PLACE, SPEED = (12.0, -7.0, -3.5), (1.0, -0.5, 0.25)
TILTED = quat_from_euler(0.1, -0.2, 2.0)


@pytest.mark.parametrize(
    "sample",
    [
        external_pose.sim_state(sim_state(PLACE, SPEED, TILTED), 5.0),
        external_pose.hil_state(hil_state(PLACE, SPEED, TILTED), 5.0),
    ],
)
def test_a_message_tells_the_pose(sample: external_pose.Sample | None) -> None:
    assert sample is not None
    assert sample.time_s == 5.0
    # whole numbers of 1e-7 deg are 11 mm, and both cut them off
    assert ned_from_geodetic(*sample.place, GROUND) == pytest.approx(PLACE, abs=0.012)
    assert sample.velocity_ned_m_s == pytest.approx(SPEED, abs=0.01)
    assert sample.attitude == pytest.approx(TILTED, abs=1e-6)


@pytest.mark.parametrize("in_degrees", [False, True])
def test_an_old_sim_state_has_its_place_as_float_alone(in_degrees: bool) -> None:
    changes: dict[str, Any] = {"lat_int": 0, "lon_int": 0}
    if in_degrees:
        changes |= {"lat": 47.0001, "lon": 8.0001}
    sample = external_pose.sim_state(sim_state(PLACE, **changes), 0.0)
    assert sample is not None
    expected = (47.0001, 8.0001) if in_degrees else (47.0 + 12.0 / 111200.0, 8.0 - 7.0 / 76000.0)
    assert sample.place[:2] == pytest.approx(expected, abs=5e-6)


def test_a_sim_state_without_a_quaternion_has_its_angles_and_what_holds_no_pose_gives_none() -> None:
    message = sim_state(PLACE, attitude=(0.0, 0.0, 0.0, 0.0), roll=0.1, pitch=-0.2, yaw=2.0)
    sample = external_pose.sim_state(message, 0.0)
    assert sample is not None
    assert sample.attitude == pytest.approx(TILTED, abs=1e-6)
    nowhere: dict[str, Any] = {"lat": 0.0, "lon": 0.0, "lat_int": 0, "lon_int": 0}
    assert external_pose.sim_state(sim_state(PLACE, **nowhere), 0.0) is None
    assert external_pose.hil_state(hil_state(PLACE, attitude=(0.0, 0.0, 0.0, 0.0)), 0.0) is None


@pytest.mark.parametrize("wild", [math.nan, math.inf, -math.inf, 3.4e38, -3.4e38])
@pytest.mark.parametrize("name", ["roll", "yaw", "xgyro", "zgyro", "vn", "vd", "alt"])
def test_wild_numbers_are_no_pose(name: str, wild: float) -> None:
    values: dict[str, Any] = {name: wild}
    message = sim_state(PLACE, attitude=(0.0, 0.0, 0.0, 0.0), **values)
    assert external_pose.sim_state(message, 0.0) is None


@pytest.fixture
def track() -> PoseTrack:
    return PoseTrack()


def pose(time_s: float, north_m: float, speed_m_s: float, yaw_rad: float = 0.0, rate: float = 0.0) -> Pose:
    yawed = quat_from_euler(0.0, 0.0, yaw_rad)
    return Pose(time_s, (north_m, 0.0, 0.0), (speed_m_s, 0.0, 0.0), yawed, (0.0, 0.0, rate))


def test_between_two_messages_a_cubic_is_exact_for_a_vehicle_that_brakes(track: PoseTrack) -> None:
    # x = 2 t - t^2, so v = 2 - 2 t
    for time_s in (0.0, 0.02, 0.04):
        track.put(pose(time_s, 2.0 * time_s - time_s**2, 2.0 - 2.0 * time_s))
    between = track.at(0.031)
    assert between.position_ned_m[0] == pytest.approx(2.0 * 0.031 - 0.031**2, abs=1e-9)
    assert between.velocity_ned_m_s[0] == pytest.approx(2.0 - 2.0 * 0.031)


def test_an_attitude_is_turned_on_between_and_the_short_way(track: PoseTrack) -> None:
    track.put(pose(0.0, 0.0, 0.0, 0.2))
    turned = pose(0.02, 0.0, 0.0, 0.24)
    track.put(turned._replace(attitude=(-turned.attitude[0], 0.0, 0.0, -turned.attitude[3])))
    assert abs(rotation_vector_from_quat(track.at(0.005).attitude)[2]) == pytest.approx(0.21, abs=1e-6)


def test_beyond_the_newest_it_is_carried_on_but_not_for_long(track: PoseTrack) -> None:
    track.put(pose(1.0, 3.0, 2.0, yaw_rad=0.1, rate=0.5))
    ahead = track.at(1.05)
    assert ahead.position_ned_m[0] == pytest.approx(3.1)
    assert rotation_vector_from_quat(ahead.attitude)[2] == pytest.approx(0.125)
    assert track.at(9.0).position_ned_m[0] == pytest.approx(3.0 + 2.0 * LONGEST_GUESS_S)


def test_steps_of_whole_numbers_are_smoothed_away(track: PoseTrack) -> None:
    """At 0.3 m/s and 50 Hz a place in steps of 11 mm stands for two messages and jumps with the third."""
    step_m, missed = 0.0111, []
    for k in range(200):
        true_m = 0.3 * 0.02 * k
        kept = track.put(pose(0.02 * k, math.floor(true_m / step_m) * step_m, 0.3))
        assert kept is not None
        # cutting off costs half a step in the mean
        missed.append(abs(kept.position_ned_m[0] + 0.5 * step_m - true_m))
    assert max(missed[51:]) < 0.002


@pytest.mark.parametrize(("axis", "step_m"), [(0, 0.0111), (2, 0.01)])
def test_a_vehicle_that_hovers_does_not_jump_from_step_to_step(axis: int, step_m: float) -> None:
    """The camera's view between two frames: what rounding adds to how the vehicle moves."""
    track, dt_s, wander_m, w = PoseTrack(), 0.02, 0.03, 2.0

    def along(value: float) -> tuple[float, float, float]:
        return (value, 0.0, 0.0) if axis == 0 else (0.0, 0.0, value)

    missed = []
    for k in range(1000):
        true_m, speed = wander_m * math.sin(w * dt_s * k), wander_m * w * math.cos(w * dt_s * k)
        told = math.floor(true_m / step_m) * step_m
        kept = track.put(Pose(dt_s * k, along(told), along(speed), LEVEL, (0.0, 0.0, 0.0)))
        assert kept is not None
        missed.append(kept.position_ned_m[axis] - true_m)
    settled = missed[100:]
    assert max(abs(b - a) for a, b in pairwise(settled)) / dt_s < 0.02  # m/s
    assert max(map(abs, settled)) < step_m


def test_a_leap_is_believed_an_old_message_is_not_and_a_simulator_that_starts_anew_is(
    track: PoseTrack,
) -> None:
    track.put(pose(100.0, 0.0, 0.0))
    track.put(pose(100.02, 50.0, 0.0))
    assert track.at(100.02).position_ned_m[0] == 50.0
    assert track.put(pose(100.01, 0.0, 0.0)) is None
    assert track.put(pose(100.02, 0.0, 0.0)) is None
    assert track.put(pose(3.0, 5.0, 0.0)) is not None
    assert track.at(3.0).position_ned_m[0] == 5.0


def test_what_is_old_is_forgotten_and_without_a_pose_there_is_none(track: PoseTrack) -> None:
    with pytest.raises(ValueError, match="no pose"):
        track.at(0.0)
    for k in range(400):
        track.put(pose(0.02 * k, 0.0, 0.0))
    assert track.at(0.0).time_s > 5.0
    assert track.newest is not None
    assert track.newest.attitude == LEVEL


def test_beginning_anew_what_was_is_there_until_the_next_pose_comes_whenever_that_is_of(
    track: PoseTrack,
) -> None:
    track.put(pose(1.0, 3.0, 0.0))
    track.begin_anew()
    assert track.at(1.0).position_ned_m[0] == 3.0
    track.put(pose(0.99, 0.5, 0.0))  # by another stamp
    assert track.at(1.0).position_ned_m[0] == 0.5


def test_without_stamps_or_by_a_clock_that_was_set_the_simulator_goes_on_as_our_clock_does(
    track: PoseTrack,
) -> None:
    for time_s, stamp_s in ((1.0, 50.0), (1.1, 50.02), (1.2, 3.0), (1.3, 3.1), (1.4, math.nan)):
        track.put(pose(time_s, 0.0, 0.0)._replace(simulated_s=stamp_s))
    times = [track.at(time_s).simulated_s for time_s in (1.0, 1.1, 1.2, 1.3, 1.4, 1.45)]
    steps = [b - a for a, b in pairwise(times)]
    assert steps == pytest.approx([0.02, 0.1, 0.1, 0.1, 0.05])


def test_a_stamp_that_was_read_late_neither_stops_the_clock_nor_drives_it_on() -> None:
    track, rng = PoseTrack(), np.random.default_rng(1)
    for k in range(3000):
        late_s = float(rng.uniform(-0.004, 0.004))
        track.put(pose(1.0 + 0.01 * k, 0.0, 0.0)._replace(simulated_s=0.0098 * k + late_s))
    newest = track.newest
    assert newest is not None
    assert newest.simulated_s - 1.0 == pytest.approx(0.98 * (newest.time_s - 1.0), abs=0.02)
