"""What people get wrong when they build a vehicle: drawn by the seed, and given to the world alone.

The app's files, the autopilot's parameters and the scenario say what the builder believed. `draw` returns
what was built instead; who simulates a part takes its values from there, and nobody changes a setting of the
app. What the builder has tried out fits: the rate loops are tuned on the vehicle as it is.

SI units, FRD, NED; factors are 1 and all else is 0 where nobody erred.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Annotated, Any, Final

import numpy as np
from pydantic import Field, model_validator

from companion.base.geometry import GRAVITY_M_S2, ZERO3, Vector3, scale
from companion.config import StrictModel
from companion.pad import Pad
from sitl.faults.lines import LinkSettings
from sitl.vehicle.quadrotor import QuadrotorParameters

# random draws of what was built; world, sensors, simulation and faults draw from other streams
AS_BUILT_STREAM: Final = 23
# where people build vehicles
_LATITUDES_DEG: Final = 60.0
# a deck's magnetism at a metre's distance is an eighth of that on it, as a dipole's is
_DECK_REACH_M: Final = 1.0

Part = Annotated[float, Field(ge=0.0, le=0.9)]
Low = Annotated[float, Field(ge=0.3, le=1.0)]
High = Annotated[float, Field(ge=1.0, le=4.0)]


@dataclass(frozen=True, slots=True)
class BuiltVehicle:
    """What was built, against what its builder believed; the defaults are believed rightly.

    `hover_thrust` is the told over the true share of full thrust that carries the weight; `thrust_exponent`:
    thrust goes with the command to this power, where the autopilot is told that it is proportional.
    `place`: latitude, longitude (deg) where it flies instead; None where it was believed.
    """

    hover_thrust: float = 1.0
    thrust_exponent: float = 1.0
    mass: float = 1.0
    leg_height_m: float = 0.0
    imu_offset_body_m: Vector3 = ZERO3
    autopilot_imu_offset_body_m: Vector3 = ZERO3
    camera_mount_deg: Vector3 = ZERO3
    focal_length: float = 1.0
    pad_print: float = 1.0
    stamp_s: float = 0.0
    stamp_jitter_s: float = 0.0
    delay_to_app_s: float = 0.0
    delay_to_vehicle_s: float = 0.0
    vibration: float = 1.0
    place_deg: tuple[float, float] | None = None
    deck_field_ned_ut: Vector3 = ZERO3
    yaw_reset_deg: float = 0.0
    yaw_reset_s: float = 0.0

    def told(self) -> dict[str, float | list[float]]:
        """All values by name, as the result has them."""
        found: dict[str, float | list[float]] = {}
        for part in fields(self):
            value = getattr(self, part.name)
            if value is not None:
                found[part.name] = list(value) if isinstance(value, tuple) else value
        return found

    # ------------------------------------------------------------ the parts of the world

    def body(self, believed: QuadrotorParameters) -> QuadrotorParameters:
        """The airframe: its mass, and rotors whose thrust makes the true hover thrust of the told one."""
        if (self.mass, self.hover_thrust, self.thrust_exponent) == (1.0, 1.0, 1.0):
            return believed
        mass_kg = self.mass * believed.mass_kg
        x, y, z = scale(believed.inertia_kg_m2, self.mass)
        share = self._hover_command(believed) ** self.thrust_exponent
        return believed.model_copy(
            update={
                "mass_kg": mass_kg,
                "inertia_kg_m2": (x, y, z),
                "max_thrust_n": mass_kg * GRAVITY_M_S2 / believed.layout.count / share,
            }
        )

    def told_body(self, believed: QuadrotorParameters) -> QuadrotorParameters:
        """The airframe as the autopilot knows it: the told hover thrust, and the torque of its commands as
        the tuning of the rate loops has found it."""
        slope_n = believed.max_thrust_n / self.rate_scale(believed)
        mass_kg = believed.mass_kg * slope_n / believed.max_thrust_n
        if slope_n == believed.max_thrust_n:
            return believed
        return believed.model_copy(update={"max_thrust_n": slope_n, "mass_kg": mass_kg})

    def rate_scale(self, believed: QuadrotorParameters) -> float:
        """What the tuning multiplies the rate loops' gains by: the believed over the true slope of a
        rotor's thrust over its command, at hover."""
        if (self.mass, self.hover_thrust, self.thrust_exponent) == (1.0, 1.0, 1.0):
            return 1.0
        weight_n = self.mass * believed.mass_kg * GRAVITY_M_S2 / believed.layout.count
        slope_n = self.thrust_exponent * weight_n / self._hover_command(believed)
        return believed.max_thrust_n / slope_n

    def _hover_command(self, believed: QuadrotorParameters) -> float:
        return min(1.0, believed.hover_share() / self.hover_thrust)

    def pad(self, layout: Pad) -> Pad:
        k = self.pad_print
        if k == 1.0:
            return layout
        markers = tuple(
            marker.model_copy(
                update={
                    "side_m": k * marker.side_m,
                    "position_pad_m": (k * marker.position_pad_m[0], k * marker.position_pad_m[1]),
                    "quiet_zone_m": None if marker.quiet_zone_m is None else k * marker.quiet_zone_m,
                }
            )
            for marker in layout.markers
        )
        return layout.model_copy(
            update={"width_m": k * layout.width_m, "length_m": k * layout.length_m, "markers": markers}
        )

    def links(self, line: LinkSettings) -> tuple[LinkSettings, LinkSettings]:
        """The line's two ways: to the app, to the vehicle."""
        to_app, to_vehicle = (
            line.model_copy(update={"delay_s": line.delay_s + more_s}) if more_s else line
            for more_s in (self.delay_to_app_s, self.delay_to_vehicle_s)
        )
        return to_app, to_vehicle

    def home(self, believed: Vector3) -> Vector3:
        """Latitude (deg), longitude (deg), altitude (m) of the world's origin."""
        return believed if self.place_deg is None else (*self.place_deg, believed[2])

    def deck_field_at(self, distance_m: float) -> Vector3:
        """The deck's own field (µT, NED) so far from it."""
        return scale(self.deck_field_ned_ut, 1.0 / (1.0 + (distance_m / _DECK_REACH_M) ** 3))


AS_BELIEVED: Final = BuiltVehicle()


class AsBuiltSettings(StrictModel):
    """The largest error of each kind; each is drawn evenly up to it, by the seed. 0: nobody errs in it.

    `exactly` sets values by the names of `BuiltVehicle` instead of drawing them.
    """

    hover_thrust: Part = Field(
        default=0.35, description="Error of the hover thrust that app and autopilot assume, as a share"
    )
    thrust_exponent: tuple[Low, High] = Field(
        default=(0.6, 2.0), description="Exponent of thrust over command, from, to; the app assumes 1"
    )
    mass: Part = Field(default=0.2, description="Error of the mass, as a share")
    leg_height_m: float = Field(
        default=0.03, ge=0.0, le=0.08, description="Error of the leg height, longer or shorter"
    )
    imu_offset_m: float = Field(
        default=0.1, ge=0.0, le=0.5, description="Largest distance of both IMUs from the centre of mass"
    )
    camera_mount_deg: float = Field(
        default=2.0, ge=0.0, le=30.0, description="Error of the camera's mounting about each axis"
    )
    focal_length: Part = Field(default=0.015, description="Error of the focal length, as a share")
    pad_print: Part = Field(default=0.015, description="Error of the pad's printed size, as a share")
    stamp_s: float = Field(default=0.02, ge=0.0, le=0.1, description="Constant error of the frames' stamps")
    stamp_jitter_s: float = Field(
        default=0.005, ge=0.0, le=0.03, description="Largest random error of each stamp"
    )
    link_delay_s: float = Field(
        default=0.04, ge=0.0, le=0.5, description="Delay of the MAVLink link, in one direction"
    )
    vibration: float = Field(
        default=15.0,
        ge=1.0,
        le=50.0,
        description="Largest factor on the rotors' vibration; the smallest is 1",
    )
    other_place: bool = Field(
        default=True,
        description="The flight takes place elsewhere, within 60° of latitude: another magnetic field",
    )
    deck_field_ut: float = Field(
        default=30.0, ge=0.0, le=200.0, description="Magnetic field of a steel deck at both compasses"
    )
    yaw_reset_deg: float = Field(
        default=15.0, ge=0.0, le=180.0, description="Step of the bundled autopilot's heading, once"
    )
    exactly: dict[str, float | tuple[float, ...]] = Field(
        default_factory=dict, description="Errors by name that are set instead of drawn"
    )

    @model_validator(mode="after")
    def _named(self) -> AsBuiltSettings:
        names = {part.name: part for part in fields(BuiltVehicle)}
        for name, value in self.exactly.items():
            if name not in names:
                raise ValueError(f"exactly: '{name}': expected some of {', '.join(names)}")
            usual = getattr(AS_BELIEVED, name)
            length = 2 if usual is None else len(usual) if isinstance(usual, tuple) else 0
            if (len(value) if isinstance(value, tuple) else 0) != length:
                raise ValueError(
                    f"exactly: '{name}': expected {f'{length} numbers' if length else 'a number'}"
                )
        return self


# the section in which nobody errs but by what `exactly` says
NOTHING_ELSE: Final[dict[str, Any]] = {
    "hover_thrust": 0.0, "thrust_exponent": (1.0, 1.0), "mass": 0.0, "leg_height_m": 0.0, "imu_offset_m": 0.0,
    "camera_mount_deg": 0.0, "focal_length": 0.0, "pad_print": 0.0, "stamp_s": 0.0, "stamp_jitter_s": 0.0,
    "link_delay_s": 0.0, "vibration": 1.0, "other_place": False, "deck_field_ut": 0.0, "yaw_reset_deg": 0.0,
}  # fmt: skip


def draw(settings: AsBuiltSettings | None, seed: int) -> BuiltVehicle:
    """What was built under a seed; without settings all is as believed.

    Every draw is made whatever its size, so that another size of one leaves the others as they are.
    """
    if settings is None:
        return AS_BELIEVED
    s, rng = settings, np.random.default_rng((seed, AS_BUILT_STREAM))

    def even() -> float:
        return float(rng.uniform(-1.0, 1.0))

    def direction() -> Vector3:
        x, y, z = rng.standard_normal(3).tolist()
        length = math.sqrt(x * x + y * y + z * z)
        return (x / length, y / length, z / length)

    def offset(most: float) -> Vector3:
        return scale(direction(), most * float(rng.uniform()))

    low, high = s.thrust_exponent
    drawn: dict[str, Any] = {
        "hover_thrust": 1.0 + s.hover_thrust * even(),
        "thrust_exponent": math.exp(float(rng.uniform(math.log(low), math.log(high)))),
        "mass": 1.0 + s.mass * even(),
        "leg_height_m": s.leg_height_m * even(),
        "imu_offset_body_m": offset(s.imu_offset_m),
        "autopilot_imu_offset_body_m": offset(s.imu_offset_m),
        "camera_mount_deg": (
            s.camera_mount_deg * even(),
            s.camera_mount_deg * even(),
            s.camera_mount_deg * even(),
        ),
        "focal_length": 1.0 + s.focal_length * even(),
        "pad_print": 1.0 + s.pad_print * even(),
        "stamp_s": s.stamp_s * even(),
        "stamp_jitter_s": s.stamp_jitter_s,
    }
    late_s, to_app = s.link_delay_s * float(rng.uniform()), bool(rng.random() < 0.5)
    drawn["delay_to_app_s" if to_app else "delay_to_vehicle_s"] = late_s
    drawn["vibration"] = s.vibration ** float(rng.uniform())
    place_deg = (_LATITUDES_DEG * even(), 180.0 * even())
    drawn |= {
        "place_deg": place_deg if s.other_place else None,
        "deck_field_ned_ut": offset(s.deck_field_ut),
        "yaw_reset_deg": s.yaw_reset_deg * even(),
        # in the air, before the landing: a flight of the benches comes to the pad after about 20 s
        "yaw_reset_s": float(rng.uniform(12.0, 40.0)),
    }
    return BuiltVehicle(**{**drawn, **s.exactly})
