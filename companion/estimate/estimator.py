"""One step of the estimate stage: sensors in, the state of vehicle and pad out.

Fixes, sightings and echoes are fused at the time of their measurement, however late they arrive. No clock,
no I/O: every sample carries its time, and every query names one. NED and FRD, SI units, µT; the vehicle's
reference point is its centre of mass.
"""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Iterable
from functools import partial
from operator import itemgetter
from typing import Final

import numpy as np

from companion.base.geometry import (
    FloatArray,
    Quaternion,
    Vector3,
    add,
    down_axis,
    down_in_body,
    norm,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    tilt_from_quat,
    vector3,
)
from companion.base.messages import (
    AutopilotAttitude,
    CarriedPad,
    GpsFix,
    ImuSample,
    MagSample,
    PadObservation,
    PadPrior,
    PadSighting,
    PadState,
    RangeSample,
    SourceComparison,
    VehicleState,
)
from companion.config import EstimateConfig, VehicleConfig
from companion.estimate.gating import Gate, Timeline
from companion.estimate.input_tally import InputTally
from companion.estimate.motion import MotionHistory
from companion.estimate.pad.camera_check import CameraCheck
from companion.estimate.pad.mount_check import MountCheck
from companion.estimate.pad.observation import VehicleAtExposure
from companion.estimate.pad.observation_kinds import BY_MESSAGE
from companion.estimate.pad.pad_filter import PadFilter
from companion.estimate.pad.pad_types import (
    CombinedEstimate,
    HeightMeasurement,
    PadInput,
    PadMeasurement,
    PadSnapshot,
)
from companion.estimate.vehicle.vehicle_estimator import FUTURE_S, VehicleEstimator
from companion.estimate.velocity_check import VelocityCheck

RANGE_MAXIMUM_TILT_DEG: Final = 20.0  # echoes come back aslant beyond this
ATTITUDE_WANDER_RAD_S: Final = 0.3  # how fast the horizon's error changes: a share of itself a second

FRAMES_APART_S: Final = 1.0 / 30.0  # of a camera at 30 Hz
READOUT_S = 0.02  # about what a camera takes from its first row to its last
LARGEST_RATE_RAD_S = 70.0  # an MPU9250 measures 35 rad/s and 157 m/s² at most: more is a fault of the line
LARGEST_FORCE_M_S2 = 320.0  # twice what it measures, as above


class StateEstimator:
    """Both halves: the vehicle by the 31-state EKF, the pad by the relative-motion filter.

    A sample that is not finite, or whose time cannot be right, is refused: `add_*` then returns False.
    """

    def __init__(
        self,
        config: EstimateConfig,
        vehicle: VehicleConfig,
        antenna_position_body_m: Vector3,
        board_half_width_m: float,
    ) -> None:
        self._config, self._board_half_width_m = config, board_half_width_m
        self._airframe, self._antenna_m = vehicle, antenna_position_body_m
        self.tally = InputTally()
        self._why_not = ""
        self._begin(None, ())

    def _begin(self, origin: Vector3 | None, corrections: tuple[str, ...]) -> None:
        config, airframe = self._config, self._airframe
        self._motion = MotionHistory(config.pad.forget_s + 1.0)
        imu_m = airframe.imu_position_body_m
        self._vehicle = VehicleEstimator(config, self._antenna_m, self._motion, imu_m)
        self._vehicle.origin, self._vehicle.corrections = origin, corrections
        self._no_pad()
        axis = down_axis(quat_from_euler(*airframe.camera_turn_rad))
        self._camera_check = CameraCheck(self._motion, config.pad, self._board_half_width_m, axis)
        self._mount_check = MountCheck(self._motion, airframe.camera_position_body_m, airframe.camera_yaw_deg)
        self._velocity_check = VelocityCheck()

    def _no_pad(self) -> None:
        config = self._config.pad
        self._pad = PadFilter(config, self._motion, self._board_half_width_m)
        self._timeline: Timeline[PadSnapshot, PadInput] = Timeline(self._pad, config.remember_s)
        self._early: list[PadObservation] = []  # of what the IMU has not come up to
        self._fused: list[tuple[float, PadObservation | RangeSample]] = []  # by time, as far as replayed

    def start_over(self) -> None:
        """Forget vehicle and pad: more time has gone by than any clock shows. The alignment begins again."""
        self._vehicle.start_over()
        self._velocity_check.forget()
        self.begin_checks()
        self._no_pad()

    def begin_checks(self) -> None:
        """Another mission, or another time: what was compared over the pad before says nothing any more."""
        self._camera_check.begin_anew()
        self._mount_check.begin_anew()

    def recover(self, now_s: float) -> str | None:
        """On the ground: start anew where all of IMU or GPS has been refused for long; says so, else None."""
        found = self.tally.starved("imu", now_s)
        if self._vehicle.aligned and found is None:
            found = self.tally.starved("gps", now_s)
        if found is None:
            return None
        self._begin(self._vehicle.origin, self._vehicle.corrections)
        self.tally = InputTally()
        return f"{found}; estimate restarted"

    # ------------------------------------------------------------ inputs

    def add_imu(self, sample: ImuSample, received_s: float = math.inf) -> bool:
        """Take one sample; they must come in order of time, and none is of the time after its receipt."""
        rate, force = sample.rate_body_rad_s, sample.specific_force_body_m_s2
        # what is no number is not smaller than anything
        usable = (
            -math.inf < sample.time_s <= received_s + FUTURE_S
            and sample.time_s < math.inf
            and norm(rate) <= LARGEST_RATE_RAD_S
            and norm(force) <= LARGEST_FORCE_M_S2
        )
        taken = usable and self._vehicle.add_imu(sample)
        while (
            self._early and taken and self._vehicle.aligned and (due := self._due(sample.time_s)) is not None
        ):
            self._fuse(self._early.pop(due))
        return self._count("imu", taken)

    def add_mag(self, sample: MagSample) -> bool:
        """Take one calibrated sample."""
        usable = self._usable(sample.time_s, sample.field_body_ut)
        return self._count("mag", usable and self._vehicle.add_mag(sample))

    def add_gps(self, fix: GpsFix) -> bool:
        """Take one fix, at its own time; refused before the alignment."""
        place = (fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
        accuracy = (fix.horizontal_accuracy_m, fix.vertical_accuracy_m, fix.speed_accuracy_m_s)
        climb_accuracy = fix.vertical_speed_accuracy_m_s or 0.0
        usable = self._usable(fix.time_s, (*place, *fix.velocity_ned_m_s, *accuracy, climb_accuracy))
        if usable and self._vehicle.aligned:
            ours = self._vehicle.velocity(fix.time_s)
            self._velocity_check.take_fix(fix.time_s, ours, fix.velocity_ned_m_s)
        return self._count("gps", usable and self._vehicle.add_gps(fix))

    def add_autopilot_attitude(self, sample: AutopilotAttitude) -> bool:
        """Take the autopilot's attitude; refused before the alignment."""
        usable = self._usable(sample.time_s, sample.attitude)
        if usable and self._vehicle.aligned:
            self._camera_check.imu_by_link = sample.same_imu
            if sample.round_trip_s > 0.0:
                self._camera_check.half_trip_s = 0.5 * sample.round_trip_s
        taken = usable and self._vehicle.add_autopilot_attitude(sample)
        since_s, self._motion.turned_since_s = self._motion.turned_since_s, math.inf
        if since_s < math.inf:
            self._see_again(since_s)
        return self._count("attitude", taken)

    def _see_again(self, since_s: float) -> None:
        """Take what was fused by attitudes that have proved wrong once more, by those that replace them."""
        again = [entry for entry in self._fused if entry[0] >= since_s]
        made = [(time_s, self._in_ned(time_s, seen)) for time_s, seen in again]
        self._timeline.replace(since_s, [(time_s, item) for time_s, item in made if item is not None])
        self._camera_check.begin_motion()
        self._mount_check.begin_motion()

    def add_autopilot_velocity(self, time_s: float, velocity_ned_m_s: Vector3) -> None:
        """Compare the autopilot's velocity at a time with ours, which it does not correct."""
        place = self._vehicle.place(time_s) if self._usable(time_s, velocity_ned_m_s) else None
        if place is not None:
            ours, std_m_s = self._vehicle.velocity(time_s), max(place.velocity_std_m_s[:2])
            self._velocity_check.take(time_s, ours, velocity_ned_m_s, std_m_s)

    def take_notices(self) -> tuple[tuple[str, str], ...]:
        """What was found since the last call, kind and words: a correction of the attitude."""
        corrections, self._vehicle.corrections = self._vehicle.corrections, ()
        return tuple(("attitude", words) for words in corrections)

    @property
    def link_delay_s(self) -> float:
        """By how much the times that the link gives are late (s), to be taken off them."""
        return self._camera_check.link_delay_s

    @property
    def origin(self) -> Vector3 | None:
        """Latitude and longitude (deg), altitude (m) of the first fix that was taken; None before it."""
        return self._vehicle.origin

    @property
    def comparisons(self) -> tuple[SourceComparison, ...]:
        """What has been measured by two sources, of the table of `companion.base.second_sources`."""
        newest_s = self._vehicle.newest_s
        attitudes = self._vehicle.attitude_comparisons()
        by_link = (*attitudes, *self._velocity_check.comparisons(newest_s))
        return (*by_link, *self._mount_check.comparisons, *self._camera_check.comparisons)

    def add_range(self, sample: RangeSample) -> bool:
        """Take one echo; it counts when the pad filter knows that the sensor is over the board and low."""
        usable = self._motion.newest_s is not None and self._usable(sample.time_s, (sample.distance_m,))
        measurement = self._height(sample) if usable else None
        if measurement is None:
            return self._count("range", False)
        self._camera_check.take_echo(sample.time_s, measurement)
        return self._count("range", self._take(sample.time_s, sample, measurement))

    def _height(self, sample: RangeSample) -> HeightMeasurement | None:
        """Of the sensor over what is below it; None where it looks too far aslant."""
        attitude = self._motion.attitude(sample.time_s)
        assert attitude is not None
        tilt_rad = tilt_from_quat(attitude)
        if tilt_rad > math.radians(RANGE_MAXIMUM_TILT_DEG):
            return None
        # a wide beam measures to the nearest point, a narrow one the point on its axis: take the height
        # under the axis, with the difference as its noise
        height_m = sample.distance_m * math.cos(tilt_rad)
        noise_m = math.hypot(self._config.pad.range_noise_m, sample.distance_m - height_m)
        offset = quat_rotate(attitude, self._airframe.range_position_body_m)
        return HeightMeasurement(height_m, offset, noise_m)

    def _take(self, time_s: float, seen: PadObservation | RangeSample, measurement: PadInput) -> bool:
        """Fuse what was made of something, and remember that for as long."""
        taken = self._timeline.add(time_s, measurement)
        if taken:
            insort(self._fused, (time_s, seen), key=itemgetter(0))
            before_s = self._fused[-1][0] - self._config.pad.remember_s
            while self._fused[0][0] < before_s:
                del self._fused[0]
        return taken

    def _in_ned(self, time_s: float, seen: PadObservation | RangeSample) -> PadInput | None:
        if isinstance(seen, RangeSample):
            return self._height(seen)
        measurement: PadInput | None = BY_MESSAGE[type(seen)].in_ned(seen, self._exposure(time_s))
        return measurement

    def add_sighting(self, sighting: PadSighting) -> bool:
        """Take what the camera has seen; see `observe`."""
        return self.observe(sighting)

    def observe(self, observation: PadObservation) -> bool:
        """Take a measurement of the pad, fused at its exposure, if need be once the IMU has come as far.

        It is refused before the alignment, and before another after the IMU was lost.
        """
        kind = BY_MESSAGE[type(observation)]
        moved_s = self._motion.newest_s  # none before the first sample after the alignment's
        if not self._vehicle.aligned or moved_s is None:
            self._early.clear()
            return self._count(kind.name, False)
        if not self._usable(observation.time_s, kind.numbers(observation)):
            return self._count(kind.name, False)
        if self._exposed_s(observation) > moved_s:
            self._early.append(observation)
            return True
        return self._fuse(observation)

    def _exposed_s(self, observation: PadObservation) -> float:
        late = BY_MESSAGE[type(observation)].by_camera
        return observation.time_s + self._camera_check.frame_delay_s if late else observation.time_s

    def _due(self, time_s: float) -> int | None:
        """Which of those that waited for the IMU is the first that it has come up to."""
        exposed = (self._exposed_s(observation) <= time_s for observation in self._early)
        return next((place for place, come in enumerate(exposed) if come), None)

    def _fuse(self, observation: PadObservation) -> bool:
        kind, time_s = BY_MESSAGE[type(observation)], self._exposed_s(observation)
        measurement = self._in_ned(time_s, observation)
        if measurement is None:
            self._why_not = "the vehicle's own position is unknown"
            return self._count(kind.name, False)
        taken = self._take(time_s, observation, measurement)
        if taken and isinstance(measurement, PadMeasurement) and isinstance(observation, PadSighting):
            variance_m2 = float(np.trace(measurement.covariance_ned_m2)) / 3.0
            self._camera_check.take(time_s, observation.pad_position_body_m, variance_m2)
            self._mount_check.take(time_s, observation.pad_position_body_m, variance_m2)
        return self._count(kind.name, taken)

    def _exposure(self, time_s: float) -> VehicleAtExposure:
        attitude = self._motion.attitude(time_s)
        assert attitude is not None
        turned_rad = self._motion.turned_rad(time_s, self._config.pad.exposure_jitter_s)
        gyro_rad2 = self._motion.turn_density_rad2_s * FRAMES_APART_S
        vehicle = self._vehicle
        return VehicleAtExposure(
            time_s,
            attitude,
            turned_rad**2 + gyro_rad2,
            vehicle.velocity(time_s),
            vehicle.velocity_std_m_s,
            partial(vehicle.place, time_s),
        )

    # ------------------------------------------------------------ outputs

    def vehicle(self, now_s: float) -> VehicleState | None:
        """The vehicle, predicted to now_s; None before the alignment and when the IMU has gone silent.

        A state with anything in it that is not finite is none: comparisons with NaN warn of nothing.
        """
        state = self._vehicle.state(now_s, 2.0 * self._camera_check.link_delay_s)
        if state is None:
            return None
        moves = (*state.position_ned_m, *state.velocity_ned_m_s, *state.acceleration_ned_m_s2)
        felt = (*state.side_force_ned_m_s2, state.acceleration_density_m2_s3)
        return state if _finite((*moves, *felt, *state.attitude, *state.rate_body_rad_s)) else None

    def pad(self, now_s: float) -> PadState | None:
        """The pad, predicted to now_s; None before the first sighting, unseen for too long, or not finite."""
        estimate = self._pad_at(now_s)
        if estimate is None:
            return None
        north, east, down, vn, ve, vd, *acceleration = estimate.x.tolist()
        position, relative_velocity = (north, east, down), (vn, ve, vd)
        rotation = self._vehicle.rotation_covariance()
        rotation = np.zeros((3, 3)) if rotation is None else rotation
        covariance = estimate.covariance(rotation, ATTITUDE_WANDER_RAD_S).tolist()
        variance = [row[at] for at, row in enumerate(covariance)]
        place_variance, speed_variance = sum(variance[:3]), sum(variance[3:])
        if not (place_variance >= 0.0 and speed_variance >= 0.0):
            return None
        return PadState(
            time_s=now_s,
            relative_position_ned_m=position,
            relative_velocity_ned_m_s=relative_velocity,
            velocity_ned_m_s=add(relative_velocity, self._vehicle.velocity(now_s)),
            acceleration_ned_m_s2=vector3(acceleration),
            heading_rad=estimate.heading_rad,
            heading_rate_rad_s=estimate.heading_rate_rad_s,
            position_std_m=math.sqrt(place_variance),
            velocity_std_m_s=math.sqrt(speed_variance),
            seen_time_s=estimate.seen_time_s,
            covariance=tuple(map(tuple, covariance)),
            turn_rate_rad_s=estimate.turn_rate_rad_s,
            jerk_ned_m_s3=(*estimate.jerk_m_s3, 0.0),
            models=estimate.models,
            tilt_rad=estimate.tilt.tilt_rad,
            tilt_rate_rad_s=estimate.tilt.rate_rad_s,
            tilt_mean_rad=estimate.tilt.mean_rad,
            tilt_swing_rad=estimate.tilt.swing_rad,
            tilt_frequency_rad_s=estimate.tilt.frequency_rad_s,
            seen_velocity_ned_m_s=add(relative_velocity, self._motion.moved(estimate.seen_time_s, now_s)[1]),
        )

    def carried_pad(self, now_s: float) -> CarriedPad | None:
        """The pad, predicted to now_s, while something else than the camera carries its estimate."""
        snapshot = self._timeline.as_of(now_s)
        if snapshot is None or not snapshot.observed_time_s > snapshot.seen_time_s:
            return None
        if now_s - snapshot.observed_time_s > self._config.pad.forget_s:
            return None
        estimate = self._pad.predicted(snapshot, now_s)
        if estimate is None or not _finite(estimate.x):
            return None
        variance_m2 = 0.5 * float(estimate.P[0, 0] + estimate.P[1, 1])
        if not variance_m2 >= 0.0:
            return None
        return CarriedPad(
            time_s=now_s,
            relative_position_ned_m=vector3(estimate.x[0:3]),
            velocity_ned_m_s=add(vector3(estimate.x[3:6]), self._vehicle.velocity(now_s)),
            acceleration_ned_m_s2=vector3(estimate.x[6:9]),
            lateral_std_m=math.sqrt(variance_m2),
            observed_time_s=estimate.observed_time_s,
        )

    def attitude(self, time_s: float) -> Quaternion | None:
        """The attitude, body to NED, at a time of the last seconds; None before the alignment."""
        return self._motion.attitude(time_s)

    def vehicle_covariance(self) -> FloatArray | None:
        """Covariance (9, 9) of `vehicle`; None before the alignment.

        Order: small rotation about NED axes (rad) with R_true = exp(rotation) R, velocity NED (m/s),
        position NED (m).
        """
        return self._vehicle.covariance()

    def pad_prior(self, time_s: float) -> PadPrior | None:
        """What to expect in a frame exposed at time_s; None before the alignment."""
        at_s = time_s + self._camera_check.frame_delay_s
        attitude = self._motion.attitude(at_s)
        if attitude is None:
            return None
        down = down_in_body(attitude)
        estimate = self._pad_at(at_s)
        rate = self._motion.rate_body_rad_s(at_s, READOUT_S)
        if estimate is None:
            return PadPrior(time_s, down, rate_body_rad_s=rate)
        position = vector3(estimate.x[0:3])
        level_pad = quat_from_euler(0.0, 0.0, estimate.heading_rad)
        return PadPrior(
            time_s=time_s,
            down_body=down,
            pad_position_body_m=quat_rotate_inverse(attitude, position),
            body_from_pad=quat_multiply(quat_conjugate(attitude), level_pad),
            position_std_m=estimate.position_std_m,
            climb_m_s=float(estimate.x[5]),
            rate_body_rad_s=rate,
        )

    @property
    def refused(self) -> dict[str, int]:
        """Measurements not used so far, by kind: not finite or of a wrong time; innovation test failed."""
        counts = {f"{kind}_unusable": count for kind, count in self.tally.unusable.items()}
        return counts | {f"{kind}_gate": gate.refused for kind, gate in self._gates().items()}

    def _gates(self) -> dict[str, Gate]:
        return {**self._pad.gates, **self._vehicle.gates}

    # ------------------------------------------------------------ the pad

    def _pad_at(self, time_s: float) -> CombinedEstimate | None:
        snapshot = self._timeline.as_of(time_s)
        if snapshot is None or time_s - snapshot.seen_time_s > self._config.pad.forget_s:
            return None
        estimate = self._pad.predicted(snapshot, time_s)
        if estimate is None:
            return None
        # no look for the pad where it cannot be: a look that fails brings no sighting to start again from
        numbers = (*estimate.x.tolist(), estimate.heading_rad, estimate.heading_rate_rad_s)
        return estimate if _finite(numbers) and 0.0 <= estimate.position_variance_m2 < math.inf else None

    # ------------------------------------------------------------ what may come in

    def _usable(self, time_s: float, values: Iterable[float]) -> bool:
        ahead_s = time_s - self._vehicle.newest_s
        if not _finite((time_s, *values)):
            self._why_not = "not a finite number"
        elif ahead_s > FUTURE_S:
            self._why_not = f"stamped {ahead_s:.2g} s ahead of the IMU"
        else:
            self._why_not = ""
        return not self._why_not

    def _count(self, kind: str, taken: bool) -> bool:
        why_not, self._why_not = self._why_not, ""
        if taken:
            why_not = ""
        elif not why_not:
            why_not = "older than what is remembered" if self._vehicle.aligned else "before the alignment"
        self.tally.note(kind, why_not, self._gates)
        return taken


def _finite(values: Iterable[float]) -> bool:
    return all(map(math.isfinite, values))
