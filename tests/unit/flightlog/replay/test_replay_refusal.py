"""Why the estimators never aligned over a log."""

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, vector3
from companion.base.messages import ImuSample, MagSample
from companion.config import AlignmentConfig
from companion.flightlog.replay.flight_record import RecordedEvent
from companion.flightlog.replay.refusal import shortcomings, why_unaligned

FIELD = (20.9, 0.6, 42.9)


def log(times: np.ndarray, shaking_rad_s: float = 0.0, field: bool = True) -> list[RecordedEvent]:
    rng = np.random.default_rng(1)
    events = []
    for t in times.tolist():
        rate = vector3(shaking_rad_s * rng.standard_normal(3))
        events.append(RecordedEvent(t, ImuSample(t, rate, (0.0, 0.0, -GRAVITY_M_S2), 20.0)))
        if field:
            events.append(RecordedEvent(t, MagSample(t, FIELD)))
    return events


SECONDS = np.arange(0.0, 10.0, 0.01)


@pytest.mark.parametrize(
    ("events", "words"),
    [
        (log(SECONDS[::10]), "the IMU comes at 10 Hz; expected at least 30"),
        (log(SECONDS, 0.5), "at rest for 0.0 s at most and 10.0 s long; expected 2 s at rest"),
        (
            log(np.concatenate((SECONDS[:100], 4.0 + SECONDS[:100]))),
            "silent for 3.0 s, 1.0 s after its start; expected no gap beyond 2 s",
        ),
        (log(SECONDS, field=False), "1000 samples of the IMU and 0 of the magnetometer"),
    ],
)
def test_the_reason_is_named(events: list[RecordedEvent], words: str) -> None:
    assert words in why_unaligned(events, AlignmentConfig())


def test_each_reason_that_holds_is_named() -> None:
    words = why_unaligned(log(SECONDS[::20], 0.5), AlignmentConfig())
    assert words.count(";") >= 2


def test_a_log_that_falls_short_of_what_is_documented_is_told_in_what() -> None:
    assert shortcomings(log(SECONDS[::2])) == []
    assert shortcomings(log(SECONDS[::4])) == ["the IMU comes at 25 Hz; expected at least 30"]
    gaps = np.concatenate((SECONDS, 13.0 + SECONDS, 30.0 + SECONDS))
    (words,) = shortcomings(log(gaps))  # 100 Hz, whatever the mean over its gaps
    assert words.startswith("the IMU is silent for 7.0 s, 23.0 s after its start, and 1 more")
