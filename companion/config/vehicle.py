"""Settings of what sits on the vehicle: the camera and the airframe."""

from __future__ import annotations

import itertools
import math
from typing import Annotated, ClassVar, Final, Literal

from pydantic import Field, field_validator, model_validator

from companion.config.calibration import CameraCalibration
from companion.config.reading import StrictModel, Vector

# ---------------------------------------------------------------- how it answers
# Setpoints under an autopilot, as identified from flights of the real firmwares. Along each direction the
# autopilot wants u + K (v_sp - v) + I integral(v_sp - v), u and v_sp being the setpoint's acceleration and
# velocity; what it wants is flown after a dead time and at second order. By attitude setpoints K and I are 0
# and u is what attitude and thrust make. `make bench-response` finds them.

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
    """Initial factor on the response to a step; it settles to 1"""
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


# no lens sits farther off its image's middle, as a share of the image; half or double the size does that
OFF_CENTRE: Final = 0.2


MOST_GREYS: Final = 256  # of an image of 8 bits


class CaptureConfig(StrictModel):
    """How a camera takes pictures; all that is known of one before it is calibrated."""

    size_is: ClassVar[str] = "the size asked for,"

    name: str
    """Name of the camera"""
    width_px: int = Field(ge=160, le=8192)
    """Width of the image"""
    height_px: int = Field(ge=120, le=8192)
    """Height of the image"""
    rate_hz: float = Field(ge=5.0, le=240.0)
    """Frames per second"""
    exposure_s: float = Field(default=0.004, ge=0.00002, le=0.05)
    """Exposure time, short and fixed against motion blur: 1 to 2 ms in the sun, 8 ms at dusk"""
    readout_s: float = Field(default=0.0, ge=0.0, le=0.05)
    """Time from the first to the last row of a rolling shutter; 0: global shutter"""
    gain: float | None = Field(default=None, ge=0.0, le=100000.0)
    """Fixed gain: a factor (Raspberry Pi), or the driver's own number (V4L2); none: automatic or unchanged,
    for light that changes during a landing"""
    focus: float | None = Field(default=None, ge=0.0, le=100000.0)
    """Focus of a lens that moves: dioptres (Raspberry Pi), or the driver's own number (V4L2); none: only
    autofocus is switched off. Calibrate again after a change"""
    sensor_mode_px: tuple[int, int] | None = Field(default=None)
    """Raspberry Pi: width and height of the sensor mode from which images are scaled; none: libcamera's
    choice, which may crop the view"""
    pixel_format: str | None = Field(default=None, pattern=r"^[ -~]{4}$")
    """V4L2: format that the camera sends, such as MJPG, YUYV, GREY; none: OpenCV's choice. Set MJPG for large
    images on USB 2"""
    stamped_at: Literal["auto", "start_of_exposure", "start_of_readout", "end_of_readout"] = Field(
        default="auto"
    )
    """The moment of a frame that its driver stamps (docs/how-to/cameras.md); auto: by the driver. Prefer
    `calibrate-mount` to a guess"""


class CameraConfig(CaptureConfig):
    """A calibrated camera, as `calibrate-camera` writes it (eqs. 2 and 3)."""

    size_is: ClassVar[str] = "the calibration's"

    fx_px: float = Field(gt=50.0, lt=20000.0)
    """Focal length along the rows (eq. 2)"""
    fy_px: float = Field(gt=50.0, lt=20000.0)
    """Focal length along the columns"""
    cx_px: float = Field(gt=0.0, lt=8192.0)
    """Principal point, from the left"""
    cy_px: float = Field(gt=0.0, lt=8192.0)
    """Principal point, from the top"""
    projection: Literal["perspective", "fisheye"] = Field(default="perspective")
    """`perspective`: straight lines stay nearly straight; `fisheye`: the distance from the centre grows
    with the angle, for lenses beyond 120°"""
    distortion: tuple[float, ...]
    """Coefficients k1, k2, p1, p2, k3 (eq. 3), for the rational model also k4, k5, k6; for a fisheye k1, k2,
    k3, k4"""
    encoding: Literal["srgb", "linear"] | tuple[float, ...] = Field(default="srgb")
    """How the camera encodes light as grey values: srgb, linear, or a table: the light (0 to 1) of evenly
    spaced grey values. `calibrate-camera` measures it; a wrong one moves every edge by up to 0.3 px"""
    encoding_error: float = Field(default=0.02, ge=0.0, le=1.0)
    """Standard deviation of the exponent of this curve, as a share. `calibrate-camera` measures it; larger
    for a camera with automatic contrast"""
    calibration: CameraCalibration | None = None

    @model_validator(mode="after")
    def _of_a_known_model(self) -> CameraConfig:
        fisheye, count = self.projection == "fisheye", len(self.distortion)
        if fisheye and count != 4:
            raise ValueError(f"distortion: expected 4 numbers (k1 k2 k3 k4) of a fisheye, found {count}")
        if not fisheye and count not in {5, 8}:
            raise ValueError(
                f"distortion: expected 5 numbers (k1 k2 p1 p2 k3) or 8 (and k4 k5 k6), found {count}"
            )
        return self

    @field_validator("encoding")
    @classmethod
    def _rising(cls, encoding: str | tuple[float, ...]) -> str | tuple[float, ...]:
        if isinstance(encoding, str):
            return encoding
        steps = [b - a for a, b in itertools.pairwise(encoding)]
        ends = len(encoding) >= 2 and (encoding[0], encoding[-1]) == (0.0, 1.0)
        if not ends or len(encoding) > MOST_GREYS or min(steps) <= 0.0:
            raise ValueError(f"expected srgb, linear, or 2 to {MOST_GREYS} rising numbers from 0 to 1")
        return encoding

    @model_validator(mode="after")
    def _of_the_calibrated_size(self) -> CameraConfig:
        """A size that was edited by hand leaves a focal length of another: every height would be wrong."""
        pairs = (("cx_px", self.cx_px, self.width_px), ("cy_px", self.cy_px, self.height_px))
        for name, centre_px, size_px in pairs:
            if abs(centre_px - 0.5 * size_px) > OFF_CENTRE * size_px:
                raise ValueError(
                    f"{name} {centre_px:g}: expected near the middle of {size_px} px; "
                    "an image of another size needs a calibration of its own"
                )
        return self


Inertia = Annotated[float, Field(gt=1e-5, le=10.0)]


class ModelConfig(StrictModel):
    """The airframe in the paper's 12-state dynamics (eqs. 5 and 6), for controllers that command U1..U4.

    Rotors are counted clockwise seen from above, from the front one ("plus") or the front right one ("x");
    the first and the third turn anticlockwise.
    """

    layout: Literal["plus", "x"]
    """A rotor in front (`plus`) or a pair of rotors (`x`). The model is used by the paper's experiments
    only: measure it for a vehicle that you compare in them"""
    mass_kg: float = Field(gt=0.1, le=20.0)
    """Take-off mass"""
    inertia_kg_m2: tuple[Inertia, Inertia, Inertia]
    """Moments of inertia about the forward, right and down axes"""
    arm_length_m: float = Field(gt=0.03, le=1.0)
    """Distance from the centre of mass to a rotor's axis"""
    thrust_coefficient_n_s2: float = Field(gt=1e-8, le=1e-2)
    """B: thrust divided by the square of the rotor speed"""
    torque_coefficient_n_m_s2: float = Field(gt=1e-10, le=1e-3)
    """D: reaction torque divided by the square of the rotor speed"""
    rotor_inertia_kg_m2: float = Field(ge=0.0, le=0.01)
    """J_TP: moment of inertia of one rotor about its axis"""
    max_rotor_speed_rad_s: float = Field(gt=100.0, le=5000.0)
    """Rotor speed at full command"""
    motor_time_constant_s: float = Field(ge=0.001, le=0.5)
    """Lag from commanded to delivered thrust"""


class VehicleConfig(StrictModel):
    """Where things sit on the airframe (FRD from the centre of mass) and how it answers."""

    name: str
    """Name of the vehicle"""
    camera_position_body_m: Vector
    """Position of the camera from the centre of mass, FRD; measure it"""
    camera_yaw_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    """Rotation of the camera, clockwise seen from above; 0: the image's top edge points forward. `companion
    check --pad` finds an error of 90°"""
    camera_tilt_deg: float = Field(default=0.0, ge=-90.0, le=90.0)
    """Tilt of the camera; 0: it looks straight down, positive: forward"""
    camera_roll_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    """Rotation of the camera about the forward axis, before tilt and yaw; positive: it looks to the left"""
    camera_time_offset_s: float = Field(default=0.0, ge=-0.5, le=0.5)
    """Added to every frame's stamp: negative when late; `calibrate-mount` measures it"""
    range_position_body_m: Vector
    """Position of the rangefinder from the centre of mass, FRD; measure it"""
    imu_position_body_m: Vector = Field(default=(0.0, 0.0, 0.0))
    """Position from the centre of mass, FRD, of the IMU that the app uses; an error of up to 5 cm is learnt
    in the air; measure it if the IMU is farther from the centre"""
    radius_m: float = Field(default=0.4, gt=0.0, le=3.0)
    """Distance from the centre of mass to the farthest rotor's tip, for obstacles"""
    leg_height_m: float = Field(ge=0.02, le=1.0)
    """Height of the centre of mass over the feet; measure it, because it determines the height of the feet.
    Orders are refused if it differs by 5 cm from what rangefinder or pad measure before take-off"""
    foot_reach_m: float = Field(default=0.18, ge=0.0, le=2.0)
    """Horizontal distance from the centre to the farthest foot"""
    responses: Responses = Responses()
    # measured on this very vehicle: instead of what the responses say of the tilt and of the thrust
    acceleration_time_constant_s: float | None = Field(default=None, ge=0.02, le=1.0)
    """Lag from commanded to flown acceleration, horizontally: the vehicle tilts first. `companion identify`
    finds it"""
    thrust_time_constant_s: float | None = Field(default=None, ge=0.01, le=1.0)
    """Lag of the thrust alone, vertically"""
    hover_thrust: float = Field(ge=0.1, le=0.9)
    """Share of full thrust that carries the weight, 0..1; change it with the take-off mass"""
    model: ModelConfig | None = None  # For comparisons that command U1..U4; a flight needs none

    @property
    def camera_turn_rad(self) -> tuple[float, float, float]:
        """Roll, tilt and yaw (rad) of a camera that looks straight down, as Euler angles of its axes."""
        roll, tilt, yaw = self.camera_roll_deg, self.camera_tilt_deg, self.camera_yaw_deg
        return math.radians(roll), math.radians(tilt), math.radians(yaw)
