"""The simulator's truth: for scoring alone, never for the app."""

from __future__ import annotations

from dataclasses import dataclass

from companion.base.geometry import IDENTITY, ZERO3, Quaternion, Vector3


@dataclass(frozen=True, slots=True)
class Truth:
    """The simulator's world at time_s. Goes to the score and the plots, never to the app."""

    time_s: float
    vehicle_position_ned_m: Vector3
    vehicle_velocity_ned_m_s: Vector3
    vehicle_attitude: Quaternion
    pad_position_ned_m: Vector3
    pad_velocity_ned_m_s: Vector3
    pad_heading_rad: float
    wind_ned_m_s: Vector3 = ZERO3
    in_contact: bool = False
    rate_body_rad_s: Vector3 = ZERO3
    attitude_setpoint: Quaternion = IDENTITY
    pad_roll_rad: float = 0.0
    pad_pitch_rad: float = 0.0
    obstacle_clearance_m: float | None = None  # from the rotors' tips; None without obstacles
