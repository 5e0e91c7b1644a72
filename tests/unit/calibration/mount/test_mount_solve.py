"""`calibrate-mount camera`: what it finds in made-up recordings, and what it refuses."""

from __future__ import annotations

import re
from dataclasses import replace

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
from calibration.mount.recording import PadObservations
from calibration.mount.result import reasons
from calibration.mount.solver import MountSolution, NoSolutionError, correlate, solve
from tests.unit.calibration.mount.mount_track import Flaws, MountTrack

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
