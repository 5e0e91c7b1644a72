"""Settings of the controller and of the last gate."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from companion.config.reading import StrictModel


class LimitsConfig(StrictModel):
    """The last gate: nothing beyond these leaves for the autopilot."""

    horizontal_speed_m_s: float = Field(default=6.0, gt=0.0, le=20.0)
    climb_speed_m_s: float = Field(default=1.5, gt=0.0, le=5.0)
    descent_speed_m_s: float = Field(default=1.5, gt=0.0, le=5.0)
    horizontal_acceleration_m_s2: float = Field(default=5.5, gt=0.0, le=10.0)
    vertical_acceleration_m_s2: float = Field(default=3.0, gt=0.0, le=8.0)
    tilt_deg: float = Field(default=30.0, gt=0.0, le=45.0)
    jerk_m_s3: float = Field(default=20.0, gt=0.0, le=200.0)
    heading_rate_deg_s: float = Field(default=90.0, gt=0.0, le=180.0)
    minimum_thrust: float = Field(default=0.05, ge=0.0, le=0.5)
    maximum_thrust: float = Field(default=0.9, gt=0.5, le=1.0)


class TrackingConfig(StrictModel):
    """The MPC's weights along one direction, each as the deviation that costs 1 (eq. 39)."""

    position_m: float = Field(gt=0.0, le=10.0)
    velocity_m_s: float = Field(gt=0.0, le=10.0)
    acceleration_m_s2: float = Field(gt=0.0, le=100.0)
    effort_m_s2: float = Field(gt=0.0, le=100.0)  # command off what the reference needs
    effort_change_m_s2: float = Field(gt=0.0, le=100.0)  # the same, from one step to the next


class PidGains(StrictModel):
    """Acceleration for each metre, metre per second and metre second of error along one direction."""

    position_gain_1_s2: float = Field(ge=0.0, le=30.0)
    velocity_gain_1_s: float = Field(ge=0.0, le=15.0)
    integral_gain_1_s3: float = Field(ge=0.0, le=40.0)
    integral_limit_m_s2: float = Field(default=3.0, ge=0.0, le=8.0)


class PidConfig(StrictModel):
    """The PID's gains; by `python -m experiments tune-flight-pid`."""

    horizontal: PidGains = PidGains(position_gain_1_s2=12.5, velocity_gain_1_s=5.63, integral_gain_1_s3=11.87)
    vertical: PidGains = PidGains(position_gain_1_s2=20.25, velocity_gain_1_s=13.99, integral_gain_1_s3=34.28)


class ControlConfig(StrictModel):
    """The tracker and what it sends."""

    controller: Literal["mpc", "riccati", "pid"] = "mpc"
    # acceleration: sideways without velocity, for PX4 alone; auto: that to PX4, attitude to ArduPilot
    setpoint: Literal["auto", "velocity", "acceleration", "attitude"] = "auto"
    rate_hz: float = Field(default=30.0, ge=10.0, le=100.0)
    horizon_steps: int = Field(default=20, ge=5, le=100)
    step_s: float = Field(default=0.1, ge=0.01, le=0.5)
    command_delay_s: float = Field(default=0.03, ge=0.0, le=0.2)  # from the decision to the autopilot's loop
    velocity_lookahead_s: float = Field(default=0.02, ge=0.0, le=0.5)  # beyond the delay
    # measured on this very vehicle, by velocity setpoints: instead of what its file says of the autopilot
    autopilot_velocity_gain_1_s: float | None = Field(default=None, ge=0.2, le=12.0)
    autopilot_climb_gain_1_s: float | None = Field(default=None, ge=0.2, le=12.0)
    autopilot_lag_s: float | None = Field(default=None, ge=0.01, le=1.5)
    autopilot_climb_lag_s: float | None = Field(default=None, ge=0.01, le=1.5)
    acceleration_estimate_lag_s: float = Field(default=0.035, ge=0.001, le=0.2)  # sensor and its filters
    maximum_disturbance_m_s2: float = Field(default=5.0, ge=0.0, le=8.0)
    maximum_velocity_correction_m_s: float = Field(default=0.6, ge=0.0, le=3.0)
    horizontal_reach_m: float = Field(
        default=1.65, gt=0.0, le=20.0
    )  # a reference farther off is drawn nearer
    vertical_reach_m: float = Field(default=0.7, gt=0.0, le=20.0)
    ground_descent_m_s: float = Field(default=1.0, ge=0.1, le=1.5)
    ground_acceleration_m_s2: float = Field(default=2.0, ge=0.0, le=3.0)
    maximum_iterations: int = Field(default=400, ge=50, le=10000)
    solve_limit_s: float = Field(default=0.01, gt=0.0, le=0.1)  # by the clock; past it the last plan goes on
    horizontal: TrackingConfig = TrackingConfig(
        position_m=0.145, velocity_m_s=0.4, acceleration_m_s2=4.0, effort_m_s2=1.0, effort_change_m_s2=4.0
    )
    vertical: TrackingConfig = TrackingConfig(
        position_m=0.12, velocity_m_s=0.4, acceleration_m_s2=4.0, effort_m_s2=1.2, effort_change_m_s2=4.0
    )
    pid: PidConfig = PidConfig()
    limits: LimitsConfig = LimitsConfig()
