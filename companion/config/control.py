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
    """Greatest horizontal acceleration that is sent. Higher is worse: it tilts farther. Raise it in strong
    wind, which takes its part of it"""
    vertical_acceleration_m_s2: float = Field(default=3.0, gt=0.0, le=8.0)
    """Greatest vertical acceleration that is asked for, beside what a push downward takes; lower it for a
    vehicle with little thrust to spare"""
    tilt_deg: float = Field(default=30.0, gt=0.0, le=45.0)
    """Greatest tilt of the thrust axis from the vertical; set it below the autopilot's own limit
    (`MPC_TILTMAX_AIR`, `ANGLE_MAX`). Attitude setpoints: of the attitude. Acceleration setpoints, and the
    acceleration of velocity setpoints: the horizontal part is at most g tan(tilt), so that the tilt is bound
    at constant vertical speed only. What the autopilot's velocity loop adds is not bound"""
    jerk_m_s3: float = Field(default=20.0, gt=0.0, le=200.0)
    """Greatest change of the acceleration. Higher is worse: a wrong plan acts sooner. Lower it for a large
    frame that answers slowly"""
    heading_rate_deg_s: float = Field(default=90.0, gt=0.0, le=180.0)
    """Greatest turn rate; lower it for a vehicle that yaws slowly"""
    minimum_thrust: float = Field(default=0.05, ge=0.0, le=0.5)
    """Least thrust in attitude setpoints, 0..1; it holds in the air only. Lower is worse: rotors that hardly
    turn hold no attitude. Raise it to the autopilot's own least thrust (`MPC_THR_MIN`, `MOT_SPIN_MIN`)"""
    maximum_thrust: float = Field(default=1.0, gt=0.5, le=1.0)
    """Greatest thrust in attitude setpoints, 0..1. What roll and pitch need goes before it in the mixers of
    both autopilots, whose own altitude hold uses all of it. Lower it for a motor or battery that must be
    spared"""


class TrackingConfig(StrictModel):
    """The MPC's weights along one direction, each as the deviation that costs 1 (eq. 39)."""

    position_m: float = Field(gt=0.0, le=10.0)
    """Position error that costs 1; lower it to track tighter, raise it for more margin
    (docs/explanation/margins.md)"""
    velocity_m_s: float = Field(gt=0.0, le=10.0)
    """Velocity error that costs 1; lower it for more damping, raise it where velocity noise shakes the
    vehicle or makes the motors surge (docs/explanation/margins.md)"""
    acceleration_m_s2: float = Field(gt=0.0, le=100.0)
    """Acceleration error that costs 1; lower it for smoother changes of tilt or thrust, at the price of
    lag"""
    effort_m_s2: float = Field(gt=0.0, le=100.0)
    """Deviation of the command from what the reference needs that costs 1; raise it to use more tilt or
    thrust against an error, lower it for calmer flight"""
    effort_change_m_s2: float = Field(gt=0.0, le=100.0)
    """Change of that deviation, from step to step, that costs 1; lower it for smoother setpoints, raise it
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
    """Greatest acceleration of the integral; raise it for stronger wind, or where the hover thrust is known
    badly"""


class PidConfig(StrictModel):
    """The PID's gains; by `python -m experiments tune-flight-pid`."""

    horizontal: PidGains = PidGains(position_gain_1_s2=12.5, velocity_gain_1_s=5.63, integral_gain_1_s3=11.87)
    vertical: PidGains = PidGains(position_gain_1_s2=20.25, velocity_gain_1_s=13.99, integral_gain_1_s3=34.28)


class ControlConfig(StrictModel):
    """The tracker and what it sends."""

    output: Literal["setpoints", "landing_target"] = Field(default="setpoints", json_schema_extra=OPERATOR)
    """`setpoints` fly the vehicle; `landing_target` flies nothing: it sends the pad as LANDING_TARGET, to
    the autopilot's own landing (docs/how-to/vision-only.md); set it where the autopilot is to land by
    itself"""
    target_lead_s: float = Field(default=0.0, ge=0.0, le=2.0)
    """With `output: landing_target`: the target is where the pad will be so much later, since the autopilot
    follows late; 0 sends it as seen. Set it for a pad that drives, as docs/how-to/vision-only.md says; too
    long is worse: the vehicle lands ahead of the pad"""
    controller: Literal["mpc", "riccati", "pid"] = Field(default="mpc")
    """Tracker of the plan: the constrained MPC, the paper's recursion without constraints, or a PID; change
    it for comparison only"""
    # acceleration: sideways without velocity, for PX4 alone; auto: that to PX4, attitude to ArduPilot
    setpoint: Literal["auto", "velocity", "acceleration", "attitude"] = Field(default="auto")
    """Kind of setpoint: velocity with acceleration; acceleration with the vertical velocity alone (PX4;
    ArduPilot gets attitude then); attitude with thrust; `auto` is `acceleration` to PX4 and `attitude` to
    ArduPilot. With PX4, change it to `velocity` where the link's delay is not known within 50 ms"""
    rate_hz: float = Field(default=30.0, ge=10.0, le=100.0)
    """Rate of the loop that plans, controls and sends; lower it on a slow computer"""
    horizon_steps: int = Field(default=20, ge=5, le=100)
    """Steps of the horizon; lower it to save CPU"""
    step_s: float = Field(default=0.1, ge=0.01, le=0.5)
    """Length of a step; lengthen it with fewer steps, to look as far ahead with less CPU"""
    command_delay_s: float = Field(default=0.03, ge=0.0, le=0.2)
    """Delay from the decision to the autopilot's loop; set it to your link's delay"""
    velocity_lookahead_s: float = Field(default=0.02, ge=0.0, le=0.5)
    """Beyond `command_delay_s`, the moment whose predicted velocity is sent by velocity setpoints; raise it
    for an autopilot that follows velocities late"""
    # measured on this very vehicle, by velocity setpoints: instead of what its file says of the autopilot
    autopilot_velocity_gain_1_s: float | None = Field(default=None, ge=0.2, le=12.0)
    """The autopilot's own gain from velocity error to acceleration, horizontally; set it to what `companion
    identify` finds"""
    autopilot_climb_gain_1_s: float | None = Field(default=None, ge=0.2, le=12.0)
    """The autopilot's vertical velocity gain; set it from a recorded flight"""
    autopilot_lag_s: float | None = Field(default=None, ge=0.01, le=1.5)
    """What the autopilot's shaping of velocity setpoints adds to the vehicle's lag, horizontally; set it to
    what `companion identify` finds"""
    autopilot_climb_lag_s: float | None = Field(default=None, ge=0.01, le=1.5)
    """What its shaping of velocity adds to the lag, vertically; set it from a recorded flight"""
    acceleration_estimate_lag_s: float = Field(default=0.035, ge=0.001, le=0.2)
    """Lag of the acceleration estimate: sensor and its filters; change it with those filters"""
    maximum_disturbance_m_s2: float = Field(default=5.0, ge=0.0, le=8.0)
    """Greatest disturbance that the observer estimates; raise it for strong wind"""
    maximum_velocity_correction_m_s: float = Field(default=0.6, ge=0.0, le=3.0)
    """Greatest velocity offset that compensates it, by velocity setpoints; raise it for an autopilot whose
    velocity is off by more"""
    horizontal_reach_m: float = Field(default=1.65, gt=0.0, le=20.0)
    """A reference farther off is drawn nearer; lower it where a far reference makes the vehicle tilt too
    far"""
    vertical_reach_m: float = Field(default=0.7, gt=0.0, le=20.0)
    """A reference farther above or below is drawn nearer; lower it against hard drops"""
    ground_descent_m_s: float = Field(default=1.0, ge=0.1, le=1.5)
    """On the pad: descent commanded, so that the autopilot reduces its thrust; raise it where the autopilot
    does not detect its landing"""
    ground_acceleration_m_s2: float = Field(default=2.0, ge=0.0, le=3.0)
    """On the pad: downward acceleration commanded; raise it where the autopilot does not detect its
    landing"""
    maximum_iterations: int = Field(default=400, ge=50, le=10000)
    """Largest number of solver iterations; raise it only if solves fail"""
    solve_limit_s: float = Field(default=0.01, gt=0.0, le=0.1)
    """Longest solve by the clock on the vehicle; beyond it the last plan is used. Lower it on a slow
    computer"""
    horizontal: TrackingConfig = TrackingConfig(
        position_m=0.145, velocity_m_s=0.4, acceleration_m_s2=4.0, effort_m_s2=1.0, effort_change_m_s2=4.0
    )
    vertical: TrackingConfig = TrackingConfig(
        position_m=0.11, velocity_m_s=0.15, acceleration_m_s2=4.0, effort_m_s2=2.0, effort_change_m_s2=4.0
    )
    pid: PidConfig = PidConfig()
    limits: LimitsConfig = LimitsConfig()
