"""Somebody else's vehicle on the table: its messages, made by hand, and a player that sends them in time."""

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from companion.base.geometry import Quaternion, Vector3, geodetic_from_ned
from sitl.external.pose import Sample

GROUND = (47.0, 8.0, 400.0)
ARDUPILOT, PX4 = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_AUTOPILOT_PX4
LEVEL: Quaternion = (1.0, 0.0, 0.0, 0.0)


class MessageSender:
    """Packs messages as one component of one system."""

    def __init__(self, system: int = 1, component: int = 1) -> None:
        self.mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)

    def pack(self, *messages: Any) -> bytes:
        data = b""
        for message in messages:
            data += bytes(message.pack(self.mav))
            self.mav.seq = (self.mav.seq + 1) % 256
        return data


def heartbeat(autopilot: int, *, armed: bool = False) -> Any:
    mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, autopilot, mode, 0, 3, 3)


def sim_state(
    position: Vector3, velocity: Vector3 = (0.0, 0.0, 0.0), attitude: Quaternion = LEVEL, **changes: Any
) -> Any:
    """ArduPilot's, of a place NED from GROUND."""
    latitude, longitude, altitude = geodetic_from_ned(position, GROUND)
    fields = {
        "q1": attitude[0], "q2": attitude[1], "q3": attitude[2], "q4": attitude[3],
        "roll": 0.0, "pitch": 0.0, "yaw": 0.0, "xacc": 0.0, "yacc": 0.0, "zacc": -9.8,
        "xgyro": 0.0, "ygyro": 0.0, "zgyro": 0.0,
        "lat": latitude * 1e7, "lon": longitude * 1e7, "alt": altitude,
        "std_dev_horz": 0.0, "std_dev_vert": 0.0, "vn": velocity[0], "ve": velocity[1], "vd": velocity[2],
        "lat_int": int(latitude * 1e7), "lon_int": int(longitude * 1e7),
    }  # fmt: skip
    return mavlink.MAVLink_sim_state_message(**{**fields, **changes})


def hil_state(
    position: Vector3, velocity: Vector3 = (0.0, 0.0, 0.0), attitude: Quaternion = LEVEL, time_usec: int = 0
) -> Any:
    """PX4's, of a place NED from GROUND; it leaves the stamp 0."""
    latitude, longitude, altitude = geodetic_from_ned(position, GROUND)
    vx, vy, vz = (int(100.0 * v) for v in velocity)
    return mavlink.MAVLink_hil_state_quaternion_message(
        time_usec, list(attitude), 0.0, 0.0, 0.0,
        int(latitude * 1e7), int(longitude * 1e7), int(altitude * 1e3), vx, vy, vz, 0, 0, 0, 0, 0,
    )  # fmt: skip


def sample(time_s: float, position: Vector3, velocity: Vector3 = (0.0, 0.0, 0.0)) -> Sample:
    """An exact one, of a level vehicle at a place NED from GROUND."""
    return Sample(time_s, geodetic_from_ned(position, GROUND), velocity, LEVEL, (0.0, 0.0, 0.0))


Flight = Callable[[float], tuple[Vector3, Vector3]]


def hop(north_m: float, east_m: float, top_m: float = 3.0, sink_m_s: float = 0.3) -> tuple[Flight, float]:
    """Position and velocity over time of a vehicle: up at 2 m/s, over a place, down to the ground, and still.

    Straight lines, so the speeds are exact. Returns the flight and when it touches the ground (s); NED from
    where it stands.
    """
    distance = math.hypot(north_m, east_m)
    up_s, over_s = top_m / 2.0, distance / 2.0
    down_s = up_s + over_s
    contact_s = down_s + top_m / sink_m_s

    def at(time_s: float) -> tuple[Vector3, Vector3]:
        if time_s < up_s:
            return (0.0, 0.0, -2.0 * time_s), (0.0, 0.0, -2.0)
        if time_s < down_s:
            share = (time_s - up_s) / over_s
            speed = (2.0 * north_m / distance, 2.0 * east_m / distance, 0.0)
            return (share * north_m, share * east_m, -top_m), speed
        if time_s < contact_s:
            return (north_m, east_m, -top_m + sink_m_s * (time_s - down_s)), (0.0, 0.0, sink_m_s)
        return (north_m, east_m, 0.0), (0.0, 0.0, 0.0)

    return at, contact_s
