"""What a reset of the attitude does to the pad: what was seen with the wrong one is seen again."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from companion.base.geometry import add
from companion.base.messages import AutopilotAttitude, ImuSample
from tests.attitudes import DEGREE
from tests.unit.estimate.estimate_flight import EstimateFlight, feed, hover, new_estimator, smooth

GAP = (19.05, 19.4)
WRONG_FROM_S = 18.0
HIDDEN_RAD = 0.6


def kick(t: float) -> float:
    """A turn by 34 degrees that begins and ends within the gap."""
    return HIDDEN_RAD * smooth(t, 19.07, 19.38)


@dataclass
class ResetRun:
    """From the reset on: what is stated of the pad, and how far that is off; and good sightings refused."""

    reset_s: float = math.inf
    error_m: list[float] = field(default_factory=list)
    std_m: list[float] = field(default_factory=list)
    speed_error_m_s: list[float] = field(default_factory=list)
    speed_std_m_s: list[float] = field(default_factory=list)
    refused_before: int = 0
    refused: int = 0


def fly(heading_turns: bool, rate_deg_s: float, report_delay_s: float) -> ResetRun:
    """The autopilot has the same IMU and the right attitude.

    Either the vehicle turns while we get no samples, or until the reset ours read a rate that there is not.
    """
    flight = EstimateFlight(
        hover,
        heading=kick if heading_turns else lambda _: 0.0,
        seed=31,
        duration_s=20.5,
        sensors=frozenset({"imu", "mag", "gps", "sighting"}),
    )
    estimator, run, reports = new_estimator(), ResetRun(), []
    for arrival_s, sample in flight.samples:
        if isinstance(sample, ImuSample):
            if heading_turns and GAP[0] < sample.time_s < GAP[1]:
                continue
            if sample.time_s > WRONG_FROM_S and run.reset_s == math.inf:
                wrong = add(sample.rate_body_rad_s, (rate_deg_s * DEGREE, 0.0, 0.0))
                sample = replace(sample, rate_body_rad_s=wrong)  # noqa: PLW2901
            reports.append(AutopilotAttitude(sample.time_s, flight.attitude(sample.time_s), same_imu=True))
        feed(estimator, sample)
        while reports and reports[0].time_s <= arrival_s - report_delay_s:
            estimator.add_autopilot_attitude(reports.pop(0))
        refused = estimator.refused.get("sighting_gate", 0)
        if estimator.take_notices() and run.reset_s == math.inf:
            run.reset_s = arrival_s
        if run.reset_s == math.inf:
            run.refused_before = refused
        elif arrival_s < run.reset_s + 0.5:
            run.refused = refused
            pad = estimator.pad(arrival_s)
            assert pad is not None
            off = np.subtract(pad.relative_position_ned_m, np.subtract((1.0, -0.5, 0.0), hover(arrival_s)))
            run.error_m.append(float(np.hypot(*off[:2])))
            run.std_m.append(pad.lateral_std_m())
            run.speed_error_m_s.append(float(np.hypot(*pad.relative_velocity_ned_m_s[:2])))
            run.speed_std_m_s.append(math.sqrt(pad.covariance[3][3] + pad.covariance[4][4]))
    return run


@pytest.mark.parametrize(
    ("heading_turns", "rate_deg_s", "report_delay_s"),
    [(True, 0.0, 0.02), (True, 0.0, 0.2), (False, 6.0, 0.02), (False, 10.0, 0.02)],
)
def test_after_a_reset_the_pad_is_where_it_is_at_once(
    heading_turns: bool, rate_deg_s: float, report_delay_s: float
) -> None:
    run = fly(heading_turns, rate_deg_s, report_delay_s)
    assert run.reset_s < 19.8
    assert max(e / s for e, s in zip(run.error_m, run.std_m, strict=True)) < 3.0
    assert max(e / s for e, s in zip(run.speed_error_m_s, run.speed_std_m_s, strict=True)) < 5.0
    assert run.refused <= run.refused_before + 1
