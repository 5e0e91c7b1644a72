"""Commands under way."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import GRAVITY_M_S2, FloatArray
from companion.base.messages import AutopilotSetup
from companion.base.motion import Motion
from companion.config import (
    ARDUPILOT,
    PX4,
    AxisResponse,
    ControlConfig,
    Kind,
    KindResponse,
    VehicleConfig,
    find_file,
    load_model,
)
from companion.control.response.fitting import QUICK_S, fitted, loop_rad_s, misfits
from companion.control.response.flight_model import advance, advance_axis, discretise, lags, velocity_gains
from companion.control.response.history import CommandHistory, SentCommand
from companion.control.response.hover_thrust import (
    KNOWN_STD,
    LEAST_SHARE,
    MOST_SHARE,
    TOLD_STD,
    HeldThrust,
    HoverThrust,
)
from companion.control.response.identification import (
    IdentifiedResponse,
    ResponseEstimate,
    ResponseRecord,
    TooLittleError,
    fit,
    hover_thrust,
    prediction_error_m_s,
    windows,
)
from tests.unit.control.control_plants import vehicle_config

LAGS_S = (0.18, 0.18, 0.05)
GAINS_1_S = (2.5, 2.5, 4.0)
REST = Motion((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def _sent(at_s: float, north: float) -> SentCommand:
    return SentCommand(at_s, (north, 0.0, 0.0))


def test_a_command_counts_from_its_arrival() -> None:
    history = CommandHistory(0.04)
    first, second = _sent(1.0, 1.0), _sent(1.033, 2.0)
    history.commands.append(first)
    history.commands.append(second)
    pieces = history.segments(1.0, 1.1)
    assert [command for _, command in pieces] == [None, first, second]
    assert [duration for duration, _ in pieces] == pytest.approx([0.04, 0.033, 0.027])


def test_old_commands_leave_one_piece_with_the_newest() -> None:
    history = CommandHistory(0.04)
    for k in range(200):
        history.commands.append(_sent(0.01 * k, float(k)))
    pieces = history.segments(5.0, 5.1)
    assert [duration for duration, _ in pieces] == pytest.approx([0.1])
    assert pieces[0][1] == _sent(1.99, 199.0)


def test_nothing_between_equal_times_and_none_without_commands() -> None:
    history = CommandHistory(0.04)
    assert history.segments(1.0, 1.0) == []
    assert [command for _, command in history.segments(1.0, 1.2)] == [None]
    assert history.last_effect((0.0, 0.0, 0.0)) is None


def test_the_velocity_loop_adds_its_share() -> None:
    history = CommandHistory(0.04)
    history.commands.append(SentCommand(0.0, (0.1, 0.0, 0.0), (1.0, 0.0, -1.0), GAINS_1_S))
    assert history.last_effect((0.8, 0.2, 0.0)) == pytest.approx((0.6, -0.5, -4.0))


def test_carry_flies_each_piece_with_its_command_and_the_disturbance() -> None:
    history = CommandHistory(0.04)
    history.commands.append(_sent(0.0, 1.0))
    history.commands.append(_sent(0.05, -1.0))
    end = history.carry(REST, 0.04, 0.12, (0.0, 0.5, 0.0), LAGS_S)
    expected = advance(advance(REST, (1.0, 0.5, 0.0), 0.05, LAGS_S), (-1.0, 0.5, 0.0), 0.03, LAGS_S)
    assert end.position_m == pytest.approx(expected.position_m)
    assert end.acceleration_m_s2 == pytest.approx(expected.acceleration_m_s2)


def test_before_the_first_command_the_vehicle_goes_on_as_it_is() -> None:
    moving = Motion((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.4, 0.0, 0.0))
    end = CommandHistory(0.04).carry(moving, 0.0, 0.1, (1.0, 0.0, 0.0), LAGS_S)
    assert end.acceleration_m_s2 == pytest.approx((0.4, 0.0, 0.0))
    assert end.position_m[0] == pytest.approx(0.1 + 0.5 * 0.4 * 0.01)


# ----------------
# The loop is made to fit the vehicle's response, and never quicker or bolder than it was set.

CONFIG = ControlConfig()
VEHICLE = vehicle_config()


def _by(dead_time_s: float, frequency_rad_s: float, damping: float) -> KindResponse:
    axis = AxisResponse(dead_time_s=dead_time_s, frequency_rad_s=frequency_rad_s, damping=damping)
    return KindResponse(sideways=axis, down=axis)


def test_a_quick_response_leaves_all_as_it_was_set() -> None:
    assert fitted(CONFIG, _by(0.0, 100.0, 1.0)) == CONFIG


def test_twice_as_late_is_flown_half_as_fast() -> None:
    slow = fitted(CONFIG, _by(2.0 * QUICK_S - 0.02, 100.0, 1.0))
    for before, after in ((CONFIG.horizontal, slow.horizontal), (CONFIG.vertical, slow.vertical)):
        assert loop_rad_s(after) == pytest.approx(0.5 * loop_rad_s(before))
        assert after.velocity_m_s == pytest.approx(2.0 * before.velocity_m_s)
        assert after.effort_m_s2 == before.effort_m_s2


def test_one_that_rings_is_flown_far_below_its_ringing() -> None:
    damped, ringing = (fitted(CONFIG, _by(0.03, 8.0, damping)) for damping in (0.7, 0.26))
    assert loop_rad_s(ringing.horizontal) < 0.5 * loop_rad_s(damped.horizontal)


def test_no_more_is_asked_than_the_autopilot_lets_through() -> None:
    velocity = CONFIG.model_copy(update={"setpoint": "velocity"})
    own = fitted(velocity, ARDUPILOT.velocity).limits
    assert (own.horizontal_acceleration_m_s2, own.jerk_m_s3) == (2.5, 5.0)
    assert fitted(CONFIG, PX4.attitude).limits == CONFIG.limits
    # what was read from the autopilot goes before the vehicle's file, and never widens what was set
    setup = AutopilotSetup(acceleration_m_s2=4.0, jerk_m_s3=90.0, tilt_deg=20.0)
    read = fitted(velocity, ARDUPILOT.velocity, setup).limits
    assert (read.horizontal_acceleration_m_s2, read.jerk_m_s3, read.tilt_deg) == (
        4.0,
        CONFIG.limits.jerk_m_s3,
        20.0,
    )


def test_its_limits_on_velocity_setpoints_bind_no_attitude() -> None:
    attitude = CONFIG.model_copy(update={"setpoint": "attitude"})
    setup = AutopilotSetup(acceleration_m_s2=1.0, jerk_m_s3=5.0, tilt_deg=45.0)
    assert fitted(attitude, ARDUPILOT.attitude, setup).limits == CONFIG.limits


def test_what_does_not_fit_is_reported_a_line_each() -> None:
    assert misfits(CONFIG, VEHICLE, AutopilotSetup(45.0, VEHICLE.hover_thrust)) == []
    told = misfits(CONFIG, VEHICLE, AutopilotSetup(tilt_deg=20.0, hover_thrust=0.2))
    assert [line.split(":")[0] for line in told] == ["hover thrust", "tilt limit"]


# ---------------- The model of how a vehicle answers: exact under a held input, and consistent with itself

TAU_S = 0.18
AXIS_LAGS_S = (0.18, 0.12, 0.05)


@pytest.mark.parametrize("step_s", [0.005, 0.033, 0.1, 0.5])
def test_discretisation_equals_the_matrix_exponential(step_s: float) -> None:
    continuous = np.zeros((4, 4))
    continuous[0, 1] = continuous[1, 2] = 1.0
    continuous[2, 2], continuous[2, 3] = -1.0 / TAU_S, 1.0 / TAU_S
    exact = expm(continuous * step_s)
    A, B = discretise(step_s, TAU_S)
    np.testing.assert_allclose(A, exact[:3, :3], atol=1e-12)
    np.testing.assert_allclose(B, exact[:3, 3], atol=1e-12)


def test_two_short_steps_make_one_long_one() -> None:
    start = (1.0, -2.0, 0.5)
    halfway = advance_axis(start, 1.5, 0.04, TAU_S)
    assert advance_axis(halfway, 1.5, 0.06, TAU_S) == pytest.approx(advance_axis(start, 1.5, 0.1, TAU_S))


def test_no_time_changes_nothing_and_long_time_reaches_the_input() -> None:
    assert advance_axis((1.0, 2.0, 3.0), 9.0, 0.0, TAU_S) == (1.0, 2.0, 3.0)
    assert advance_axis((0.0, 0.0, -3.0), 0.7, 5.0, TAU_S)[2] == pytest.approx(0.7, abs=1e-9)


def test_axes_do_not_mix() -> None:
    start = Motion((1.0, 2.0, 3.0), (0.1, 0.2, 0.3), (-1.0, 0.0, 1.0))
    end = advance(start, (0.5, -0.5, 0.25), 0.2, AXIS_LAGS_S)
    for axis, u in enumerate((0.5, -0.5, 0.25)):
        alone = advance_axis(
            (start.position_m[axis], start.velocity_m_s[axis], start.acceleration_m_s2[axis]),
            u,
            0.2,
            AXIS_LAGS_S[axis],
        )
        assert (end.position_m[axis], end.velocity_m_s[axis], end.acceleration_m_s2[axis]) == alone


def _late(name: str) -> VehicleConfig:
    return load_model(VehicleConfig, find_file("vehicles", name))


@pytest.mark.parametrize("kind", ["attitude", "acceleration", "velocity"])
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_lag_and_delay_together_are_as_late_as_the_response(
    autopilot_kind: AutopilotKind, kind: Kind
) -> None:
    vehicle, config = _late("x500"), ControlConfig(setpoint=kind, command_delay_s=0.02)
    response = vehicle.responses.of(autopilot_kind, kind)
    x, y, z = lags(vehicle, config, autopilot_kind)
    assert x == y == pytest.approx(response.sideways.delay_s - 0.02)
    assert z == pytest.approx(response.down.delay_s - 0.02)


def test_what_was_measured_on_the_vehicle_goes_before_its_responses() -> None:
    vehicle = vehicle_config(acceleration_time_constant_s=0.11, thrust_time_constant_s=0.04)
    shaped = ControlConfig(setpoint="velocity", autopilot_lag_s=0.2, autopilot_climb_lag_s=0.3)
    assert lags(vehicle, shaped) == (0.2, 0.2, 0.3)
    for kind in ("attitude", "acceleration"):
        assert lags(vehicle, shaped.model_copy(update={"setpoint": kind})) == (0.11, 0.11, 0.04)


def test_velocity_gains_are_the_autopilots_own_unless_they_were_measured() -> None:
    vehicle, config = _late("x500"), ControlConfig(setpoint="acceleration")
    assert velocity_gains(vehicle, config, "px4", sideways=False) == (0.0, 0.0, 4.0)
    assert velocity_gains(vehicle, config, "px4") == (1.8, 1.8, 4.0)
    measured = ControlConfig(setpoint="velocity", autopilot_velocity_gain_1_s=3.0)
    assert velocity_gains(vehicle, measured, "ardupilot") == (3.0, 3.0, 1.7)
    assert velocity_gains(vehicle, ControlConfig(setpoint="attitude"), "ardupilot") == (0.0, 0.0, 0.0)


# ----------------
# The thrust that holds the vehicle is measured in a fraction of a second, and how well it is known too.

PERIOD_S = 1.0 / 30.0
BANDWIDTH_RAD_S = 0.6


def fly(estimate: HoverThrust, true: float, thrust: float, seconds: float, noise_g: float = 0.0) -> None:
    """A thrust that acts for a while on a vehicle that `true` would hold."""
    rng = np.random.default_rng(1)
    for _ in range(round(seconds / PERIOD_S)):
        felt_g = thrust / true + noise_g * float(rng.normal())
        made_g = thrust / estimate.value
        estimate.correct(GRAVITY_M_S2 * (1.0 - felt_g), GRAVITY_M_S2 * (1.0 - made_g), PERIOD_S)


@pytest.mark.parametrize("share", [0.5, 0.7, 1.0, 1.3, 1.6])
@pytest.mark.parametrize("thrust_share", [0.8, 1.0, 1.2])
def test_whatever_was_told_it_is_right_within_half_a_second_in_hover_or_not(
    share: float, thrust_share: float
) -> None:
    estimate, true = HoverThrust(0.45, BANDWIDTH_RAD_S, TOLD_STD), 0.45 * share
    fly(estimate, true, thrust_share * true, 0.5)
    assert estimate.value == pytest.approx(true, rel=0.08)
    assert estimate.std <= KNOWN_STD


def test_the_covariance_says_how_far_off_it_is() -> None:
    errors, stds = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        true = 0.5 * float(np.clip(1.0 + 0.4 * rng.normal(), 0.4, 2.0))
        estimate = HoverThrust(0.5, BANDWIDTH_RAD_S, TOLD_STD)
        air_g, share = 0.0, math.exp(-PERIOD_S / 0.5)
        for _ in range(30):
            air_g = share * air_g + 0.05 * math.sqrt(1.0 - share**2) * float(rng.normal())
            felt_g, made_g = 1.0 + air_g, true / estimate.value
            estimate.correct(-GRAVITY_M_S2 * (felt_g - 1.0), GRAVITY_M_S2 * (1.0 - made_g), PERIOD_S)
        errors.append(estimate.value / true - 1.0)
        stds.append(estimate.std)
    assert 0.5 < float(np.std(errors)) / float(np.mean(stds)) < 1.5


def test_settled_it_follows_a_change_as_fast_as_asked_and_passes_over_what_is_no_number() -> None:
    estimate = HoverThrust(0.5, BANDWIDTH_RAD_S)
    fly(estimate, 0.5, 0.5, 20.0, noise_g=0.02)
    fly(estimate, 0.6, 0.6, 1.0 / BANDWIDTH_RAD_S)
    assert 0.55 < estimate.value < 0.59
    before = estimate.value
    assert estimate.correct(math.nan, 0.0, PERIOD_S) == 1.0
    assert estimate.correct(0.0, math.inf, PERIOD_S) == 1.0
    assert estimate.value == before


def settled_in_gust(air_g: float, **told: bool) -> float:
    """The estimate, 0.5 before, half a second after the air has begun to add so much to what is felt."""
    estimate = HoverThrust(0.5, BANDWIDTH_RAD_S)
    for _ in range(round(0.5 / PERIOD_S)):
        made_g = 0.5 / estimate.value
        estimate.correct(-GRAVITY_M_S2 * air_g, GRAVITY_M_S2 * (1.0 - made_g), PERIOD_S, **told)
    return estimate.value


def test_a_gust_that_sinks_is_followed_within_half_a_second_and_what_is_small_as_slowly_as_ever() -> None:
    slow, quick = (settled_in_gust(-0.3, follows_gusts=follows) for follows in (False, True))
    holds = 0.5 / 0.7
    assert abs(slow - holds) > 0.6 * abs(0.5 - holds)
    assert abs(quick - holds) < 0.4 * abs(0.5 - holds)
    assert settled_in_gust(-0.03, follows_gusts=True) == settled_in_gust(-0.03)


def test_what_carries_more_than_the_thrust_may_be_a_pad_and_is_no_gust() -> None:
    assert settled_in_gust(0.3, follows_gusts=True) == settled_in_gust(0.3)


def test_what_may_be_the_surface_under_the_feet_is_no_thrust_and_what_presses_down_is_felt() -> None:
    stands = {"feet_near": True, "may_stand": True}
    assert settled_in_gust(0.3, **stands) == pytest.approx(0.5)
    assert settled_in_gust(-0.3, follows_gusts=True, **stands) == settled_in_gust(-0.3, follows_gusts=True)
    assert settled_in_gust(0.3, feet_near=True) == settled_in_gust(0.3)


def test_falling_freely_nothing_is_learnt_and_the_estimate_stays_one() -> None:
    estimate = HoverThrust(0.5, BANDWIDTH_RAD_S, TOLD_STD)
    for acceleration in (GRAVITY_M_S2, 5.0 * GRAVITY_M_S2):
        estimate.correct(acceleration, GRAVITY_M_S2, 1.0)
        assert estimate.value == pytest.approx(0.5)
    estimate.correct(5.0 * GRAVITY_M_S2, 0.0, 1.0)
    assert 0.5 < estimate.value < math.inf


def test_what_is_not_measured_or_contradicts_all_that_was_told_is_doubted_with_its_figures() -> None:
    estimate = HoverThrust(0.5, BANDWIDTH_RAD_S, TOLD_STD)
    assert "uncertain: 100 %, limit 10 %" in estimate.doubt({"vehicle": 0.5})
    fly(estimate, 0.65, 0.65, 2.0)
    assert estimate.doubt({"vehicle": 0.65 / MOST_SHARE + 0.02, "parameter": None}) == ""
    assert estimate.doubt({"vehicle": 0.2, "parameter": 0.65 / LEAST_SHARE - 0.02}) == ""
    words = estimate.doubt({"vehicle": 0.3, "parameter": 0.35})
    assert words.startswith("hover thrust: 0.65 measured, vehicle 0.30, parameter 0.35 configured;")
    assert estimate.doubt({"vehicle": 0.0})


@pytest.mark.parametrize(("true_share", "believed"), [(1.6, True), (0.5, True), (2.1, False), (0.38, False)])
def test_at_the_bounds_themselves_it_is_believed_however_the_air_errs(
    true_share: float, believed: bool
) -> None:
    found = []
    for air_g in (-0.06, 0.0, 0.06):  # a steady downdraught or updraught of what a mean wind makes
        estimate, true = HoverThrust(0.45, BANDWIDTH_RAD_S, TOLD_STD), 0.45 * true_share
        for _ in range(60):
            made_g = true * (1.0 - air_g) / estimate.value
            estimate.correct(0.0, GRAVITY_M_S2 * (1.0 - made_g), PERIOD_S)
        found.append(estimate.doubt({"vehicle": 0.45}) == "")
    assert found == [believed] * 3


def test_a_reported_thrust_counts_once_it_acts_and_not_over_a_gap() -> None:
    held = HeldThrust(0.05, 0.05)
    assert held.step(0.5, PERIOD_S) is None
    assert held.step(0.5, PERIOD_S) == pytest.approx(0.5)
    late = held.step(0.8, PERIOD_S)
    assert late is not None
    assert 0.5 < late < 0.62
    assert held.step(None, PERIOD_S) is None
    assert held.step(0.8, PERIOD_S) is None
    assert held.step(0.8, PERIOD_S) == pytest.approx(0.8)


# ----------------
# Identification: the numbers that were flown with come out, with deviations that mean something.

DELAY_S = 0.06
ASSUMED = IdentifiedResponse(2.2, 0.11)


def _flight(
    truth: IdentifiedResponse,
    seed: int,
    *,
    seconds: float = 25.0,
    excitation: float = 1.0,
    offset: float = 0.6,
) -> ResponseRecord:
    """Three axes that answer smoothed random commands, with wander, estimate noise and a late link.

    The velocity commanded is off the one flown by `offset` (m/s), which is what tells the gain.
    """
    rng, steps = np.random.default_rng(seed), round(seconds / PERIOD_S)
    late = DELAY_S / PERIOD_S
    smooth = np.exp(-0.5 * (np.arange(-20, 21) / 6.0) ** 2) / 6.0

    def wander(size: float) -> FloatArray:
        rows = [np.convolve(rng.normal(size=steps), smooth, "same") for _ in range(3)]
        return size * np.stack(rows, axis=1)

    feed, aside, push = wander(excitation), wander(excitation * offset), 0.2 * wander(1.0) + 0.4
    velocity, command = np.zeros((steps, 3)), np.zeros((steps, 3))
    for axis in range(3):
        p, v, a = 0.0, 0.0, 0.0
        for k in range(steps):
            velocity[k, axis], command[k, axis] = v, v + aside[k, axis]
            for piece in range(4):  # the command that is in effect by then
                at = k - late + piece / 4
                then = [np.interp(at, np.arange(k + 1), rows[: k + 1, axis]) for rows in (feed, command)]
                wanted = then[0] + (truth.gain_1_s * (then[1] - v)) + push[k, axis]
                p, v, a = advance_axis((p, v, a), wanted, PERIOD_S / 4, truth.lag_s)
    return ResponseRecord(
        time_s=PERIOD_S * np.arange(steps, dtype=np.float64),
        velocity_ned_m_s=velocity + rng.normal(0.0, 0.004, velocity.shape),
        force_m_s2=np.full(steps, GRAVITY_M_S2),
        command_velocity_ned_m_s=command,
        command_acceleration_ned_m_s2=feed,
        thrust=None,
        pieces=((20, steps // 2), (steps // 2 + 10, steps)),
    )


@pytest.mark.parametrize("truth", [IdentifiedResponse(1.4, 0.28), IdentifiedResponse(3.5, 0.15)])
def test_gain_and_lag_come_out_and_predict_a_flight_that_was_not_fitted(truth: IdentifiedResponse) -> None:
    fitted, held_out = (windows(_flight(truth, seed), (0, 1), DELAY_S) for seed in (1, 2))
    found = fit(fitted, ASSUMED)
    assert found.response.gain_1_s == pytest.approx(truth.gain_1_s, rel=0.1)
    assert found.response.lag_s == pytest.approx(truth.lag_s, rel=0.1)
    assert abs(found.response.gain_1_s - truth.gain_1_s) < 4.0 * found.gain_std_1_s
    assert abs(found.response.lag_s - truth.lag_s) < 4.0 * found.lag_std_s
    assert prediction_error_m_s(held_out, found.response) < 0.8 * prediction_error_m_s(held_out, ASSUMED)


def test_a_gain_that_nothing_asked_for_stays_and_the_lag_still_comes_out() -> None:
    truth = IdentifiedResponse(2.2, 0.25)
    found = fit(windows(_flight(truth, 3, offset=0.0), (0, 1), DELAY_S), ASSUMED)
    assert found.response.gain_1_s == ASSUMED.gain_1_s
    assert np.isinf(found.gain_std_1_s)
    assert found.response.lag_s == pytest.approx(0.25, rel=0.1)


def test_what_does_not_contradict_the_settings_changes_nothing() -> None:
    found = ResponseEstimate(IdentifiedResponse(3.0, 0.13), gain_std_1_s=0.3, lag_std_s=0.02, windows=20)
    assert found.adopted(ASSUMED) == IdentifiedResponse(3.0, ASSUMED.lag_s)


def test_by_attitude_there_is_no_gain() -> None:
    truth = IdentifiedResponse(0.0, 0.16)
    found = fit(windows(_flight(truth, 4, seconds=12.0), (0, 1), DELAY_S), IdentifiedResponse(0.0, 0.11))
    assert found.response.gain_1_s == 0.0
    assert found.response.lag_s == pytest.approx(0.16, rel=0.1)


def test_a_flight_in_which_nothing_moves_or_that_is_too_short_says_so() -> None:
    calm = _flight(ASSUMED, 5, excitation=0.004)
    with pytest.raises(TooLittleError, match="too little excitation: lag known"):
        fit(windows(calm, (2,), DELAY_S), ASSUMED)
    short = _flight(ASSUMED, 6, seconds=4.0)
    with pytest.raises(TooLittleError, match=r"3 windows of 1 s of flight by setpoints, expected 10"):
        windows(short, (0, 1), DELAY_S)


def _hovering(thrust: FloatArray | None, noise: float = 0.3, steps: int = 600) -> ResponseRecord:
    rng, still = np.random.default_rng(7), np.zeros((steps, 3))
    force = GRAVITY_M_S2 / 0.43 * (np.full(steps, 0.43) if thrust is None else thrust)
    force = force + rng.normal(0.0, noise, steps)
    return ResponseRecord(
        PERIOD_S * np.arange(steps, dtype=np.float64), still, force, still, still, thrust, ((0, steps),)
    )


def test_hover_thrust_is_what_carries_the_weight() -> None:
    thrust = 0.45 + 0.05 * np.sin(0.7 * PERIOD_S * np.arange(600))
    hover, std = hover_thrust(_hovering(thrust))
    assert hover == pytest.approx(0.43, rel=0.01)
    assert abs(hover - 0.43) < 4.0 * std


def test_without_thrust_or_with_one_that_does_not_fit_there_is_no_hover_thrust() -> None:
    with pytest.raises(TooLittleError, match="no thrust in the log"):
        hover_thrust(_hovering(None))
    with pytest.raises(TooLittleError, match="1 s of flight"):
        hover_thrust(_hovering(np.full(45, 0.43), steps=45))
    erratic = np.random.default_rng(8).uniform(0.2, 0.8, 20).repeat(30)
    flown = _hovering(None)
    with pytest.raises(TooLittleError, match="expected 2 %"):
        hover_thrust(
            ResponseRecord(
                flown.time_s,
                flown.velocity_ned_m_s,
                flown.force_m_s2,
                flown.command_velocity_ned_m_s,
                flown.command_acceleration_ned_m_s2,
                erratic,
                flown.pieces,
            )
        )
