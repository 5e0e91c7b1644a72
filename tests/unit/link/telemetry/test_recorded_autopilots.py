"""The sensors of a recorded ArduCopter and a recorded PX4, through the same code as in flight.

The recordings lie beside the repository, in `../shared/data/autopilot`; without them there is nothing to do.
"""

import math
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import norm
from companion.base.messages import GpsFix, ImuSample, MagSample, RangeSample
from companion.config import CONFIG_FOLDER, SenseConfig
from companion.link.codec import Codec, mavlink
from companion.link.telemetry.autopilot_sensors import SENSOR_MESSAGES, Sample, TelemetrySensors
from companion.link.timesync import BootClock, TimeSync

# a worktree lies one folder deeper than a checkout
FOLDERS = [folder / "shared" / "data" / "autopilot" for folder in CONFIG_FOLDER.resolve().parents[1:3]]
RECORDINGS = next((folder for folder in FOLDERS if folder.is_dir()), None)
pytestmark = pytest.mark.skipif(
    RECORDINGS is None, reason="no recordings of real autopilots in ../shared/data/autopilot"
)
FILES: dict[AutopilotKind, str] = {"ardupilot": "arducopter.tlog", "px4": "px4.tlog"}
REST_S = 0.9  # the motors start soon after the recording
IMU = {"ardupilot": mavlink.MAVLINK_MSG_ID_RAW_IMU, "px4": mavlink.MAVLINK_MSG_ID_HIGHRES_IMU}


def frames(path: Path) -> Iterator[tuple[float, Any]]:
    """The autopilot's sensor messages with the recorder's time (µs, big-endian, before each frame)."""
    data, at = path.read_bytes(), 0
    codec = Codec(1, wanted=SENSOR_MESSAGES)
    while at + 10 <= len(data):
        time_s, header = int.from_bytes(data[at : at + 8], "big") * 1e-6, data[at + 8 : at + 18]
        size = header[1] + (12 if header[0] == 0xFD else 8)
        if header[0] == 0xFD and header[2] & 1:
            size += 13
        for message in codec.decode(data[at + 8 : at + 8 + size]):
            yield time_s, message
        at += 8 + size


@cache
def replay(autopilot_kind: AutopilotKind, imu_message: int) -> dict[type, list[Any]]:
    """All samples by kind. Nobody asked for TIMESYNC: its answers are made from the quickest message."""
    assert RECORDINGS is not None
    recorded = [
        (time_s, m)
        for time_s, m in frames(RECORDINGS / FILES[autopilot_kind])
        if m.get_msgId() == imu_message or m.get_msgId() not in IMU.values()
    ]
    timesync, start_s = TimeSync(), recorded[0][0]
    sensors = TelemetrySensors(SenseConfig(source="autopilot"), BootClock(timesync))
    samples: dict[type, list[Sample]] = {kind: [] for kind in (ImuSample, MagSample, GpsFix, RangeSample)}
    stamps = np.array([(t, m.time_usec * 1e-6 - t) for t, m in recorded if m.get_msgId() == imu_message])
    answered_s = -math.inf
    for time_s, message in recorded:
        now_s = time_s - start_s
        if now_s - answered_s > 0.2:
            offset_s = float(stamps[np.abs(stamps[:, 0] - time_s) < 0.5, 1].max())
            for _ in range(5 if answered_s < 0.0 else 1):
                timesync.answered(round((time_s + offset_s) * 1e9), timesync.ask(now_s), now_s)
            answered_s = now_s
        sensors.heartbeat(autopilot_kind, now_s)
        sensors.hear(message, now_s)
        for sample in sensors.take():
            samples[type(sample)].append(sample)
    return samples


@pytest.mark.parametrize(
    ("autopilot_kind", "message", "rate_hz", "still_std_m_s2"),
    [
        ("ardupilot", mavlink.MAVLINK_MSG_ID_RAW_IMU, 20.0, 0.02),
        ("ardupilot", mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, 50.0, 0.02),
        ("px4", mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, 50.0, 0.2),
    ],
)
def test_the_imu_shows_gravity_at_rest_and_a_field_of_the_earths_size(
    autopilot_kind: AutopilotKind, message: int, rate_hz: float, still_std_m_s2: float
) -> None:
    samples = replay(autopilot_kind, message)
    imu, mag = samples[ImuSample], samples[MagSample]
    times = np.array([sample.time_s for sample in imu])
    assert len(imu) > 0.9 * rate_hz * (times[-1] - times[0])
    assert 1.0 / np.median(np.diff(times)) == pytest.approx(rate_hz, rel=0.05)
    assert np.diff(times).min() > 0.0
    rest = np.array([s.specific_force_body_m_s2 for s in imu if s.time_s < times[0] + REST_S])
    assert rest.mean(axis=0) == pytest.approx((0.0, 0.0, -9.81), abs=0.1)
    assert rest.std(axis=0).max() < still_std_m_s2
    still = np.array([s.rate_body_rad_s for s in imu if s.time_s < times[0] + REST_S])
    assert np.abs(still.mean(axis=0)).max() < math.radians(0.3)
    turned_rad_s = max(abs(s.rate_body_rad_s[2]) for s in imu)
    assert math.radians(20.0) < turned_rad_s < math.radians(220.0)  # it yawed by 90 degrees
    fields = np.array([norm(s.field_body_ut) for s in mag])
    print(f"{autopilot_kind}: imu {len(imu)}, mag {len(mag)}, {fields.mean():.1f} +- {fields.std():.1f} µT")
    assert 40.0 < np.median(fields) < 65.0
    assert fields.std() < 5.0
    if autopilot_kind == "px4":
        assert len(mag) < len(imu)  # its compass is slower, and the bits say so


@pytest.mark.parametrize(("autopilot_kind", "latitude_deg"), [("ardupilot", -35.363), ("px4", 47.3977)])
def test_the_receiver_shows_place_and_speed_of_the_flight(
    autopilot_kind: AutopilotKind, latitude_deg: float
) -> None:
    fixes = replay(autopilot_kind, IMU[autopilot_kind])[GpsFix]
    times = np.array([fix.time_s for fix in fixes])
    assert 1.0 / np.median(np.diff(times)) == pytest.approx(5.0, rel=0.25)
    assert np.median([fix.latitude_deg for fix in fixes]) == pytest.approx(latitude_deg, abs=1e-3)
    heights = np.array([fix.altitude_m for fix in fixes])
    # it climbed to 8 m; PX4's simulated receiver is off by half a metre and more
    assert 7.0 < np.percentile(heights, 90.0) - np.median(heights[:20]) < 10.0
    # speed by course against the way between fixes: north is north
    north = np.array([fix.latitude_deg for fix in fixes]) * 111_120.0
    east = np.array([fix.longitude_deg for fix in fixes]) * 111_320.0 * math.cos(math.radians(latitude_deg))
    way = np.stack([np.gradient(north, times), np.gradient(east, times)], axis=1)
    told = np.array([fix.velocity_ned_m_s[:2] for fix in fixes])
    window = np.ones(5) / 5
    way, told = (
        np.stack([np.convolve(v[:, k], window, "same") for k in (0, 1)], axis=1) for v in (way, told)
    )
    for axis in (0, 1):
        fast = np.abs(told[:, axis]) > 0.6
        if fast.sum() > 10:
            assert np.corrcoef(told[fast, axis], way[fast, axis])[0, 1] > 0.8


def test_px4s_rangefinder_is_read_although_its_quality_is_not_reported() -> None:
    echoes = replay("px4", IMU["px4"])[RangeSample]
    distances = [echo.distance_m for echo in echoes]
    assert len(distances) > 20
    assert max(distances) <= SenseConfig().range.maximum_m
