"""The session asks for the autopilot's sensors and reads them, over a line that delays, through a restart."""

from collections.abc import Callable
from itertools import pairwise

import pytest

from companion.base.messages import ImuSample
from companion.config import AutopilotSensorsConfig, SenseConfig
from companion.link.codec import Message, mavlink
from tests.unit.link.fake_autopilot import FakeAutopilot
from tests.unit.link.session_flight import DELAY_S, SessionFlight
from tests.unit.link.telemetry.autopilot_readings import distance, gps, highres, raw

BUILD: dict[int, Callable[[float], Message]] = {
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: highres,
    mavlink.MAVLINK_MSG_ID_RAW_IMU: raw,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: gps,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: distance,
}


class SensingAutopilot(FakeAutopilot):
    """One that also tells what its sensors measure."""

    def message(self, message_id: int, now_s: float) -> Message:
        build = BUILD.get(message_id)
        return super().message(message_id, now_s) if build is None else build(now_s + self.clock_offset_s)


def imu_of(flight: SessionFlight) -> list[ImuSample]:
    """The samples of the IMU since this was asked last."""
    return [sample for sample in flight.session.take_samples() if isinstance(sample, ImuSample)]


def sense() -> SenseConfig:
    exact = AutopilotSensorsConfig(imu_rate_hz=100.0, imu_latency_s=0.0, gps_latency_s=0.0)
    return SenseConfig(source="autopilot", autopilot=exact)


@pytest.mark.parametrize(
    ("autopilot", "message"),
    [
        (SensingAutopilot("px4", clock_offset_s=50.0), mavlink.MAVLINK_MSG_ID_HIGHRES_IMU),
        (SensingAutopilot("ardupilot", mode="GUIDED", clock_offset_s=50.0), mavlink.MAVLINK_MSG_ID_RAW_IMU),
    ],
    ids=["px4", "ardupilot"],
)
def test_the_streams_are_asked_for_and_their_samples_have_their_own_time(
    autopilot: SensingAutopilot, message: int
) -> None:
    flight = SessionFlight(autopilot=autopilot, sense=sense())
    flight.run(4.0)
    assert autopilot.rates_hz[message] == pytest.approx(100.0)
    assert autopilot.rates_hz[mavlink.MAVLINK_MSG_ID_GPS_RAW_INT] == pytest.approx(5.0)
    assert autopilot.rates_hz[mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR] == pytest.approx(20.0)
    imu_of(flight)
    flight.run(1.0)
    samples = imu_of(flight)
    assert len(samples) == pytest.approx(90, abs=12)
    # sent on a step of the line and DELAY_S on the way: not older, not newer
    assert flight.now_s - samples[-1].time_s == pytest.approx(DELAY_S, abs=0.011)
    steps = [b.time_s - a.time_s for a, b in pairwise(samples)]
    assert min(steps) > 0.0


def test_boards_of_ours_ask_for_no_such_stream() -> None:
    autopilot = SensingAutopilot()
    flight = SessionFlight(autopilot=autopilot)
    flight.run(4.0)
    assert not set(BUILD) & set(autopilot.rates_hz)
    assert imu_of(flight) == []


def test_after_a_restart_the_clock_is_found_again_within_two_seconds() -> None:
    autopilot = SensingAutopilot(clock_offset_s=500.0)
    flight = SessionFlight(autopilot=autopilot, sense=sense())
    flight.run(5.0)
    autopilot.clock_offset_s = -flight.now_s + 3.0
    imu_of(flight)
    flight.run(2.2)
    assert imu_of(flight)
    flight.run(0.5)
    samples = imu_of(flight)
    assert len(samples) >= 40
    assert flight.now_s - samples[-1].time_s == pytest.approx(DELAY_S, abs=0.011)
