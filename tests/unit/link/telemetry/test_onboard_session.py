"""The session asks for the autopilot's sensors and reads them, over a line that delays, through a restart."""

from collections.abc import Callable
from itertools import pairwise

import pytest

from companion.base.messages import ImuSample
from companion.config import AutopilotSensorsConfig, LinkConfig, SenseConfig
from companion.link.codec import Message, mavlink
from companion.link.session import Session
from tests.unit.link.fake_autopilot import FakeAutopilot
from tests.unit.link.telemetry.autopilot_readings import distance, gps, highres, raw

DELAY_S = 0.006
STEP_S = 0.002
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


class TelemetryFlight:
    """Session and autopilot, a line with a constant delay between them."""

    def __init__(self, autopilot: SensingAutopilot, sense: SenseConfig | None) -> None:
        self.session, self.autopilot, self.now_s = Session(LinkConfig(), sense), autopilot, 10.0
        self.imu: list[ImuSample] = []
        self._line: list[tuple[float, bytes]] = []
        self._back: list[tuple[float, bytes]] = []

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            while self._line and self._line[0][0] <= self.now_s:
                self.session.receive(self._line.pop(0)[1], self.now_s)
            self.imu += [s for s in self.session.take_samples() if isinstance(s, ImuSample)]
            self._back.append((self.now_s + DELAY_S, self.session.tick(self.now_s)))
            while self._back[0][0] <= self.now_s:
                self._line.append(
                    (self.now_s + DELAY_S, self.autopilot.receive(self._back.pop(0)[1], self.now_s))
                )
            self._line.append((self.now_s + DELAY_S, self.autopilot.tick(self.now_s)))


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
    flight = TelemetryFlight(autopilot, sense())
    flight.run(4.0)
    assert autopilot.rates_hz[message] == pytest.approx(100.0)
    assert autopilot.rates_hz[mavlink.MAVLINK_MSG_ID_GPS_RAW_INT] == pytest.approx(5.0)
    assert autopilot.rates_hz[mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR] == pytest.approx(20.0)
    flight.imu.clear()
    flight.run(1.0)
    assert len(flight.imu) == pytest.approx(90, abs=12)
    # sent on a step of the line and DELAY_S on the way: not older, not newer
    ages = [flight.now_s - sample.time_s for sample in flight.imu[-1:]]
    assert ages[0] == pytest.approx(DELAY_S, abs=0.011)
    steps = [b.time_s - a.time_s for a, b in pairwise(flight.imu)]
    assert min(steps) > 0.0


def test_boards_of_ours_ask_for_no_such_stream() -> None:
    autopilot = SensingAutopilot()
    flight = TelemetryFlight(autopilot, None)
    flight.run(4.0)
    assert not set(BUILD) & set(autopilot.rates_hz)
    assert flight.imu == []


def test_after_a_restart_the_clock_is_found_again_within_two_seconds() -> None:
    autopilot = SensingAutopilot(clock_offset_s=500.0)
    flight = TelemetryFlight(autopilot, sense())
    flight.run(5.0)
    autopilot.clock_offset_s = -flight.now_s + 3.0
    flight.imu.clear()
    flight.run(2.2)
    assert flight.imu
    flight.imu.clear()
    flight.run(0.5)
    assert len(flight.imu) >= 40
    assert flight.now_s - flight.imu[-1].time_s == pytest.approx(DELAY_S, abs=0.011)
