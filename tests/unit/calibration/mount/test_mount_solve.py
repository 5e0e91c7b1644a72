"""`calibrate-mount camera`: what it finds in made-up recordings, and what it refuses."""

import math
import re
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.typing import ArrayLike

from calibration.mount.model import (
    ACCEL_MATRIX,
    GYRO_BIAS,
    GYRO_MATRIX,
    OFFSET,
    POSITION,
    MountPrior,
    exp,
    log,
    nearest_rotation,
)
from calibration.mount.recording import ImuSamples, PadObservations
from calibration.mount.result import camera_angles_deg, reasons
from calibration.mount.solver import MountSolution, NoSolutionError, correlate, solve
from companion.base.geometry import GRAVITY_M_S2, FloatArray, matrix_from_quat, quat_from_euler
from companion.base.messages import Frame
from companion.config import VehicleConfig, find_file, load_model
from companion.sense.camera.source import at_exposure
from companion.sense.vision.pipeline import body_from_camera
from sitl.camera.camera import body_from_camera as simulated_body_from_camera

H = 1e-4


@dataclass(frozen=True)
class Flaws:
    """What is wrong with the recording; standard deviations where the seed draws."""

    angles_deg: tuple[float, float, float] = (2.0, -3.0, 4.0)  # of the mount: roll, tilt, yaw
    time_offset_s: float = 0.02
    position_m: tuple[float, float, float] = (0.03, 0.0, 0.08)
    gyro_cross: float = 0.0
    accel_cross: float = 0.0
    gyro_bias_rad_s: float = 0.01
    accel_bias_m_s2: float = 0.05
    pad_tilt_deg: float = 0.5
    pixel_noise: float = 1.0  # the sightings' noise, of what they say
    flipped: float = 0.0  # share
    swing_deg: tuple[float, float, float] = (15.0, 15.0, 25.0)
    swing_m: float = 0.25


@dataclass
class MountTrack:
    """One recording; `body_from_camera` is the truth."""

    seed: int
    flaws: Flaws = field(default_factory=Flaws)
    seconds: float = 60.0

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        flaws = self.flaws
        roll, tilt, yaw = (math.radians(a) for a in flaws.angles_deg)
        downward = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        self.body_from_camera = matrix_from_quat(quat_from_euler(roll, tilt, yaw)) @ downward
        self._waves = [
            (self.rng.uniform(0.2, 0.9, 3), self.rng.uniform(0.0, 2.0 * math.pi, 3)) for _ in range(6)
        ]
        pad_tilt = math.radians(flaws.pad_tilt_deg) * self.rng.standard_normal(2)
        self.pad_in_world = exp(np.array([pad_tilt[0], pad_tilt[1], 0.3]))

    def _wave(self, k: int, t: FloatArray) -> FloatArray:
        speeds, phases = self._waves[k]
        return np.asarray(np.sin(2.0 * math.pi * speeds * t[:, None] + phases).mean(axis=1) * 1.4)

    def attitude(self, t: FloatArray) -> FloatArray:
        """World from body (k, 3, 3)."""
        roll, pitch, yaw = (math.radians(a) * self._wave(k, t) for k, a in enumerate(self.flaws.swing_deg))
        zero = np.zeros_like(roll)
        about = [np.stack(v, axis=1) for v in ((zero, zero, yaw), (zero, pitch, zero), (roll, zero, zero))]
        return exp(about[0]) @ exp(about[1]) @ exp(about[2])

    def position(self, t: FloatArray) -> FloatArray:
        """World position (k, 3), NED about the pad."""
        swing = np.stack([self._wave(3 + k, t) for k in range(3)], axis=1) * self.flaws.swing_m
        return np.asarray(swing + np.array([0.0, 0.0, -1.2]))

    def inertial(self, rate_hz: float = 200.0) -> ImuSamples:
        """What the IMU says."""
        flaws, rng = self.flaws, self.rng
        t = np.arange(-1.0, self.seconds + 1.0, 1.0 / rate_hz)
        attitude = self.attitude(t)
        rate = log(self.attitude(t - H).mT @ self.attitude(t + H)) / (2.0 * H)
        bend = (self.position(t - H) - 2.0 * self.position(t) + self.position(t + H)) / H**2
        bend[:, 2] -= GRAVITY_M_S2
        force = (attitude.mT @ bend[..., None])[..., 0]
        gyro = np.eye(3) + flaws.gyro_cross * rng.standard_normal((3, 3))
        accel = np.eye(3) + flaws.accel_cross * rng.standard_normal((3, 3))
        rate = rate @ gyro.T + flaws.gyro_bias_rad_s * rng.standard_normal(3)
        force = force @ accel.T + flaws.accel_bias_m_s2 * rng.standard_normal(3)
        rate += math.radians(0.01) * math.sqrt(rate_hz / 2.0) * rng.standard_normal(rate.shape)
        force += 0.003 * math.sqrt(rate_hz / 2.0) * rng.standard_normal(force.shape)
        return ImuSamples(t, rate, force, np.full(len(t), 30.0))

    def sightings(self, rate_hz: float = 30.0) -> PadObservations:
        """What the camera says, with stamps that are off by `-time_offset_s`."""
        flaws, rng = self.flaws, self.rng
        t = np.arange(0.0, self.seconds, 1.0 / rate_hz)
        attitude, world = self.attitude(t), self.position(t)
        camera_from_world = (attitude @ self.body_from_camera).mT
        camera = world + attitude @ np.array(flaws.position_m)
        rotation = camera_from_world @ self.pad_in_world
        place = -(camera_from_world @ camera[..., None])[..., 0]
        sd = np.array([0.002, 0.002, 0.004, 0.006, 0.006, 0.002])
        noise = sd * rng.standard_normal((len(t), 6)) * flaws.pixel_noise
        rotation = exp(noise[:, 3:]) @ rotation
        flips = rng.uniform(size=len(t)) < flaws.flipped
        sight = place / np.linalg.norm(place, axis=1, keepdims=True)
        normal = rotation[..., 2]
        # the other pose of a square tilts the other way from the line of sight
        across = np.cross(normal, sight)
        rotation = np.where(flips[:, None, None], exp(2.0 * across) @ rotation, rotation)
        return PadObservations(
            t - flaws.time_offset_s, rotation, place + noise[:, :3], np.tile(np.diag(sd**2), (len(t), 1, 1))
        )

    def rotation_error_rad(self, body_from_camera: FloatArray) -> FloatArray:
        """The error (3,) of a found rotation about the body's axes."""
        return log(body_from_camera @ self.body_from_camera.T)


# ---------------- `calibrate-mount camera`: what it finds in made-up recordings, and what it refuses

PLACE = np.array([0.03, 0.0, 0.08])
SURE = MountPrior(
    gyro_cross=1e-5, accel_cross=1e-5, gyro_scale=1e-5, accel_scale=1e-5, lens_rad=1e-5, stamp_s=1e-6
)
SECONDS = 16.0


@pytest.fixture(scope="module")
def track() -> MountTrack:
    return MountTrack(3, Flaws(flipped=0.15), SECONDS)


@pytest.fixture(scope="module")
def solution(track: MountTrack) -> MountSolution:
    return solve(track.inertial(), track.sightings(), PLACE, prior=SURE)


def test_rotation_offset_and_place_are_found_among_flipped_poses(
    track: MountTrack, solution: MountSolution
) -> None:
    error = track.rotation_error_rad(solution.unknowns.body_from_camera)
    assert np.degrees(np.linalg.norm(error)) < 0.15
    assert abs(solution.time_offset_s - track.flaws.time_offset_s) < 0.0005
    assert np.linalg.norm(solution.position_m - PLACE) < 0.01
    assert 0.8 < solution.kept.mean() < 0.9  # the flipped ones are out


def test_what_is_stated_is_as_large_as_the_errors(track: MountTrack, solution: MountSolution) -> None:
    error = track.rotation_error_rad(solution.unknowns.body_from_camera)
    assert 0.05 < error @ np.linalg.solve(solution.rotation_covariance, error) < 16.0
    assert abs(solution.time_offset_s - track.flaws.time_offset_s) < 4.0 * solution.time_offset_std_s
    assert (np.abs(solution.position_m - PLACE) < 4.0 * solution.std(POSITION)).all()
    assert solution.scatter == pytest.approx(1.0, abs=0.1)


def test_the_coarse_search_needs_no_guess() -> None:
    backwards = MountTrack(5, Flaws(angles_deg=(170.0, 20.0, -120.0), time_offset_s=-0.08), SECONDS)
    coarse = correlate(backwards.inertial(), backwards.sightings())
    assert abs(coarse.time_offset_s + 0.08) < 0.003
    assert np.degrees(np.linalg.norm(backwards.rotation_error_rad(coarse.body_from_camera))) < 2.0


def test_gaps_in_the_inertial_samples_are_left_out(track: MountTrack) -> None:
    inertial = track.inertial()
    inside = (inertial.time_s < 5.0) | (inertial.time_s > 5.4)
    holed = replace(
        inertial,
        time_s=inertial.time_s[inside],
        rate=inertial.rate[inside],
        force=inertial.force[inside],
        temperature_c=inertial.temperature_c[inside],
    )
    found = solve(holed, track.sightings(), PLACE, prior=SURE)
    assert found.segments < SECONDS / 2.0
    assert abs(found.time_offset_s - track.flaws.time_offset_s) < 0.0005


def test_no_sightings_are_reported() -> None:
    short = MountTrack(1, seconds=3.0)
    none = short.sightings().taken(np.zeros(0, dtype=int))
    with pytest.raises(NoSolutionError, match="no sightings"):
        solve(short.inertial(), none, PLACE)
    late: PadObservations = replace(short.sightings(), time_s=short.sightings().time_s + 100.0)
    with pytest.raises(NoSolutionError, match="while inertial samples came"):
        solve(short.inertial(), late, PLACE)


def test_what_no_mount_fits_is_reported() -> None:
    # a track of its own: the noise of a shared one depends on which tests were before
    track = MountTrack(9, Flaws(flipped=0.15), SECONDS)
    backwards = replace(track.inertial(), rate=-track.inertial().rate)
    with pytest.raises(NoSolutionError, match="the time offset ran off to"):
        solve(backwards, track.sightings(), PLACE)
    certain = replace(track.sightings(), covariance=np.zeros_like(track.sightings().covariance))
    with pytest.raises(NoSolutionError, match="no mount fits what was recorded"):
        solve(track.inertial(), certain, PLACE)


# ---------------------------------------------------------------- the verdict


def refused(solution: MountSolution, track: MountTrack, most_deg: float = 10.0) -> str:
    return "; ".join(reasons(solution, track.body_from_camera, PLACE, most_deg))


def with_value(solution: MountSolution, which: slice, values: ArrayLike) -> MountSolution:
    changed = solution.unknowns.values.copy()
    changed[which] = np.asarray(values, dtype=float)
    return replace(solution, unknowns=replace(solution.unknowns, values=changed))


def test_a_good_one_is_not_refused(track: MountTrack, solution: MountSolution) -> None:
    assert refused(solution, track) == ""


def test_each_reason_is_reported(track: MountTrack, solution: MountSolution) -> None:
    few = replace(solution, kept=solution.kept & (np.arange(len(solution.kept)) < 90))
    assert "too little was seen" in refused(few, track)
    assert "contradict the rest" in refused(few, track)
    assert "did not converge" in refused(replace(solution, converged=False), track)
    vague = solution.covariance.copy()
    vague[2, 2], vague[OFFSET, OFFSET] = 0.02**2, 0.005**2
    told = refused(replace(solution, covariance=vague), track)
    assert "rotation about down is known to 1.1" in told
    assert "roll it and dip the nose more" in told
    assert "time offset is known to 5.0 ms only" in told
    assert "another" not in told
    assert "sightings miss by 6.0" in refused(replace(solution, scatter=6.0), track)
    honest = replace(solution, prior=MountPrior())
    assert "gyroscope disagree by +4.0 %" in refused(
        with_value(honest, GYRO_MATRIX, np.eye(3).ravel() * 0.04), track
    )
    assert "accelerometer disagree" in refused(
        with_value(honest, ACCEL_MATRIX, np.eye(3).ravel() * 0.04), track
    )
    assert "off by 20°/s" in refused(with_value(solution, GYRO_BIAS, (0.35, 0.0, 0.0)), track)
    assert "no time offset" in refused(with_value(solution, OFFSET, 0.3), track)
    assert "the camera is 20 cm from" in refused(
        with_value(solution, POSITION, PLACE + 0.2 * np.eye(3)[0]), track
    )


def test_a_camera_turned_far_from_the_settings_is_refused(track: MountTrack, solution: MountSolution) -> None:
    elsewhere = exp(np.array([0.0, 0.0, 0.3])) @ track.body_from_camera
    told = reasons(solution, elsewhere, PLACE, 10.0)
    assert any("turned by 17." in line and "from where the settings have it" in line for line in told)
    assert not reasons(solution, elsewhere, PLACE, 20.0)


@pytest.mark.parametrize("share", [0.5, 0.65])
def test_a_camera_that_slipped_meanwhile_is_refused(track: MountTrack, share: float) -> None:
    seen = track.sightings()
    turn = exp(np.array([0.06, 0.0, 0.0]))
    later = seen.time_s > share * SECONDS
    slipped = replace(
        seen,
        camera_from_pad=np.where(later[:, None, None], turn @ seen.camera_from_pad, seen.camera_from_pad),
        position_m=np.where(later[:, None], seen.position_m @ turn.T, seen.position_m),
    )
    told = refused(solve(track.inertial(), slipped, PLACE), track)
    assert "did the camera or the pad slip meanwhile?" in told


def test_stamps_that_change_meanwhile_are_refused(track: MountTrack) -> None:
    seen = track.sightings()
    changed = replace(seen, time_s=seen.time_s + 0.01 * (seen.time_s > 0.5 * SECONDS))
    told = refused(solve(track.inertial(), changed, PLACE), track)
    # of the 10 ms, since what no longer fits is left out
    assert re.search(r"the time offset changed by -(7|8|9|10) ms meanwhile", told)


def test_a_still_recording_is_refused() -> None:
    still = MountTrack(2, Flaws(swing_deg=(0.05, 0.05, 0.05), swing_m=0.002), 8.0)
    found = solve(still.inertial(), still.sightings(), PLACE)
    told = "; ".join(reasons(found, still.body_from_camera, PLACE, 10.0))
    assert "too little motion" in told
    assert "too slow a motion" in told


# ---------------------------------------------------------------- rotations


def test_exponential_and_logarithm_undo_one_another() -> None:
    vectors = np.random.default_rng(0).normal(size=(50, 3))
    vectors[0] = 0.0
    vectors[1] *= 1e-9
    assert log(exp(vectors)) == pytest.approx(vectors, abs=1e-9)
    turn = exp(np.array([0.3, -0.2, 1.0]))
    assert nearest_rotation(turn @ np.diag((1.1, 0.9, 1.0)) @ np.eye(3)) @ turn.T == pytest.approx(
        np.eye(3), abs=0.1
    )


# ---------------- What the app makes of the angles and stamps of a mount


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (5.0, -3.0, 20.0), (-30.0, 20.0, 170.0)])
def test_the_angles_mean_the_same_to_the_app_and_to_the_simulator(angles: tuple[float, float, float]) -> None:
    roll, tilt, yaw = angles
    vehicle = load_model(VehicleConfig, find_file("vehicles", "x500")).model_copy(
        update={"camera_roll_deg": roll, "camera_tilt_deg": tilt, "camera_yaw_deg": yaw}
    )
    ours = matrix_from_quat(body_from_camera(vehicle))
    theirs = simulated_body_from_camera(math.radians(yaw), math.radians(tilt), math.radians(roll))
    assert ours == pytest.approx(theirs, abs=1e-12)
    assert camera_angles_deg(ours) == pytest.approx(angles, abs=1e-9)


def test_a_rolled_camera_looks_to_the_left() -> None:
    assert simulated_body_from_camera(0.0, 0.0, 0.3)[1, 2] < 0.0


def test_late_stamps_are_set_back_by_a_negative_offset() -> None:
    frame = Frame(10.02, 10.05, 1, np.zeros((2, 2), np.uint8))
    assert at_exposure(frame, -0.02).time_s == pytest.approx(10.0)
    assert at_exposure(frame, 0.0) is frame
