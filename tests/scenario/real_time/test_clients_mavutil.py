"""pymavlink's mavutil against `companion-sitl`, as PX4 and as ArduPilot, side by side in real time.

PX4's profile over TCP and unsigned; ArduPilot's over the UDP port where ground stations listen, signed, with
a second client that has no key.
"""

import hashlib
import math
import socket
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from tests.scenario.real_time.serving import serving

PATIENCE_S = 60.0  # on a busy machine the vehicle slows down
HEIGHT_M = 2.0
PASSPHRASE = b"correct horse battery staple"
VERSION = 148  # AUTOPILOT_VERSION
REQUEST_MESSAGE = 512
NAV_TAKEOFF = 22
PREARM_CHECK = 1 << 28


@pytest.fixture(autouse=True)
def _second_version(monkeypatch: pytest.MonkeyPatch) -> None:
    """As its documentation says; what mavutil sets in the environment does not outlast the test."""
    monkeypatch.setenv("MAVLINK20", "1")
    monkeypatch.setenv("MAVLINK_DIALECT", "ardupilotmega")
    mavutil.set_dialect("ardupilotmega")


def heard(client: Any, kind: str, holds: Callable[[Any], bool] = lambda _: True) -> Any:
    """The first message of a kind of which something holds."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        message = client.recv_match(type=kind, blocking=True, timeout=1.0)
        if message is not None and holds(message):
            return message
    raise AssertionError(f"no such {kind}")


def arm(client: Any) -> None:
    """Ask until it is granted: ArduPilot's checks pass in STABILIZE before its filter knows where it is."""
    deadline = time.monotonic() + PATIENCE_S
    while not client.motors_armed():
        assert time.monotonic() < deadline, "not armed"
        client.arducopter_arm()
        client.recv_match(type="HEARTBEAT", blocking=True, timeout=1.0)


def fly(client: Any, mode: str, *, above_sea_level: bool) -> None:
    """What mavutil's users do."""
    assert client.wait_heartbeat(timeout=PATIENCE_S) is not None
    assert {mode, "RTL", "LAND"} <= set(client.mode_mapping())
    client.param_fetch_all()
    count = heard(client, "PARAM_VALUE", lambda p: p.param_index == p.param_count - 1).param_count
    assert len(client.params) >= count - 1
    heard(client, "SYS_STATUS", lambda s: bool(s.onboard_control_sensors_health & PREARM_CHECK))
    client.set_mode(mode)
    heard(client, "HEARTBEAT", lambda _: client.flightmode == mode)
    arm(client)
    nans = (math.nan,) * 6
    home_m = 1e-3 * heard(client, "HOME_POSITION").altitude if above_sea_level else 0.0
    client.mav.command_long_send(1, 1, NAV_TAKEOFF, 0, *nans, home_m + HEIGHT_M)
    heard(client, "GLOBAL_POSITION_INT", lambda p: p.relative_alt > 1000 * HEIGHT_M - 400)
    client.set_mode("LAND")
    heard(client, "HEARTBEAT", lambda _: not client.motors_armed())


def fly_px4() -> None:
    with (
        serving("px4") as served,
        closing(mavutil.mavlink_connection(f"tcp:127.0.0.1:{served.tcp_port}")) as client,
    ):
        fly(client, "LOITER", above_sea_level=True)


def listening() -> tuple[Any, int]:
    """A client at a free port; another process may take the one that was found, then there is another."""
    for _ in range(5):
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as probe:
            probe.bind(("127.0.0.1", 0))
            port = int(probe.getsockname()[1])
        with suppress(OSError):
            return mavutil.mavlink_connection(f"udp:127.0.0.1:{port}"), port
    raise AssertionError("no free port in five tries")


def fly_ardupilot(key_file: Path) -> None:
    client, port = listening()
    with closing(client):
        client.setup_signing(hashlib.sha256(PASSPHRASE).digest())
        with serving("ardupilot", "--gcs-port", port, "--signing-key", key_file) as served:
            stranger_hears_but_is_not_heard(served.tcp_port)
            fly(client, "GUIDED", above_sea_level=False)
            assert client.mav.signing.goodsig_count > 100
            assert client.mav.signing.badsig_count == 0


def stranger_hears_but_is_not_heard(port: int) -> None:
    with closing(mavutil.mavlink_connection(f"tcp:127.0.0.1:{port}", source_system=200)) as stranger:
        assert stranger.wait_heartbeat(timeout=PATIENCE_S) is not None
        stranger.mav.command_long_send(1, 1, REQUEST_MESSAGE, 0, VERSION, 0, 0, 0, 0, 0, 0)
        assert stranger.recv_match(type="COMMAND_ACK", blocking=True, timeout=1.0) is None


def test_mavutil_flies_both_autopilots(tmp_path: Path) -> None:
    key_file = tmp_path / "key"
    key_file.write_bytes(PASSPHRASE + b"\n")
    with ThreadPoolExecutor() as pool:
        for flight in [pool.submit(fly_px4), pool.submit(fly_ardupilot, key_file)]:
            flight.result()
