"""What breaks in flight: the app stays alive, and the flight lands or ends where a person can take over."""

import errno
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from companion.base.messages import ActionKind, Outcome
from companion.control.controller import Controller
from companion.flightlog.record import FlightLog
from companion.sense.gps.neo6m import Neo6m
from companion.sense.vision.pipeline import Vision
from sitl.devices.mpu9250 import Mpu9250Device
from tests.scenario.flying import FEW_PICTURES, fly_logged, notices, scenario_file

# by then the vehicle is on its way down to the pad
IN_DESCENT_S = 21.0


def static(folder: Path, **changes: Any) -> Path:
    return scenario_file(folder, "static", {**FEW_PICTURES, **changes})


def failing(
    method: Callable[..., Any], error: Exception, fails: Callable[[tuple[Any, ...]], bool]
) -> Callable[..., Any]:
    """The method, which raises when `fails` says so of its arguments."""

    def changed(*arguments: Any, **named: Any) -> Any:
        if fails(arguments):
            raise error
        return method(*arguments, **named)

    return changed


def test_torn_frames_an_unplugged_gps_and_bus_errors_now_and_then_do_not_keep_from_landing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    torn = failing(Vision.step, ValueError("torn"), lambda a: 0.0 < a[1].time_s - IN_DESCENT_S < 0.3)
    unplugged = failing(Neo6m.feed, OSError(errno.EIO, "unplugged"), lambda a: a[2] > IN_DESCENT_S)
    count = 0

    def every_fortieth(_arguments: tuple[Any, ...]) -> bool:
        nonlocal count
        count += 1
        return count > 1000 and count % 40 == 0

    nack = failing(Mpu9250Device.read, OSError(errno.EREMOTEIO, "no answer"), every_fortieth)
    monkeypatch.setattr(Vision, "step", torn)
    monkeypatch.setattr(Neo6m, "feed", unplugged)
    monkeypatch.setattr(Mpu9250Device, "read", nack)
    flight, log = fly_logged(static(tmp_path))
    assert flight.report.outcome is Outcome.LANDED, flight.report.failures
    assert "skipped: ValueError: torn" in notices(log)
    assert "gps lost: unplugged" in notices(log)


def test_a_control_loop_that_fails_leaves_the_vehicle_holding(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    log = FlightLog(None, start_unix_s=0.0)
    fails = failing(Controller.step, RuntimeError("a bug"), lambda a: a[4] > IN_DESCENT_S)
    monkeypatch.setattr(Controller, "step", fails)
    with pytest.raises(ExceptionGroup, match="unhandled errors") as caught:
        fly_logged(static(tmp_path), log)
    assert caught.group_contains(RuntimeError, match="a bug")
    held = [result for result in log.kept["action_result"] if result.kind is ActionKind.HOLD]
    assert [result.accepted for result in held] == [True]


def test_an_imu_that_is_stuck_is_believed_for_50_ms_and_the_estimate_is_given_up_for_good(
    tmp_path: Path,
) -> None:
    # GIVEN a flight WHEN the IMU repeats its sample from then on, however often it is set up anew
    fault = {"kind": "imu_stuck", "start_s": IN_DESCENT_S}
    flight, log = fly_logged(static(tmp_path, faults=[fault]))
    # THEN no estimate rests on what it says more than 50 ms later, and the flight ends without one
    assert flight.report.outcome is Outcome.ABORTED, flight.report.failures
    rest_on_s = [state.time_s - state.imu_age_s for state in log.kept["vehicle"]]
    assert IN_DESCENT_S < max(rest_on_s) < IN_DESCENT_S + 0.05 + 0.02  # and a poll or two
    assert "estimate lost: no current vehicle estimate" in notices(log)
    assert "stuck: the same sample" in notices(log)
