"""Settings of what sits on the vehicle: the camera and the airframe."""

from __future__ import annotations

import itertools
from typing import Annotated, ClassVar, Final, Literal

from pydantic import Field, field_validator, model_validator

from companion.config.calibration import CameraCalibration
from companion.config.reading import StrictModel, Vector
from companion.config.response import Responses

# no lens sits farther off its image's middle, as a share of the image; half or double the size does that
OFF_CENTRE: Final = 0.2


MOST_GREYS: Final = 256  # of an image of 8 bits


class CaptureConfig(StrictModel):
    """How a camera takes pictures; all that is known of one before it is calibrated.

    `gain` and `focus` are a factor and dioptres with a Raspberry Pi's camera, the driver's own numbers with
    V4L2; none: gain is left to the camera, and of the focus only the automatic is switched off.
    `sensor_mode_px` is the size of the Raspberry Pi sensor's mode that images are scaled from, `pixel_format`
    the four letters of what a V4L2 camera sends, `stamped_at` the moment of a frame that its driver stamps.
    """

    size_is: ClassVar[str] = "the size asked for,"

    name: str
    width_px: int = Field(ge=160, le=8192)
    height_px: int = Field(ge=120, le=8192)
    rate_hz: float = Field(ge=5.0, le=240.0)
    exposure_s: float = Field(default=0.004, ge=0.00002, le=0.05)  # short and fixed: see what moves sharply
    readout_s: float = Field(
        default=0.0, ge=0.0, le=0.05
    )  # first to last row of a rolling shutter; 0: global
    gain: float | None = Field(default=None, ge=0.0, le=100000.0)
    focus: float | None = Field(default=None, ge=0.0, le=100000.0)
    sensor_mode_px: tuple[int, int] | None = None
    pixel_format: str | None = Field(default=None, pattern=r"^[ -~]{4}$")
    stamped_at: Literal["auto", "start_of_exposure", "start_of_readout", "end_of_readout"] = "auto"


class CameraConfig(CaptureConfig):
    """A calibrated camera, as `calibrate-camera` writes it (eqs. 2 and 3).

    `distortion` has OpenCV's order: k1 k2 p1 p2 k3, and for the rational model k4 k5 k6 after them.
    `encoding` is how it makes grey values of light: sRGB's curve, in proportion (linear), or the light of
    evenly spaced grey values, from 0 (black) to 1 (full).
    """

    size_is: ClassVar[str] = "the calibration's"

    fx_px: float = Field(gt=50.0, lt=20000.0)
    fy_px: float = Field(gt=50.0, lt=20000.0)
    cx_px: float = Field(gt=0.0, lt=8192.0)
    cy_px: float = Field(gt=0.0, lt=8192.0)
    distortion: tuple[float, ...]
    encoding: Literal["srgb", "linear"] | tuple[float, ...] = "srgb"
    encoding_error: float = Field(
        default=0.02, ge=0.0, le=1.0
    )  # of it: light^(1 + error) in its place, one standard deviation
    calibration: CameraCalibration | None = None

    @field_validator("distortion")
    @classmethod
    def _of_a_known_model(cls, numbers: tuple[float, ...]) -> tuple[float, ...]:
        if len(numbers) not in {5, 8}:
            raise ValueError(f"expected 5 numbers (k1 k2 p1 p2 k3) or 8 (and k4 k5 k6), found {len(numbers)}")
        return numbers

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

    layout: Literal["plus", "x"]  # a rotor in front, or a pair
    mass_kg: float = Field(gt=0.1, le=20.0)  # take-off mass
    inertia_kg_m2: tuple[Inertia, Inertia, Inertia]  # about forward, right and down
    arm_length_m: float = Field(gt=0.03, le=1.0)  # from the centre of mass to a rotor's axis
    thrust_coefficient_n_s2: float = Field(gt=1e-8, le=1e-2)  # b: thrust over the rotor speed's square
    torque_coefficient_n_m_s2: float = Field(gt=1e-10, le=1e-3)  # d: reaction torque over the same
    rotor_inertia_kg_m2: float = Field(ge=0.0, le=0.01)  # J_TP: of one rotor about its axis
    max_rotor_speed_rad_s: float = Field(gt=100.0, le=5000.0)  # at full command
    motor_time_constant_s: float = Field(ge=0.001, le=0.5)  # from commanded to flown thrust


class VehicleConfig(StrictModel):
    """Where things sit on the airframe (FRD from the centre of mass) and how it answers."""

    name: str
    camera_position_body_m: Vector
    camera_yaw_deg: float = Field(default=0.0, ge=-180.0, le=180.0)
    camera_tilt_deg: float = Field(default=0.0, ge=-90.0, le=90.0)
    camera_roll_deg: float = Field(
        default=0.0, ge=-180.0, le=180.0
    )  # about forward, before tilt and yaw; positive: it looks to the left
    camera_time_offset_s: float = Field(
        default=0.0, ge=-0.5, le=0.5
    )  # added to every frame's stamp: negative when stamps are late
    range_position_body_m: Vector
    imu_position_body_m: Vector = (0.0, 0.0, 0.0)
    radius_m: float = Field(default=0.4, gt=0.0, le=3.0)  # to the farthest rotor's tip, for obstacles
    leg_height_m: float = Field(ge=0.02, le=1.0)
    foot_reach_m: float = Field(default=0.18, ge=0.0, le=2.0)  # aside of the middle, to the farthest foot
    responses: Responses = Responses()
    # measured on this very vehicle: instead of what the responses say of the tilt and of the thrust
    acceleration_time_constant_s: float | None = Field(default=None, ge=0.02, le=1.0)
    thrust_time_constant_s: float | None = Field(default=None, ge=0.01, le=1.0)
    hover_thrust: float = Field(ge=0.1, le=0.9)
    model: ModelConfig | None = None  # For comparisons that command U1..U4; a flight needs none
