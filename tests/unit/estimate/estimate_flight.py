"""A flight for the estimators' tests: a smooth path, and what noisy, late sensors would have said of it.

Independent of the simulator: attitude follows from the path's acceleration (thrust along the body's axis,
no drag) and rates from differences of attitude. NED and FRD, SI units, µT.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from companion.base.geometry import (
    GRAVITY_M_S2,
    Quaternion,
    Vector3,
    add,
    cross,
    geodetic_from_ned,
    norm,
    quat_conjugate,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_multiply,
    quat_normalise,
    quat_rotate,
    quat_rotate_inverse,
    rotation_vector_from_quat,
    scale,
    subtract,
    vector3,
)
from companion.base.messages import (
    GpsFix,
    ImuSample,
    MagSample,
    PadSighting,
    PadState,
    RangeSample,
    VehicleState,
)
from companion.config import EstimateConfig, VehicleConfig
from companion.estimate.estimator import StateEstimator

HOME = (47.0, 8.0, 400.0)
FIELD_NED_UT = (20.9, 0.6, 42.9)
VEHICLE = VehicleConfig(
    name="test",
    camera_position_body_m=(0.03, 0.0, 0.08),
    range_position_body_m=(-0.03, 0.0, 0.08),
    leg_height_m=0.18,
    acceleration_time_constant_s=0.18,
    hover_thrust=0.5,
)
ANTENNA = (0.1, 0.05, -0.05)
NEO_6M_SPEED_NOISE_M_S = 0.085  # an axis: its data sheet has 0.1 m/s as the median of the horizontal error

Path = Callable[[float], Vector3]
Sample = ImuSample | MagSample | GpsFix | RangeSample | PadSighting


def smooth(t: float, start_s: float, end_s: float) -> float:
    """From 0 to 1 with zero velocity and acceleration at both ends."""
    x = min(max((t - start_s) / (end_s - start_s), 0.0), 1.0)
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


def circle(radius_m: float, speed_m_s: float, height_m: float = 7.0) -> Path:
    """At rest for 5 s, a climb until 10 s, then a circle whose radius grows until 16 s."""

    def path(t: float) -> Vector3:
        angle, r = speed_m_s / radius_m * (t - 10.0), radius_m * smooth(t, 10.0, 16.0)
        return (r * math.sin(angle), r * math.cos(angle), -height_m * smooth(t, 5.0, 10.0))

    return path


def hover(t: float) -> Vector3:
    """At rest for 5 s, then 7 m up."""
    return (0.0, 0.0, -7.0 * smooth(t, 5.0, 10.0))


def sprint(t: float) -> Vector3:
    """Back and forth with 2.2 m/s² and 3.5 m/s at most, along a diagonal."""
    s = 5.5 * smooth(t, 10.0, 16.0) * math.sin(0.63 * (t - 10.0))
    return (0.7 * s, 0.7 * s, -7.0 * smooth(t, 5.0, 10.0))


def gusts(t: float) -> Vector3:
    """At 13 m, tilted to and fro by 20 deg, about an axis that turns."""
    away = 0.25 * smooth(t, 10.0, 16.0) * math.sin(3.8 * t)
    return (away * math.cos(1.4 * t), away * math.sin(1.4 * t), -13.0 * smooth(t, 5.0, 10.0))


def pad_at_rest(t: float) -> Vector3:
    return (1.0, -0.5, 0.0)


def pad_figure_8(t: float) -> Vector3:
    """Lemniscate: 2 m/s and 1.1 m/s² at most."""
    w = 0.5
    return (3.0 * math.sin(w * t), 1.3 * math.sin(2 * w * t), 0.0)


def pad_circle(t: float) -> Vector3:
    """5 m at 1.5 m/s."""
    return (5.0 * math.cos(0.3 * t), 5.0 * math.sin(0.3 * t), 0.0)


def pad_heave(t: float) -> Vector3:
    """0.25 m up and down in 6 s, drifting north at 0.5 m/s."""
    return (0.5 * (t - 10.0), 0.0, 0.25 * math.sin(math.tau * t / 6.0))


def velocity(path: Path, t: float) -> Vector3:
    """First derivative by central differences."""
    h = 1e-3
    return scale(subtract(path(t + h), path(t - h)), 0.5 / h)


def acceleration(path: Path, t: float) -> Vector3:
    """Second derivative by central differences."""
    h = 1e-3
    return scale(subtract(add(path(t + h), path(t - h)), scale(path(t), 2.0)), 1.0 / (h * h))


def slow_turns(t: float) -> float:
    """Heading: north until take-off, then a quarter and back in 20 s."""
    return 1.0 * smooth(t, 5.0, 10.0) + 0.8 * smooth(t, 10.0, 16.0) * math.sin(0.3 * (t - 10.0))


@dataclass(frozen=True)
class EstimateFlight:
    """A path with a seed for the noise, and switches for what goes wrong."""

    path: Path = hover
    pad_path: Path = pad_at_rest
    heading: Callable[[float], float] = slow_turns
    seed: int = 1
    duration_s: float = 40.0
    gyro_bias_rad_s: Vector3 = (0.0087, -0.0087, 0.006)
    accel_bias_m_s2: Vector3 = (0.06, -0.06, 0.05)
    mag_bias_ut: Vector3 = (0.2, -0.2, 0.3)
    vibration_m_s2: float = 0.5  # white: what rotors leave below 10 Hz, some 0.03 m/s² per root of hertz
    gps_lost_s: tuple[float, float] = (1e9, 1e9)
    gps_delay_s: tuple[float, float] = (0.12, 0.25)
    pad_hidden_s: tuple[float, float] = (1e9, 1e9)
    sighting_delay_s: float = 0.08
    stamp_jitter_s: float = 0.0  # of the sightings' times, standard deviation
    sensors: frozenset[str] = field(default=frozenset({"imu", "mag", "gps", "range", "sighting"}))

    # ------------------------------------------------------------ truth

    def attitude(self, t: float) -> Quaternion:
        """Turned to the heading, then the shortest way until the thrust balances gravity and acceleration."""
        down = subtract((0.0, 0.0, GRAVITY_M_S2), acceleration(self.path, t))
        x, y, z = scale(down, 1.0 / norm(down))
        tilt = quat_normalise((1.0 + z, -y, x, 0.0))
        return quat_multiply(tilt, quat_from_euler(0.0, 0.0, self.heading(t)))

    def rate(self, t: float) -> Vector3:
        """Body rate by differences of attitude."""
        h = 1e-3
        turn = quat_multiply(quat_conjugate(self.attitude(t - h)), self.attitude(t + h))
        return vector3([value / (2 * h) for value in rotation_vector_from_quat(turn)])

    def pad_heading(self, t: float) -> float:
        """The pad turns at a steady 0.1 rad/s."""
        return 0.3 + 0.1 * t

    # ------------------------------------------------------------ sensors

    @cached_property
    def samples(self) -> list[tuple[float, Sample]]:
        """(arrival time, sample), in order of arrival."""
        rng = np.random.default_rng(self.seed)
        made: list[tuple[float, Sample]] = []
        makers = {
            "imu": (200.0, self._imu),
            "mag": (50.0, self._mag),
            "gps": (5.0, self._gps),
            "range": (15.0, self._range),
            "sighting": (30.0, self._sighting),
        }
        for name, (rate_hz, make) in makers.items():
            stream = rng.spawn(1)[0]
            for k in range(1, int(self.duration_s * rate_hz)) if name in self.sensors else ():
                made += make(k / rate_hz, stream)
        return sorted(made, key=lambda item: item[0])

    def _imu(self, t: float, rng: np.random.Generator) -> list[tuple[float, Sample]]:
        q = self.attitude(t)
        an, ae, ad = acceleration(self.path, t)
        flying = t > 4.5
        gyro = np.array(self.rate(t)) + self.gyro_bias_rad_s + 0.003 * rng.normal(size=3)
        force = np.array(quat_rotate_inverse(q, (an, ae, ad - GRAVITY_M_S2))) + self.accel_bias_m_s2
        force += (self.vibration_m_s2 if flying else 0.03) * rng.normal(size=3)
        return [(t, ImuSample(t, vector3(gyro), vector3(force), 35.0))]

    def _mag(self, t: float, rng: np.random.Generator) -> list[tuple[float, Sample]]:
        field_ut = np.array(quat_rotate_inverse(self.attitude(t), FIELD_NED_UT)) + self.mag_bias_ut
        return [(t + 0.001, MagSample(t, vector3(field_ut + 0.6 * rng.normal(size=3))))]

    def _gps(self, t: float, rng: np.random.Generator) -> list[tuple[float, Sample]]:
        delay_s = float(rng.uniform(*self.gps_delay_s))
        noise = rng.normal(size=6)
        if self.gps_lost_s[0] <= t < self.gps_lost_s[1]:
            return []
        # metres of wander over minutes, decimetres of noise
        wander = 1.5 * np.sin(t / np.array([17.0, 23.0, 29.0]) + self.seed)
        lever = np.array(quat_rotate(self.attitude(t), ANTENNA))
        swing = np.array(quat_rotate(self.attitude(t), cross(self.rate(t), ANTENNA)))
        place = geodetic_from_ned(vector3(np.array(self.path(t)) + lever + wander + 0.2 * noise[:3]), HOME)
        speed = vector3(np.array(velocity(self.path, t)) + swing + NEO_6M_SPEED_NOISE_M_S * noise[3:])
        return [(t + delay_s, GpsFix(t, *place, speed, 2.5, 4.0, 0.15, 9))]

    def _range(self, t: float, rng: np.random.Generator) -> list[tuple[float, Sample]]:
        sensor = quat_rotate(self.attitude(t), VEHICLE.range_position_body_m)
        height = self.pad_path(t)[2] - self.path(t)[2] - sensor[2]
        distance = height + 0.01 * float(rng.normal())
        return [(t + 0.03, RangeSample(t, distance))] if 0.03 < distance < 4.5 else []

    def _sighting(self, t: float, rng: np.random.Generator) -> list[tuple[float, Sample]]:
        noise = rng.normal(size=6)
        if t < 10.0 or self.pad_hidden_s[0] <= t < self.pad_hidden_s[1]:
            return []
        q = self.attitude(t)
        relative = np.array(self.pad_path(t)) - self.path(t)
        distance = float(np.linalg.norm(relative))
        std = np.array([0.001 * distance] * 2 + [0.003 * distance] + [0.01] * 3)
        position = vector3(np.array(quat_rotate_inverse(q, vector3(relative))) + std[:3] * noise[:3])
        truth = quat_multiply(quat_conjugate(q), quat_from_euler(0.0, 0.0, self.pad_heading(t)))
        turned = quat_multiply(quat_from_rotation_vector(vector3(std[3:] * noise[3:])), truth)
        stamped_s = t + self.stamp_jitter_s * float(rng.normal()) if self.stamp_jitter_s else t
        sighting = PadSighting(
            stamped_s,
            round(t * 30),
            position,
            turned,
            np.diag(std**2),
            "F",
            (0, 1),
            {"F": 2, "M": 0, "C": 0},
            0.3,
        )
        return [(t + self.sighting_delay_s, sighting)]


def new_estimator(config: EstimateConfig | None = None) -> StateEstimator:
    """An estimator for the test's vehicle over a 1.3 m board."""
    return StateEstimator(
        config or EstimateConfig(magnetic_field_ned_ut=FIELD_NED_UT), VEHICLE, ANTENNA, 0.65
    )


def feed(estimator: StateEstimator, sample: Sample) -> bool:
    """Hand a sample to where it belongs."""
    match sample:
        case ImuSample():
            return estimator.add_imu(sample)
        case MagSample():
            return estimator.add_mag(sample)
        case GpsFix():
            return estimator.add_gps(sample)
        case RangeSample():
            return estimator.add_range(sample)
        case PadSighting():
            return estimator.add_sighting(sample)


@dataclass
class Errors:
    """Errors of the states asked for at 30 Hz; rows are times."""

    time_s: list[float] = field(default_factory=list)
    attitude_rad: list[Vector3] = field(default_factory=list)  # a rotation about NED axes
    velocity_m_s: list[Vector3] = field(default_factory=list)
    vehicle: list[VehicleState] = field(default_factory=list)
    pad_time_s: list[float] = field(default_factory=list)
    relative_position_m: list[Vector3] = field(default_factory=list)
    relative_velocity_m_s: list[Vector3] = field(default_factory=list)
    pad_velocity_m_s: list[Vector3] = field(default_factory=list)
    heading_rad: list[float] = field(default_factory=list)
    pad: list[PadState] = field(default_factory=list)

    def rms(self, name: str, start_s: float = 16.0, end_s: float = 1e9) -> float:
        """Root mean square of an error's length between two times."""
        times = np.array(self.time_s if name in {"attitude_rad", "velocity_m_s"} else self.pad_time_s)
        rows = np.array(getattr(self, name))[(times >= start_s) & (times < end_s)]
        assert len(rows) > 10, "nothing to judge"
        return float(np.sqrt(np.mean(np.sum(rows.reshape(len(rows), -1) ** 2, axis=1))))


def fly(flight: EstimateFlight, estimator: StateEstimator | None = None) -> Errors:
    """Feed a flight's samples in their order of arrival and compare with the truth at 30 Hz."""
    estimator = estimator or new_estimator()
    errors, next_s = Errors(), 1.0 / 30.0
    for arrival_s, sample in flight.samples:
        feed(estimator, sample)
        if arrival_s >= next_s:
            next_s += 1.0 / 30.0
            _compare(errors, flight, estimator, arrival_s)
    return errors


def _compare(errors: Errors, flight: EstimateFlight, estimator: StateEstimator, now_s: float) -> None:
    vehicle, pad = estimator.vehicle(now_s), estimator.pad(now_s)
    speed = np.array(velocity(flight.path, now_s))
    if vehicle is not None:
        errors.time_s.append(now_s)
        turn = quat_multiply(vehicle.attitude, quat_conjugate(flight.attitude(now_s)))
        errors.attitude_rad.append(rotation_vector_from_quat(turn))
        errors.velocity_m_s.append(vector3(np.array(vehicle.velocity_ned_m_s) - speed))
        errors.vehicle.append(vehicle)
    if pad is not None:
        errors.pad_time_s.append(now_s)
        place = np.array(flight.pad_path(now_s)) - flight.path(now_s)
        pad_speed = np.array(velocity(flight.pad_path, now_s))
        errors.relative_position_m.append(vector3(np.array(pad.relative_position_ned_m) - place))
        errors.relative_velocity_m_s.append(
            vector3(np.array(pad.relative_velocity_ned_m_s) - (pad_speed - speed))
        )
        errors.pad_velocity_m_s.append(vector3(np.array(pad.velocity_ned_m_s) - pad_speed))
        errors.heading_rad.append(math.remainder(pad.heading_rad - flight.pad_heading(now_s), math.tau))
        errors.pad.append(pad)


def without(flight: EstimateFlight, *sensors: str) -> EstimateFlight:
    """The same flight with some sensors dead."""
    return replace(flight, sensors=flight.sensors - set(sensors))
