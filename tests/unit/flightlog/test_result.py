"""The result contract and the plots, from a small made-up flight whose errors are known."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from companion.base.geometry import ZERO3, quat_from_euler, quat_rotate_inverse, subtract
from companion.base.messages import (
    ControlReport,
    FrameReport,
    Outcome,
    PadSighting,
    PadState,
    Phase,
    PlanStep,
    Setpoint,
    Truth,
    VehicleState,
)
from companion.config import Box, Cylinder
from companion.flightlog.errors import TruthTrack
from companion.flightlog.report.figures import outline_m
from companion.flightlog.report.tables import figure, result_table
from companion.flightlog.result import Result, build_result, control_result, from_start, latency, phase_times

STEP_S = 0.02
END_S = 10.0


POLE = Cylinder(kind="cylinder", centre_ned_m=(3.0, 1.0), radius_m=0.5, height_m=4.0)
WALL = Box(kind="box", centre_ned_m=(0.0, 0.0), length_m=4.0, width_m=0.5, heading_deg=30.0, height_m=4.0)


def truth_at(time_s: float) -> Truth:
    """Sinks from 5 m over a pad that drives north at 1 m/s; the nose turns slowly."""
    return Truth(
        time_s=time_s,
        vehicle_position_ned_m=(time_s, 0.5, -5.2 + 0.4 * time_s),
        vehicle_velocity_ned_m_s=(1.0, 0.0, 0.4),
        vehicle_attitude=quat_from_euler(0.05, -0.02, 0.1 * time_s),
        pad_position_ned_m=(time_s, 0.0, -0.2),
        pad_velocity_ned_m_s=(1.0, 0.0, 0.0),
        pad_heading_rad=0.0,
    )


def times(step_s: float) -> list[float]:
    return [step_s * k for k in range(round(END_S / step_s))]


def vehicle_at(time_s: float, attitude_error_rad: float, velocity_error: float) -> VehicleState:
    truth = truth_at(time_s)
    q = quat_from_euler(0.05, -0.02, 0.1 * time_s + attitude_error_rad)
    north, east, down = truth.vehicle_velocity_ned_m_s
    velocity = (north, east + velocity_error, down)
    return VehicleState(time_s, q, ZERO3, ZERO3, velocity, ZERO3, ZERO3, ZERO3, 0, 0, 0, True, True)


def pad_at(time_s: float, velocity_error: float) -> PadState:
    truth = truth_at(time_s)
    relative = subtract(truth.pad_position_ned_m, truth.vehicle_position_ned_m)
    velocity = (1.0 + velocity_error, 0.0, 0.0)
    return PadState(time_s, relative, ZERO3, velocity, ZERO3, 0.0, 0.0, 0.01, 0.1, time_s - 0.05)


def sighting_at(time_s: float, error_right_m: float) -> PadSighting:
    truth = truth_at(time_s)
    relative = subtract(truth.pad_position_ned_m, truth.vehicle_position_ned_m)
    x, y, z = quat_rotate_inverse(truth.vehicle_attitude, relative)
    counts: dict[Any, int] = {"F": 4}
    return PadSighting(time_s, 0, (x, y + error_right_m, z), (1, 0, 0, 0), None, "F", (0,), counts, 0.2)  # type: ignore[arg-type]


def made_up_flight() -> tuple[dict[str, list[Any]], list[Truth]]:
    phases = [Phase.SEARCH] * 100 + [Phase.APPROACH] * 150 + [Phase.DESCEND] * 200 + [Phase.TOUCHDOWN] * 50
    kept: dict[str, list[Any]] = {
        "vehicle": [vehicle_at(t, math.radians(0.5), 0.1) for t in times(0.1)],
        "pad": [pad_at(t, 0.05) for t in times(0.1)],
        "sighting": [sighting_at(t, 0.03) for t in times(0.1)],
        "frame_report": [FrameReport(t, t, t, 0, {"F": 4}, t > 1.0, False) for t in times(0.1)],
        "plan": [PlanStep(0.02 * k, phase) for k, phase in enumerate(phases)],
        "setpoint": [Setpoint(t + 0.07, exposure_time_s=t) for t in times(0.1)],
        "notice": [],
    }
    return kept, [truth_at(t) for t in times(STEP_S)]


def result() -> Result:
    kept, truth = made_up_flight()
    touchdown = {
        "lateral_error_m": 0.031, "vertical_speed_m_s": 0.21, "horizontal_speed_m_s": 0.05,
        "tilt_deg": 1.2, "yaw_error_deg": -2.0,
    }  # fmt: skip
    return build_result(
        scenario="made_up", seed=3, outcome=Outcome.LANDED, touchdown=touchdown, pad_speed_m_s=1.0,
        kept=kept, truth=truth, real_time_factor=4.0,
    )  # fmt: skip


def test_the_errors_put_in_come_out() -> None:
    told = result()
    assert told.estimate.attitude_rmse_deg == pytest.approx(0.5, abs=0.01)
    assert told.estimate.velocity_rmse_m_s == pytest.approx(0.1, abs=1e-4)
    assert told.estimate.pad_velocity_rmse_m_s == pytest.approx(0.05, abs=1e-4)
    assert told.vision.relative_position_rmse_m == pytest.approx(0.03, abs=1e-3)
    assert told.vision.frames == 100
    assert told.vision.frames_with_pad == 89


def test_phases_are_timed() -> None:
    told = result().time
    assert told.search_s == pytest.approx(2.0)
    assert told.approach_s == pytest.approx(3.0)
    assert told.descent_s == pytest.approx(5.0, abs=0.03)
    assert told.total_s == pytest.approx(9.98)
    assert phase_times([]).total_s == 0.0


def test_latency_counts_the_first_setpoint_of_each_exposure_only() -> None:
    setpoints = [Setpoint(0.06, exposure_time_s=0.0), Setpoint(0.5, exposure_time_s=0.0), Setpoint(0.9)]
    assert latency(setpoints).exposure_to_setpoint_p50 == pytest.approx(60.0)
    assert latency([]).exposure_to_setpoint_p50 is None


def test_control_cycles_are_counted() -> None:
    reports = [
        ControlReport(0.0, solved=True, iterations=20, solve_s=0.0),
        ControlReport(0.1, solved=False, iterations=400, solve_s=0.0, limited=("jerk",), late=True),
        ControlReport(0.2, solved=False, iterations=0, solve_s=0.0, stopped=True),
    ]
    told = control_result(reports)
    assert (told.cycles, told.unsolved, told.late, told.stopped, told.limited) == (3, 2, 1, 1, 1)
    assert told.iterations_p99 == pytest.approx(392.4)
    assert control_result([]).iterations_p99 is None


def test_the_contract_has_its_keys_and_survives_json() -> None:
    told = result()
    assert set(told.model_dump()) == {
        "scenario", "seed", "as_built", "outcome", "touchdown", "contacts", "pad", "time", "vision",
        "estimate", "latency_ms", "control", "sim", "events",
    }  # fmt: skip
    assert Result.model_validate_json(told.model_dump_json()) == told


def test_a_flight_that_never_saw_the_pad_still_has_a_result() -> None:
    _, truth = made_up_flight()
    told = build_result(
        scenario="blind", seed=0, outcome=Outcome.TIMEOUT, touchdown=None, pad_speed_m_s=0.0,
        kept={}, truth=truth, real_time_factor=1.0,
    )  # fmt: skip
    assert told.touchdown is None
    assert told.vision.frames == 0
    assert told.estimate.velocity_rmse_m_s is None


def test_an_obstacles_outline_lies_on_its_surface() -> None:
    north, east = outline_m(POLE)
    assert np.hypot(north - 3.0, east - 1.0) == pytest.approx(0.5)
    north, east = outline_m(WALL)
    c, s = math.cos(math.radians(30.0)), math.sin(math.radians(30.0))
    assert len(north) == 5
    assert (north[0], east[0]) == (north[-1], east[-1])
    # 2 m along, 0.25 m to the right of a wall that points 30 degrees to the east of north
    assert (north[0], east[0]) == pytest.approx((2.0 * c - 0.25 * s, 2.0 * s + 0.25 * c))


def test_the_table_shows_what_was_measured_beside_what_passes() -> None:
    console = Console(width=120, record=True, file=None, quiet=False, force_terminal=False)
    with console.capture() as captured:
        console.print(result_table(result(), {"lateral_error_m": 0.15}))
    text = captured.get()
    assert "0.031 m" in text
    assert "<= 0.15 m" in text
    assert "landed" in text


def test_a_truth_track_needs_two_records() -> None:
    with pytest.raises(ValueError, match="at least two"):
        TruthTrack([truth_at(0.0)])


def test_times_count_from_the_first_plan_whatever_the_clock_said() -> None:
    start_s = 4000.0
    plan = PlanStep(start_s, Phase.CONNECT, None)
    pad = replace(pad_at(3.0, 0.0), time_s=start_s + 3.0, seen_time_s=start_s + 2.9)
    truth = [replace(truth_at(t), time_s=start_s - 0.5 + t) for t in (0.0, 1.0)]
    kept, records = from_start({"plan": [plan], "pad": [pad]}, truth)
    assert kept["plan"][0].time_s == 0.0
    assert kept["pad"][0].time_s == 3.0
    assert kept["pad"][0].seen_time_s == pytest.approx(2.9)
    assert [record.time_s for record in records] == [-0.5, 0.5]


# ---------------- The figures of a flight's table have the digits that mean something


@pytest.mark.parametrize(
    ("value", "unit", "bound", "shown"),
    [
        (78.992, "ms", None, "79 ms"),
        (1.5953, "°", 10.0, "1.6 °"),
        (0.1584, "m/s", 0.4, "0.16 m/s"),
        (0.0503, "m", 0.15, "0.050 m"),
        # on the side of the bound where it is
        (0.4003, "m/s", 0.4, "0.4003 m/s"),
        (0.4, "m/s", 0.4, "0.40 m/s"),
        (10.04, "°", 10.0, "10.04 °"),
        (float("inf"), "m", 0.15, "inf m"),
    ],
)
def test_a_figure_has_the_digits_that_mean_something(
    value: float, unit: str, bound: float | None, shown: str
) -> None:
    assert figure(value, unit, bound) == shown
