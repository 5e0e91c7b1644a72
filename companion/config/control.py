"""Settings of the controller and of the last gate."""

from typing import Literal

from pydantic import Field

from companion.config.reading import OPERATOR, StrictModel


class LimitsConfig(StrictModel):
    """The last gate: nothing beyond these leaves for the autopilot."""

    horizontal_speed_m_s: float = Field(default=6.0, gt=0.0, le=20.0)
    """Greatest horizontal speed that is sent; raise it for faster pads; higher is worse: more room is needed
    to stop"""
    climb_speed_m_s: float = Field(default=1.5, gt=0.0, le=5.0)
    """Greatest climb rate that is sent. Higher is worse after an overshoot. Lower it for a heavy vehicle with
    little thrust to spare"""
    descent_speed_m_s: float = Field(default=1.5, gt=0.0, le=5.0)
    """Greatest descent rate that is sent. Higher is worse: a wrong height ends in a harder fall. Lower it for
    a vehicle that enters its own downwash"""
    horizontal_acceleration_m_s2: float = Field(default=5.5, gt=0.0, le=10.0)
    """Greatest horizontal acceleration that is sent. Higher is worse: the vehicle tilts more. Raise it in
    strong wind, which uses part of it"""
    vertical_acceleration_m_s2: float = Field(default=3.0, gt=0.0, le=8.0)
    """Greatest vertical acceleration that is commanded, in addition to what compensates a downward push;
    lower it for a vehicle with little thrust to spare"""
    tilt_deg: float = Field(default=30.0, gt=0.0, le=45.0)
    """Greatest tilt of the thrust axis from the vertical; set it below the autopilot's own limit
    (`MPC_TILTMAX_AIR`, `ANGLE_MAX`). With attitude setpoints it bounds the attitude. With acceleration
    setpoints, and for the acceleration of velocity setpoints, it bounds the horizontal part to g
    tan(tilt), and so the tilt at constant vertical speed only. What the autopilot's velocity loop adds
    is not bounded"""
    jerk_m_s3: float = Field(default=20.0, gt=0.0, le=200.0)
    """Greatest change of the acceleration. Higher is worse: a wrong plan acts sooner. Lower it for a large
    frame with a slow response"""
    heading_rate_deg_s: float = Field(default=90.0, gt=0.0, le=180.0)
    """Greatest turn rate; lower it for a vehicle that yaws slowly"""
    minimum_thrust: float = Field(default=0.05, ge=0.0, le=0.5)
    """Smallest thrust in attitude setpoints, 0..1, in the air only. Lower is worse: slow rotors cannot
    control the attitude. Raise it to the autopilot's own smallest thrust (`MPC_THR_MIN`, `MOT_SPIN_MIN`)"""
    maximum_thrust: float = Field(default=1.0, gt=0.5, le=1.0)
    """Greatest thrust in attitude setpoints, 0..1. The mixers of both autopilots give roll and pitch
    priority over it, and their own altitude hold uses the full thrust. Lower it to protect motors or
    battery"""


class TrackingConfig(StrictModel):
    """The MPC's weights along one direction, each as the deviation that costs 1 (eq. 39)."""

    position_m: float = Field(gt=0.0, le=10.0)
    """Position error that costs 1; lower it to track tighter, raise it for more margin
    (docs/explanation/margins.md)"""
    velocity_m_s: float = Field(gt=0.0, le=10.0)
    """Velocity error that costs 1; lower it for more damping, raise it if velocity noise shakes the vehicle
    or makes the motors surge (docs/explanation/margins.md)"""
    acceleration_m_s2: float = Field(gt=0.0, le=100.0)
    """Acceleration error that costs 1; lower it for smoother changes of tilt or thrust, at the price of
    lag"""
    effort_m_s2: float = Field(gt=0.0, le=100.0)
    """Deviation of the command from the acceleration of the reference that costs 1; raise it to use more tilt
    or thrust against an error, lower it for calmer flight"""
    effort_change_m_s2: float = Field(gt=0.0, le=100.0)
    """Change of this deviation from step to step that costs 1; lower it for smoother setpoints, raise it
    for quicker ones"""


class PidGains(StrictModel):
    """Acceleration for each metre, metre per second and metre second of error along one direction."""

    position_gain_1_s2: float = Field(ge=0.0, le=30.0)
    """With `controller: pid`: acceleration for a metre of error; tune it by `python -m experiments
    tune-flight-pid`"""
    velocity_gain_1_s: float = Field(ge=0.0, le=15.0)
    """Acceleration for a metre per second of error; tune it by `python -m experiments tune-flight-pid`"""
    integral_gain_1_s3: float = Field(ge=0.0, le=40.0)
    """Acceleration for a metre of error over a second; tune it by `python -m experiments tune-flight-pid`"""
    integral_limit_m_s2: float = Field(default=3.0, ge=0.0, le=8.0)
    """Greatest acceleration of the integral; raise it for stronger wind, or if the hover thrust is
    uncertain"""


class PidConfig(StrictModel):
    """The PID's gains; by `python -m experiments tune-flight-pid`."""

    horizontal: PidGains = PidGains(position_gain_1_s2=12.5, velocity_gain_1_s=5.63, integral_gain_1_s3=11.87)
    vertical: PidGains = PidGains(position_gain_1_s2=20.25, velocity_gain_1_s=13.99, integral_gain_1_s3=34.28)


class ControlConfig(StrictModel):
    """The tracker and what it sends."""

    output: Literal["setpoints", "landing_target"] = Field(default="setpoints", json_schema_extra=OPERATOR)
    """`setpoints`: the app flies the vehicle; `landing_target`: it only sends the pad as LANDING_TARGET,
    for the autopilot's own landing (docs/how-to/vision-only.md); set it if the autopilot is to land by
    itself"""
    target_lead_s: float = Field(default=0.0, ge=0.0, le=2.0)
    """With `output: landing_target`: the target is the pad's predicted position after this time, which
    compensates for the autopilot's lag; 0 sends it as seen. Set it for a pad that drives, as
    docs/how-to/vision-only.md says; too long is worse: the vehicle lands in front of the pad"""
    controller: Literal["mpc", "riccati", "pid"] = Field(default="mpc")
    """Tracker of the plan: the constrained MPC, the paper's recursion without constraints, or a PID; change
    it for comparison only"""
    # acceleration: sideways without velocity, for PX4 alone; auto: that to PX4, attitude to ArduPilot
    setpoint: Literal["auto", "velocity", "acceleration", "attitude"] = Field(default="auto")
    """Kind of setpoint: velocity with acceleration; acceleration with the vertical velocity alone (PX4;
    ArduPilot gets attitude then); attitude with thrust; `auto` is `acceleration` to PX4 and `attitude` to
    ArduPilot. With PX4, change it to `velocity` if the link's delay is not known within 50 ms"""
    rate_hz: float = Field(default=30.0, ge=10.0, le=100.0)
    """Rate of the loop that plans, controls and sends; lower it on a slow computer"""
    horizon_steps: int = Field(default=20, ge=5, le=100)
    """Steps of the horizon; lower it to save CPU"""
    step_s: float = Field(default=0.1, ge=0.01, le=0.5)
    """Length of a step; lengthen it with fewer steps, for the same horizon with less CPU"""
    command_delay_s: float = Field(default=0.03, ge=0.0, le=0.2)
    """Delay from the decision to the autopilot's loop; set it to your link's delay"""
    velocity_lookahead_s: float = Field(default=0.02, ge=0.0, le=0.5)
    """Velocity setpoints send the velocity predicted for this time after `command_delay_s`; raise it for an
    autopilot that follows velocities late"""
    # measured on this very vehicle, by velocity setpoints: instead of what its file says of the autopilot
    autopilot_velocity_gain_1_s: float | None = Field(default=None, ge=0.2, le=12.0)
    """The autopilot's own gain from velocity error to acceleration, horizontally; set it to what `companion
    identify` finds"""
    autopilot_climb_gain_1_s: float | None = Field(default=None, ge=0.2, le=12.0)
    """The autopilot's vertical velocity gain; set it from a recorded flight"""
    autopilot_lag_s: float | None = Field(default=None, ge=0.01, le=1.5)
    """Additional horizontal lag by the autopilot's shaping of velocity setpoints; set it to what `companion
    identify` finds"""
    autopilot_climb_lag_s: float | None = Field(default=None, ge=0.01, le=1.5)
    """Additional vertical lag by the autopilot's shaping of velocity setpoints; set it from a recorded
    flight"""
    acceleration_estimate_lag_s: float = Field(default=0.035, ge=0.001, le=0.2)
    """Lag of the acceleration estimate: sensor and its filters; change it with those filters"""
    maximum_disturbance_m_s2: float = Field(default=5.0, ge=0.0, le=8.0)
    """Greatest disturbance that the observer estimates; raise it for strong wind"""
    maximum_velocity_correction_m_s: float = Field(default=0.6, ge=0.0, le=3.0)
    """Greatest velocity offset that compensates a disturbance, with velocity setpoints; raise it for an
    autopilot with a larger velocity error"""
    horizontal_reach_m: float = Field(default=1.65, gt=0.0, le=20.0)
    """Largest horizontal distance of the reference; a farther one is moved to this distance. Lower it if a
    far reference makes the vehicle tilt too much"""
    vertical_reach_m: float = Field(default=0.7, gt=0.0, le=20.0)
    """Largest vertical distance of the reference; a farther one is moved to this distance. Lower it against
    hard drops"""
    ground_descent_m_s: float = Field(default=1.0, ge=0.1, le=1.5)
    """Descent rate commanded on the pad, so that the autopilot reduces its thrust; raise it if the
    autopilot does not detect its landing"""
    ground_acceleration_m_s2: float = Field(default=2.0, ge=0.0, le=3.0)
    """Downward acceleration commanded on the pad with `velocity` setpoints; raise it if the autopilot does
    not detect its landing"""
    maximum_iterations: int = Field(default=400, ge=50, le=10000)
    """Largest number of solver iterations; raise it only if solves fail"""
    solve_limit_s: float = Field(default=0.01, gt=0.0, le=0.1)
    """Longest solving time on the vehicle; after it the last plan is used. Lower it on a slow computer"""
    horizontal: TrackingConfig = TrackingConfig(
        position_m=0.145, velocity_m_s=0.4, acceleration_m_s2=4.0, effort_m_s2=1.0, effort_change_m_s2=4.0
    )
    vertical: TrackingConfig = TrackingConfig(
        position_m=0.11, velocity_m_s=0.15, acceleration_m_s2=4.0, effort_m_s2=2.0, effort_change_m_s2=4.0
    )
    pid: PidConfig = PidConfig()
    limits: LimitsConfig = LimitsConfig()
