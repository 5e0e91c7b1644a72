"""What an estimator answered, against the truth: errors with the covariances that it gave itself.

Errors are truth minus estimate; the attitude's is the rotation vector (rad, NED axes) of R_true R_estᵀ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Final

import numpy as np

from companion.base.geometry import FloatArray, ned_from_geodetic, quat_conjugate, quat_multiply
from companion.base.geometry import rotation_vector_from_quat as rotation_vector
from companion.base.messages import PadState, Truth, VehicleState
from companion.estimate.estimator import StateEstimator
from companion.flightlog.errors import TruthTrack
from sitl.scenario.scenario import USUAL_HOMES

HOME = USUAL_HOMES["px4"]

SEEN_GAP_S: Final = 0.5  # unseen for so long, the pad is out of view


@dataclass(frozen=True)
class Samples:
    """Errors (truth minus estimate) and covariances at n times; see the fields for shapes.

    Where there is no estimate, errors are NaN: positions before the first fix, all of the pad's without one.
    """

    time_s: FloatArray  # (n,)
    rotation_rad: FloatArray  # (n, 3) about NED axes
    velocity_m_s: FloatArray  # (n, 3)
    position_m: FloatArray  # (n, 3) by way of latitude and longitude
    covariance: FloatArray  # (n, 9, 9) rotation, velocity, position
    pad_position_m: FloatArray  # (n, 3) relative
    pad_velocity_m_s: FloatArray  # (n, 3) relative
    pad_ned_velocity_m_s: FloatArray  # (n, 3) of the pad over ground
    pad_heading_rad: FloatArray  # (n,)
    pad_covariance: FloatArray  # (n, 6, 6) relative position, relative velocity
    seen_for_s: FloatArray  # (n,) how long the pad has been in view without a gap; NaN: not in view
    airborne: Any = field(repr=False)  # (n,) bool: from take-off to touchdown

    @property
    def attitude_deg(self) -> FloatArray:
        """(n,) angle between true and estimated attitude."""
        angle: FloatArray = np.degrees(np.linalg.norm(self.rotation_rad, axis=1))
        return angle

    @property
    def inclination_deg(self) -> FloatArray:
        """(n,) its share about horizontal axes."""
        angle: FloatArray = np.degrees(np.linalg.norm(self.rotation_rad[:, :2], axis=1))
        return angle

    @property
    def heading_deg(self) -> FloatArray:
        """(n,) its share about the vertical, signed."""
        heading: FloatArray = np.degrees(self.rotation_rad[:, 2])
        return heading

    def where(self, mask: Any) -> Samples:
        """The samples that a boolean mask (n,) chooses."""
        return Samples(**{item.name: getattr(self, item.name)[mask] for item in fields(self)})


def rms(rows: FloatArray) -> float:
    """Root mean square of values (n,), or of the lengths of rows (n, 3); NaN without any."""
    lengths = rows if rows.ndim == 1 else np.linalg.norm(rows, axis=1)
    lengths = lengths[np.isfinite(lengths)]
    return float(np.sqrt(np.mean(lengths**2))) if len(lengths) else float("nan")


@dataclass(frozen=True, slots=True)
class EstimatorAnswer:
    """What the estimator says at one time."""

    vehicle: VehicleState
    covariance: FloatArray
    pad: PadState | None
    pad_covariance: FloatArray | None


def ask(estimator: StateEstimator, now_s: float) -> EstimatorAnswer | None:
    """Ask for everything, as a control cycle does; None before the alignment."""
    vehicle, covariance = estimator.vehicle(now_s), estimator.vehicle_covariance()
    if vehicle is None or covariance is None:
        return None
    pad = estimator.pad(now_s)
    return EstimatorAnswer(vehicle, covariance, pad, None if pad is None else np.array(pad.covariance))


def samples_of(
    answers: Sequence[EstimatorAnswer], truth: Sequence[Truth], airborne_s: tuple[float, float]
) -> Samples:
    """Errors and covariances of all answers within the track of the truth."""
    track = TruthTrack(truth)
    covered = track.covers(np.array([answer.vehicle.time_s for answer in answers]))
    rows = [answer for answer, inside in zip(answers, covered, strict=True) if inside]
    times = np.array([row.vehicle.time_s for row in rows])
    empty = np.full((6, 6), np.nan)
    covariances = [empty if row.pad_covariance is None else row.pad_covariance for row in rows]
    pads = [row.pad for row in rows]
    return Samples(
        time_s=times,
        **_vehicle_errors([row.vehicle for row in rows], track, times),
        covariance=np.array([row.covariance for row in rows]).reshape(-1, 9, 9),
        **_pad_errors(pads, track, times),
        pad_heading_rad=_heading_errors(pads, truth, times),
        pad_covariance=np.array(covariances).reshape(-1, 6, 6),
        seen_for_s=_seen_for(pads, times),
        airborne=(times > airborne_s[0]) & (times < airborne_s[1]),
    )


def _pad_errors(
    pads: Sequence[PadState | None], track: TruthTrack, times: FloatArray
) -> dict[str, FloatArray]:
    nothing = (np.nan,) * 3
    place = np.array([p.relative_position_ned_m if p else nothing for p in pads]).reshape(-1, 3)
    speed = np.array([p.relative_velocity_ned_m_s if p else nothing for p in pads]).reshape(-1, 3)
    over_ground = np.array([p.velocity_ned_m_s if p else nothing for p in pads]).reshape(-1, 3)
    pad_velocity = track.at("pad_velocity", times)
    return {
        "pad_position_m": track.at("pad_position", times) - track.at("position", times) - place,
        "pad_velocity_m_s": pad_velocity - track.at("velocity", times) - speed,
        "pad_ned_velocity_m_s": pad_velocity - over_ground,
    }


def _heading_errors(pads: Sequence[PadState | None], truth: Sequence[Truth], times: FloatArray) -> FloatArray:
    heading = np.array([p.heading_rad if p else np.nan for p in pads])
    headings = np.unwrap([t.pad_heading_rad for t in truth])
    turned: FloatArray = np.interp(times, [t.time_s for t in truth], headings) - heading
    return np.remainder(turned + np.pi, 2.0 * np.pi) - np.pi


def _vehicle_errors(
    vehicles: Sequence[VehicleState], track: TruthTrack, times: FloatArray
) -> dict[str, FloatArray]:
    rotations = [
        rotation_vector(quat_multiply(_quaternion(true), quat_conjugate(vehicle.attitude)))
        for true, vehicle in zip(track.at("attitude", times), vehicles, strict=True)
    ]
    velocity = np.array([v.velocity_ned_m_s for v in vehicles]).reshape(-1, 3)
    position = np.array([_from_home(v) for v in vehicles]).reshape(-1, 3)
    return {
        "rotation_rad": np.array(rotations).reshape(-1, 3),
        "velocity_m_s": track.at("velocity", times) - velocity,
        "position_m": track.at("position", times) - position,
    }


def _quaternion(values: FloatArray) -> tuple[float, float, float, float]:
    w, x, y, z = values.tolist()
    return (w, x, y, z)


def _from_home(vehicle: VehicleState) -> FloatArray:
    """The EKF counts from its first fix, the world from home."""
    if vehicle.origin is None:
        return np.full(3, np.nan)
    return np.add(vehicle.position_ned_m, ned_from_geodetic(*vehicle.origin, HOME))


def _seen_for(pads: Sequence[PadState | None], times: FloatArray) -> FloatArray:
    """As in the result contract: in view without a gap of half a second."""
    spans, since = np.full(len(pads), np.nan), None
    for row, (pad, time_s) in enumerate(zip(pads, times.tolist(), strict=True)):
        if pad is None or time_s - pad.seen_time_s > SEEN_GAP_S:
            since = None
            continue
        since = time_s if since is None else since
        spans[row] = time_s - since
    return spans
