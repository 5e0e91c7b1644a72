"""Reads a recording for the mount calibration: from `calibrate-mount record`, or a flight log.

Both are a flight.mcap with its settings, so the mounting that was applied to its sightings is known and
undone. The result is the pad in camera axes, at the frames' stamps as the camera gave them.

The sightings of a flight used gravity (see `pad_detector`), so the pad is detected again in the logged frames
(about five per second), and likewise if the camera was calibrated since. Without frames, the sightings stand.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.mount import EXPECTED
from companion.base.geometry import FloatArray, matrix_from_quat
from companion.base.messages import Frame, ImuSample, PadSighting
from companion.config import (
    CameraConfig,
    CompanionConfig,
    ConfigError,
    InertialCalibration,
    StrictModel,
    VehicleConfig,
    VisionConfig,
    validate,
)
from companion.flightlog.log_file import LogReader, find_log
from companion.flightlog.replay.flight_record import FlightRecord, ReplaySetup
from companion.flightlog.replay.mcap_log import read_mcap
from companion.pad import Pad
from companion.sense.vision.aruco import PadDetector, SearchPass
from companion.sense.vision.lens import Lens
from companion.sense.vision.pipeline import body_from_camera, sighting_of, turn_covariance
from companion.sense.vision.pose import PoseFit, estimate_pose
from companion.sense.vision.search import SearchPlanner

# the chip's accelerometer is filtered a millisecond less than its gyroscope, whose delay both are stamped by
# (register map RM-MPU-9250A-00 rev. 1.6, tables of CONFIG and ACCEL_CONFIG 2)
FORCE_AHEAD_S: Final = 0.001
# the settings record of `calibrate-mount record`, beside those of a flight
MARK: Final = "recording"
# and that of the inertial samples' calibration, as the app leaves it, too
INERTIAL: Final = "inertial"


class RecordingMark(StrictModel):
    """Stands in a recording's settings: what its sightings are."""

    gravity_free: bool


@dataclass(frozen=True, slots=True)
class MountRecording:
    """Samples, and the settings that they were taken under; `notes` for people.

    `calibrated` is what the inertial samples were put right by as they came.
    """

    inertial: ImuSamples
    sightings: PadObservations
    config: CompanionConfig
    vehicle: VehicleConfig
    camera: CameraConfig
    pad: Pad
    source: str
    calibrated: InertialCalibration | None = None
    notes: list[str] = field(default_factory=list)


def read_recording(path: Path, camera: CameraConfig | None = None) -> MountRecording:
    """Read a recording; with another `camera`, its frames are looked at through that one's lens.

    Raises:
        ConfigError: it is no such log, or holds no inertial samples or settings.
    """
    file = find_log(path)
    record = read_mcap(file)
    rig = record.rig
    if rig is None or rig.camera is None:
        raise ConfigError(f"{file}: holds no settings of a camera; {EXPECTED}")
    used = camera or rig.camera
    notes = [*record.notes, *([record.cut] if record.cut else [])]
    sightings, how = _sightings(file, record, rig, used, gravity_free=MARK in record.settings)
    if how:
        notes.append(how)
    inertial = inertial_of(record, file)
    if rig.config.sense.source == "boards":
        inertial = with_forces_in_time(inertial)
    return MountRecording(
        inertial,
        in_camera_axes(sightings, rig.vehicle),
        rig.config,
        rig.vehicle,
        used,
        rig.pad,
        str(path),
        _calibrated(record.settings, file),
        notes,
    )


def inertial_of(record: FlightRecord, file: Path) -> ImuSamples:
    """The inertial samples of a log, in body axes and in order of time.

    Raises:
        ConfigError: there are none to speak of.
    """
    samples = [event.item for event in record.events if isinstance(event.item, ImuSample)]
    if len(samples) < 100:
        raise ConfigError(f"{file}: {len(samples)} inertial samples; expected those of some seconds at least")
    return ImuSamples.of(usable(rows_of(sorted(samples, key=lambda s: s.time_s))))


def with_forces_in_time(inertial: ImuSamples) -> ImuSamples:
    """The same with the MPU9250's forces brought to the times of its rates."""
    early_s = inertial.time_s - FORCE_AHEAD_S
    forces = [np.interp(early_s, inertial.time_s, column) for column in inertial.force.T]
    return replace(inertial, force=np.stack(forces, axis=1))


def in_camera_axes(sightings: list[PadSighting], vehicle: VehicleConfig) -> PadObservations:
    """Undo the mounting and the time offset under which the sightings were made."""
    sightings = sorted(sightings, key=lambda s: s.time_s)
    turn = matrix_from_quat(body_from_camera(vehicle)).T
    mount = np.array(vehicle.camera_position_body_m)
    rotations = [turn @ matrix_from_quat(s.body_from_pad) for s in sightings]
    positions = [turn @ (np.array(s.pad_position_body_m) - mount) for s in sightings]
    covariances: list[FloatArray] = [turn_covariance(s.covariance, turn) for s in sightings]
    stamps = np.array([s.time_s for s in sightings]) - vehicle.camera_time_offset_s
    return PadObservations(
        stamps,
        np.array(rotations).reshape(-1, 3, 3),
        np.array(positions).reshape(-1, 3),
        np.array(covariances).reshape(-1, 6, 6),
    )


def _sightings(
    file: Path, record: FlightRecord, rig: ReplaySetup, camera: CameraConfig, *, gravity_free: bool
) -> tuple[list[PadSighting], str | None]:
    """The log's sightings, or those of its frames, and what there is to tell about that."""
    logged = [event.item for event in record.events if isinstance(event.item, PadSighting)]
    if gravity_free and camera == rig.camera:
        return logged, None
    eye = GravityFreePadDetector(rig.pad, camera, rig.vehicle, rig.config.sense.vision)
    again, count = [], 0
    for frame in frames_of(file):
        count += 1
        try:
            seen = eye.look(frame)
        except ValueError as error:
            raise ConfigError(f"{file}: {error}") from error
        if seen is not None:
            again.append(seen)
    if count:
        return again, f"looked again at the log's {count} frames, without gravity: the pad is in {len(again)}"
    if camera != rig.camera:
        raise ConfigError(
            f"{file}: holds no frames to look at through another lens; expected it without --camera"
        )
    return (
        logged,
        "the log holds no frames: its sightings are used, which had gravity by the old mounting in them",
    )


def _calibrated(settings: Mapping[str, Any], file: Path) -> InertialCalibration | None:
    if INERTIAL not in settings:
        return None
    return validate(InertialCalibration, settings[INERTIAL], f"{file}: settings: {INERTIAL}")


def frames_of(file: Path) -> Iterator[Frame]:
    """The frames of a log, with their stamps on the log's monotonic clock.

    An image's stamp in the log is UTC; a frame's report, which is written the moment it is made, says by how
    much the two differ.
    """
    reader = LogReader(file)
    reports = (message for topic, message in reader.messages() if topic == "frame_report")
    if (report := next(reports, None)) is None:
        return
    start_unix_s = 1e-9 * report.log_time - float(reader.content("frame_report", report)["done_s"])
    images = (message for topic, message in reader.messages() if topic == "camera")
    for number, message in enumerate(images):
        image = reader.content("camera", message)
        stamp = image["timestamp"]
        time_s = stamp["sec"] - start_unix_s + 1e-9 * stamp["nsec"]
        data = np.frombuffer(base64.b64decode(image["data"]), dtype=np.uint8)
        grey = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
        if grey is not None:
            yield Frame(time_s, time_s, number, np.asarray(grey, dtype=np.uint8))


# ---------------------------------------------------------------- samples
# Body axes are FRD; camera axes OpenCV's; the pad's frame has x along its heading, y to its right, z down.
# Times are seconds of the recording's clock: a sighting's is its frame's stamp (plus its rows' share of the
# readout); the calibration finds its time offset.

LONGEST_IMU_GAP_S = 0.05
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class ImuSamples:
    """Inertial samples: times (n,), rates (n, 3) rad/s, specific forces (n, 3) m/s², temperatures (n,) °C."""

    time_s: FloatArray
    rate: FloatArray
    force: FloatArray
    temperature_c: FloatArray

    @classmethod
    def of(cls, rows: FloatArray) -> ImuSamples:
        """By rows (n, 8) in that order."""
        return cls(rows[:, 0], rows[:, 1:4], rows[:, 4:7], rows[:, 7])

    def turned(self, matrix: FloatArray) -> ImuSamples:
        """From body into sensor axes, by `matrix` (3, 3), which turns the other way."""
        return replace(self, rate=self.rate @ matrix, force=self.force @ matrix)

    @property
    def period_s(self) -> float:
        """The usual time from one sample to the next."""
        return float(np.median(np.diff(self.time_s)))

    def gaps(self) -> FloatArray:
        """Segments (k, 2) without samples, from and to (s)."""
        wide = np.flatnonzero(np.diff(self.time_s) > LONGEST_IMU_GAP_S)
        return np.column_stack((self.time_s[wide], self.time_s[wide + 1]))


def rows_of(samples: Iterable[ImuSample]) -> FloatArray:
    """Samples as rows (n, 8): time, rate, specific force, temperature."""
    return np.array(
        [(s.time_s, *s.rate_body_rad_s, *s.specific_force_body_m_s2, s.temperature_c) for s in samples]
    ).reshape(-1, 8)


def usable(rows: FloatArray) -> FloatArray:
    """Those of rows (n, 7 or more) whose time, rate and force are numbers, each later than the one before."""
    rows = rows[np.isfinite(rows[:, :7]).all(axis=1)]
    return rows[np.diff(rows[:, 0], prepend=-np.inf) > 0.0]


@dataclass(frozen=True, slots=True)
class PadObservations:
    """The pad in camera axes: stamps (k,), rotations (k, 3, 3) of pad into camera axes, positions (k, 3) m.

    `covariance` (k, 6, 6) is that of position, then of a small rotation about the camera's axes.
    """

    time_s: FloatArray
    camera_from_pad: FloatArray
    position_m: FloatArray
    covariance: FloatArray

    def __len__(self) -> int:
        return len(self.time_s)

    def taken(self, which: Indices | Mask) -> PadObservations:
        """Some of them: a mask or indices."""
        return replace(
            self,
            time_s=self.time_s[which],
            camera_from_pad=self.camera_from_pad[which],
            position_m=self.position_m[which],
            covariance=self.covariance[which],
        )


# ---------------------------------------------------------------- pad detector
# Pad detection for the mount calibration: the app's detector and pose estimation, without gravity.
#
# In flight, the pose uses the gravity direction, through the camera mounting that is the unknown here: an
# error of the mounting would confirm itself. So a pose here uses the corners only. It may then be the second
# solution of the planar pose; the solver rejects those.
#
# The search region follows from the last sighting. Without one, the whole frame is searched for all markers,
# which takes longer.

# how far the pad may have moved since the last sighting, of its distance
STRAYED: Final = 0.06
# a vehicle in the hands is moved more quickly than it flies
HAND_SPEED_M_S: Final = 1.0
HAND_RATE_RAD_S: Final = 1.0


class GravityFreePadDetector:
    """One frame in, one sighting out, in body axes by the vehicle's settings (time offset not applied)."""

    def __init__(self, pad: Pad, camera: CameraConfig, vehicle: VehicleConfig, config: VisionConfig) -> None:
        by_hand = {"relative_speed_std_m_s": HAND_SPEED_M_S, "turn_rate_std_rad_s": HAND_RATE_RAD_S}
        self._camera, self._config = camera, config.model_copy(update=by_hand)
        self._lens = Lens(camera)
        self._planner = SearchPlanner(pad, self._lens, config)
        self._detector = PadDetector(pad, config, self._lens)
        self._rotation = matrix_from_quat(body_from_camera(vehicle))
        self._mount = np.array(vehicle.camera_position_body_m)
        self._last: PoseFit | None = None

    def look(self, frame: Frame) -> PadSighting | None:
        """Find the pad.

        Raises:
            ValueError: the image is not of the calibrated camera's size.
        """
        self._lens.check(frame.image)
        for look in (*self._expected(), *self._planner.whole_frame(1), *self._planner.whole_frame(0)):
            found = self._detector.detect(frame.image, look)
            pose = estimate_pose(found, self._lens, self._config, None) if found else None
            if pose is not None:
                self._last = pose
                return sighting_of(frame, pose, self._camera, self._rotation, self._mount)
        self._last = None
        return None

    def _expected(self) -> tuple[SearchPass, ...]:
        if self._last is None:
            return ()
        position: FloatArray = self._last.position_camera_m
        strayed_m = STRAYED * float(np.linalg.norm(position))
        return self._planner.expected(self._last.camera_from_pad, position, strayed_m)
