"""The app's end of the link under spoilt MAVLink: of an autopilot, a ground station, a stranger."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from benchmarks.mavlink.garbage import KINDS
from benchmarks.mutations.drivers import NEW_AFTER, check_finite
from companion.config import LinkConfig, SenseConfig
from companion.link.codec import Codec, mavlink
from companion.link.session import Session
from companion.link.signing import LinkSigning, SigningKey

_LEVEL: Final = [1.0, 0.0, 0.0, 0.0]
_TEXT: Final = b"a text that fills one message and goes on in others"[:50]
_CUT: Final = 300  # bytes that come at once, at most


def _telemetry(now_s: float, kind: str) -> list[Any]:
    """Legal messages of every kind that the session hears."""
    ms, us = int(now_s * 1000.0), int(now_s * 1e6)
    autopilot = mavlink.MAV_AUTOPILOT_PX4 if kind == "px4" else mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    return [
        mavlink.MAVLink_heartbeat_message(2, autopilot, 217, 0x00060000, 4, 3),
        mavlink.MAVLink_sys_status_message(1 << 28, 1 << 28, 1 << 28, 0, 12000, 100, 80, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_extended_sys_state_message(0, 2),
        mavlink.MAVLink_attitude_message(ms, 0.1, 0.1, 1.0, 0.0, 0.0, 0.0),
        mavlink.MAVLink_attitude_quaternion_message(ms, *_LEVEL, 0.0, 0.0, 0.0),
        mavlink.MAVLink_local_position_ned_message(ms, 0.0, 0.0, -5.0, 0.1, 0.1, 0.1),
        mavlink.MAVLink_global_position_int_message(ms, 470000000, 80000000, 400000, 5000, 0, 0, 0, 0),
        mavlink.MAVLink_home_position_message(
            470000000, 80000000, 400000, 0.0, 0.0, 0.0, _LEVEL, 0.0, 0.0, 0.0
        ),
        mavlink.MAVLink_ekf_status_report_message(0x33F, 0.1, 0.1, 0.1, 0.1, 0.1),
        mavlink.MAVLink_statustext_message(4, _TEXT, 7, 0),
        mavlink.MAVLink_command_ack_message(400, 0, 0, 0, 1, 191),
        mavlink.MAVLink_timesync_message(us * 1000, us * 1000),
        mavlink.MAVLink_timesync_message(0, us * 1000),
        mavlink.MAVLink_param_value_message(b"MPC_XY_CRUISE", 5.0, 9, 900, 3),
        mavlink.MAVLink_highres_imu_message(
            us, 0.1, 0.1, -9.8, 0.0, 0.0, 0.0, 0.2, 0.0, 0.4, 960.0, 0.0, 400.0, 30.0, 0xFFFF
        ),
        mavlink.MAVLink_raw_imu_message(us, 10, 10, -1000, 1, 1, 1, 200, 0, 400),
        mavlink.MAVLink_scaled_imu_message(ms, 10, 10, -1000, 1, 1, 1, 200, 0, 400),
        mavlink.MAVLink_gps_raw_int_message(
            us, 3, 470000000, 80000000, 400000, 100, 100, 50, 18000, 12, 400000, 1000, 1000, 100
        ),
        mavlink.MAVLink_distance_sensor_message(ms, 5, 800, 120, 0, 0, 25, 0),
        mavlink.MAVLink_follow_target_message(
            ms, 3, 470000000, 80000000, 400.0, [0.0] * 3, [0.0] * 3, _LEVEL, [0.0] * 3, [1.0] * 3, 0
        ),
    ]  # fmt: skip


def link(rng: random.Random) -> Iterator[None]:
    """Sessions of each make, with and without sensors by telemetry and a key."""
    noise = np.random.default_rng(rng.randrange(2**32))
    while True:
        for kind in ("px4", "ardupilot"):
            for key in (None, SigningKey(bytes(32), 1)):
                sense = None if rng.random() < 0.5 else SenseConfig()
                signing = None if key is None else LinkSigning(key)
                session = Session(LinkConfig(), sense, reads_setup=True, signing=signing)
                yield from _session(session, kind, key, rng, noise)


def _session(
    session: Session, kind: str, key: SigningKey | None, rng: random.Random, noise: np.random.Generator
) -> Iterator[None]:
    senders = (Codec(1, 1), Codec(1, 1), Codec(1, 100), Codec(255, 190), Codec(2, 1))
    if key is not None:
        senders[0].sign(LinkSigning(key))
    now_s, line = 100.0, b""
    for _ in range(NEW_AFTER):
        now_s += rng.choice((0.001, 0.01, 0.05, 0.5))
        frame = rng.choice(senders).encode(rng.choice(_telemetry(now_s, kind)))
        line += frame if rng.random() < 0.2 else KINDS[rng.randrange(len(KINDS))](noise, frame)
        while line and (len(line) > _CUT or rng.random() < 0.8):
            size = rng.randint(1, _CUT)
            session.receive(line[:size], now_s)
            line = line[size:]
        session.tick(now_s)
        session.take_samples()
        _check(session)
        yield


def _check(session: Session) -> None:
    """What the app would fly by is finite, and within its own bounds."""
    state = session.state
    for item in dataclasses.fields(state):
        value = getattr(state, item.name)
        if isinstance(value, tuple) and value and isinstance(value[0], float):
            check_finite(*value)
    share = state.battery_share
    assert share is None or 0.0 <= share <= 1.0, f"battery_share {share}"
    beacon = session.beacons.beacon
    if beacon is not None:
        check_finite(beacon.latitude_deg, beacon.longitude_deg, beacon.altitude_m, *beacon.velocity_ned_m_s)
    assert len(state.texts) < 100, f"{len(state.texts)} texts are kept"
