"""How a vehicle under an autopilot answers setpoints, as identified from flights of the real firmwares.

Along each direction the autopilot wants u + K (v_sp - v) + I integral(v_sp - v), u and v_sp being the
setpoint's acceleration and velocity; what it wants is flown after a dead time and at second order. By
attitude setpoints K and I are 0 and u is what attitude and thrust make. `make bench-response` finds them.
"""

from typing import Final, Literal

from pydantic import Field

from companion.config.reading import StrictModel

Kind = Literal["velocity", "acceleration", "attitude"]


class AxisResponse(StrictModel):
    """Along one direction: from the setpoint as it leaves to the acceleration that is flown."""

    dead_time_s: float = Field(ge=0.0, le=0.5)
    """Time from sending a setpoint until the vehicle begins to respond. Change these for your own frame:
    `make bench-response` finds them"""
    frequency_rad_s: float = Field(gt=0.5, le=200.0)
    """Natural frequency of the second-order response"""
    damping: float = Field(gt=0.1, le=3.0)
    """Damping ratio of that response"""
    gain: float = Field(default=1.0, ge=0.5, le=2.0)
    """Factor on the response to a step at first; in the long run it is 1"""
    velocity_gain_1_s: float = Field(default=0.0, ge=0.0, le=10.0)
    """K: acceleration for each m/s of velocity error, 0 without a velocity loop. Set it with the autopilot's
    own gain (`MPC_XY_VEL_P_ACC`, `MPC_Z_VEL_P_ACC`)"""
    velocity_integral_1_s2: float = Field(default=0.0, ge=0.0, le=10.0)
    """I: acceleration for each metre of integrated velocity error (`MPC_XY_VEL_I_ACC`, `MPC_Z_VEL_I_ACC`)"""

    @property
    def delay_s(self) -> float:
        """How late slow commands are flown, dead time and all."""
        return self.dead_time_s + 2.0 * self.damping / self.frequency_rad_s


class KindResponse(StrictModel):
    """By one kind of setpoint; the limits are the autopilot's own: it flies no more than that."""

    sideways: AxisResponse
    down: AxisResponse
    acceleration_m_s2: float | None = Field(default=None, gt=0.0, le=20.0)
    """Largest horizontal acceleration by the autopilot's own limits; none: no such limit. Set it to the
    autopilot's parameter"""
    jerk_m_s3: float | None = Field(default=None, gt=0.0, le=200.0)
    """Largest horizontal jerk by the autopilot's own limits; none: no such limit"""


class AutopilotResponses(StrictModel):
    """Under one autopilot, by each kind of setpoint that it is sent."""

    attitude: KindResponse
    velocity: KindResponse
    acceleration: KindResponse | None = None

    def of(self, kind: Kind) -> KindResponse:
        """That by one kind; accelerations where they go with velocities are velocity setpoints."""
        found = self.velocity if kind == "velocity" else self.attitude
        return (self.acceleration or self.velocity) if kind == "acceleration" else found


def _axis(dead_time_s: float, frequency_rad_s: float, damping: float, **more: float) -> AxisResponse:
    return AxisResponse.model_validate(
        {"dead_time_s": dead_time_s, "frequency_rad_s": frequency_rad_s, "damping": damping, **more}
    )


# the x500's, for vehicles that have no numbers of their own: PX4 1.16.1 and ArduCopter 4.6-dev in lockstep,
# jumps of up to 1.2 m/s2 and 0.5 m/s. Velocity gains: MPC_XY_VEL_P_ACC and I_ACC, MPC_Z_VEL_P_ACC and I_ACC;
# ArduPilot's, as they come out of the shaping in front of its loops, with WPNAV_ACCEL and PSC_JERK_XY
_PX4_CLIMB: Final = _axis(0.025, 45.0, 1.0, velocity_gain_1_s=4.0, velocity_integral_1_s2=2.0)
PX4: Final = AutopilotResponses(
    attitude=KindResponse(sideways=_axis(0.038, 14.9, 0.71), down=_axis(0.012, 45.0, 1.0)),
    acceleration=KindResponse(sideways=_axis(0.046, 14.9, 0.71), down=_PX4_CLIMB),
    velocity=KindResponse(
        sideways=_axis(0.046, 14.9, 0.71, velocity_gain_1_s=1.8, velocity_integral_1_s2=0.4), down=_PX4_CLIMB
    ),
)
ARDUPILOT: Final = AutopilotResponses(
    attitude=KindResponse(sideways=_axis(0.042, 10.6, 0.65, gain=1.1), down=_axis(0.015, 45.0, 1.0)),
    velocity=KindResponse(
        sideways=_axis(0.17, 25.0, 1.0, velocity_gain_1_s=1.7, velocity_integral_1_s2=1.0),
        down=_axis(0.12, 10.0, 1.0, velocity_gain_1_s=1.7),
        acceleration_m_s2=2.5,
        jerk_m_s3=5.0,
    ),
)


class Responses(StrictModel):
    """Under each autopilot."""

    px4: AutopilotResponses = PX4
    ardupilot: AutopilotResponses = ARDUPILOT

    def of(self, autopilot_kind: Literal["px4", "ardupilot"], kind: Kind) -> KindResponse:
        """That under one autopilot by one kind of setpoint."""
        return (self.px4 if autopilot_kind == "px4" else self.ardupilot).of(kind)
