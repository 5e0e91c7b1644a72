"""Accelerometer and gyroscope by rests: the fit, the faces, the mounting, tables, and the driver's use."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration.clipping import clipped_axes
from calibration.mount import FACES
from calibration.mount.imu_calibration import accelerometer_calibration, gyro_calibration, mounting_line
from calibration.mount.recording import ImuSamples
from calibration.mount.six_faces import (
    FaceGuide,
    StaticInterval,
    accelerometer_reasons,
    face_of,
    faces_down,
    find_static_intervals,
    fit_accelerometer,
    fit_gyro,
    fitting_mountings,
    gyro_reasons,
)
from calibration.mount.table import canonical, read_table
from companion.base.geometry import GRAVITY_M_S2, FloatArray
from companion.config import ConfigError, ImuConfig, InertialCalibration, SenseConfig, load_inertial
from companion.config.calibration import Provenance
from companion.sense.imu.mounting import body_axes, mounting_matrix
from tests.unit.sense.imu.imu_rig import ImuRig

USUAL = (180.0, 0.0, 0.0)
OFFSET = np.array([0.4, -0.3, 0.5])
FLAW = np.array([[1.02, 0.01, 0.0], [0.004, 0.98, -0.01], [0.0, 0.008, 1.01]])
BIAS = np.array([0.02, -0.05, 0.01])


def lying(
    mounting_deg: tuple[float, float, float] = USUAL,
    faces: tuple[str, ...] = tuple(FACES),
    seconds: float = 4.0,
    seed: int = 0,
) -> ImuSamples:
    """Rests on faces (none quite straight), with a lively move before each; sensor axes."""
    rng = np.random.default_rng(seed)
    turn_back = mounting_matrix(mounting_deg).T
    forces, rates = [], []
    for face in faces:
        down = np.array(FACES[face]) + 0.03 * rng.standard_normal(3)
        rest = turn_back @ (-GRAVITY_M_S2 * down / np.linalg.norm(down))
        n = round(200 * seconds)
        forces += [rest + 4.0 * rng.standard_normal((200, 3)), rest + 0.03 * rng.standard_normal((n, 3))]
        rates += [rng.standard_normal((200, 3)), 0.001 * rng.standard_normal((n, 3))]
    force = np.concatenate(forces) @ FLAW.T + OFFSET
    rate = np.concatenate(rates) + BIAS
    return ImuSamples(np.arange(len(force)) / 200.0, rate, force, np.full(len(force), 31.0))


def calibration_of(rests: list[StaticInterval]) -> InertialCalibration:
    return InertialCalibration(
        accelerometer=accelerometer_calibration(fit_accelerometer(rests), ["level"]),
        gyro=gyro_calibration(fit_gyro(rests)),
        provenance=Provenance(tool="t", source="s", date="d", samples=1),
    )


def test_rests_are_found_between_moves() -> None:
    rests = find_static_intervals(lying())
    assert len(rests) == 6
    assert all(3.0 < rest.to_s - rest.from_s < 4.0 for rest in rests)
    assert faces_down(rests, mounting_matrix(USUAL)) == list(FACES)


def test_a_slow_tilt_without_a_jolt_makes_two_rests() -> None:
    one = lying(faces=("level",), seconds=6.0)
    step = replace(one, force=one.force + np.where(one.time_s > 4.0, 0.5, 0.0)[:, None])
    assert len(find_static_intervals(step)) == 2


def test_six_faces_give_offset_scale_and_bias() -> None:
    rests = find_static_intervals(lying())
    fit, gyro = fit_accelerometer(rests), fit_gyro(rests)
    assert fit.offset == pytest.approx(OFFSET, abs=0.02)
    assert np.diag(fit.matrix @ FLAW) == pytest.approx(np.ones(3), abs=0.004)
    assert (np.abs(fit.offset - OFFSET) < 4.0 * fit.offset_std).all()
    assert float(np.abs(fit.residuals).max()) < 0.01 < float(np.abs(fit.raw_residuals).max())
    assert np.array_equal(fit.matrix, fit.matrix.T)  # it turns nothing
    assert gyro.bias == pytest.approx(BIAS, abs=2e-4)
    assert gyro.temperature_c == pytest.approx(31.0)
    assert accelerometer_reasons(fit, rests, list(FACES)) == ()


@pytest.mark.parametrize("mounting", [USUAL, (0.0, 0.0, 90.0)])
def test_an_axis_at_the_end_of_its_range_is_refused(mounting: tuple[float, float, float]) -> None:
    """GIVEN a z axis that reads 9 m/s² at most, WHEN it lies on all faces, THEN axis and value are told."""
    turn = mounting_matrix(mounting)
    samples = lying(mounting)
    within = replace(samples, force=np.clip(samples.force, (-99.0, -99.0, -9.0), (99.0, 99.0, 9.0)))
    # as a recording in body axes is read
    rests = find_static_intervals(replace(within, force=within.force @ turn.T).turned(turn))
    told = accelerometer_reasons(fit_accelerometer(rests), rests, faces_down(rests, turn))
    assert sorted(line.split(" from ")[0] for line in told) == [
        f"the z axis reads {value} m/s² and no more" for value in ("-9.00", "9.00")
    ]
    assert all("; expected its noise, within its range (too small a range" in line for line in told)


@pytest.mark.parametrize("noise_steps", [0.05, 0.2, 0.3])
def test_a_quiet_sensor_with_coarse_steps_is_within_its_range(noise_steps: float) -> None:
    rng, down = np.random.default_rng(0), np.array([0.01, -0.02, -9.8])
    for _ in range(200):
        force = down + rng.uniform(-0.1, 0.1, 3) + 0.0024 * noise_steps * rng.standard_normal((700, 3))
        coarse = 0.0024 * np.round(force / 0.0024)
        assert clipped_axes(coarse, np.vstack((coarse, -coarse))) == ()


def test_more_attitudes_give_the_skew() -> None:
    rng = np.random.default_rng(4)
    down = rng.standard_normal((40, 3))
    forces = -GRAVITY_M_S2 * down / np.linalg.norm(down, axis=1)[:, None] @ FLAW.T + OFFSET
    rests = [
        StaticInterval(force, BIAS, 30.0, 500, float(k), float(k) + 2.0) for k, force in enumerate(forces)
    ]
    fit = fit_accelerometer(rests)
    seen: FloatArray = fit.matrix @ FLAW
    assert seen.T @ seen == pytest.approx(np.eye(3), abs=0.002)


def test_what_is_not_good_enough_is_reported() -> None:
    rests = find_static_intervals(lying(faces=("level", "nose-down", "nose-up")))
    fit = fit_accelerometer(rests)
    told = accelerometer_reasons(fit, rests, faces_down(rests, mounting_matrix(USUAL)))
    assert "never lay still on: upside-down, right-down, left-down" in told[0]
    assert (
        "do not agree"
        in accelerometer_reasons(replace(fit, residuals=fit.residuals + 0.2), rests, list(FACES))[0]
    )
    assert (
        "offset of 2.00"
        in accelerometer_reasons(replace(fit, offset=np.array([2.0, 0, 0])), rests, list(FACES))[0]
    )
    scaled = replace(fit, matrix=np.eye(3) * 2.0)
    assert "a scale of 2.000" in accelerometer_reasons(scaled, rests, list(FACES))[0]
    gyro = fit_gyro(rests)
    assert "changed by 0.57°/s" in gyro_reasons(replace(gyro, std=0.01), rests)[0]
    assert "a bias of 57°/s" in gyro_reasons(replace(gyro, bias=np.array([1.0, 0, 0])), rests)[0]
    warmed = [rests[0], replace(rests[1], temperature_c=45.0)]
    assert "it warmed by 14 °C" in gyro_reasons(gyro, warmed)[0]


# ---------------------------------------------------------------- which way it is mounted


@pytest.mark.parametrize("mounting", [(180.0, 0.0, 90.0), (0.0, 0.0, 0.0), (-90.0, 0.0, 180.0)])
def test_a_wrong_mounting_is_named(mounting: tuple[float, float, float]) -> None:
    rests = find_static_intervals(lying(mounting))
    fitting = fitting_mountings(list(FACES), rests)
    assert len(fitting) == 1
    assert mounting_matrix(fitting[0]) == pytest.approx(mounting_matrix(mounting), abs=1e-9)
    assert mounting_line(list(FACES), rests, mounting) is None
    told = mounting_line(list(FACES), rests, USUAL)
    assert told is not None
    assert told.startswith("sense.imu.body_from_sensor_deg is [180, 0, 0]; what was asked and felt fits [")


def test_faces_laid_down_in_another_order_say_nothing_of_the_mounting() -> None:
    rests = find_static_intervals(lying())
    swapped = [rests[1], rests[0], *rests[2:]]
    assert fitting_mountings(list(FACES), swapped) == []
    assert mounting_line(list(FACES), swapped, USUAL) is None


def test_an_edge_is_no_face() -> None:
    assert face_of(np.array([5.0, 5.0, 5.0]), np.eye(3)) is None


def test_the_guide_asks_for_all_six_and_tells_what_it_feels() -> None:
    guide = FaceGuide(mounting_matrix(USUAL))
    samples = lying(
        faces=("level", "nose-down", "upside-down", "nose-up", "right-down", "left-down"), seconds=5.0
    )
    assert guide.advice.startswith("1 of 6: lay it down level")
    told = [guide.take(cut(samples, guide.after_s)) for _ in range(8)]
    assert guide.done
    assert told[0] == "level: taken"
    assert told[1] == "taken, but the sensor feels nose-down where upside-down was asked"
    assert [line for line in told if line is None] == [None, None]
    assert guide.asked == list(FACES)


def cut(samples: ImuSamples, from_s: float) -> ImuSamples:
    later = samples.time_s >= from_s
    return ImuSamples(
        samples.time_s[later], samples.rate[later], samples.force[later], samples.temperature_c[later]
    )


# ---------------------------------------------------------------- tables


@pytest.mark.parametrize(
    ("word", "name"),
    [
        *(("time_us", "t"), ("Timestamp", "t"), ("ax", "ax"), ("accX", "ax"), ("Accel Y (g)", "ay")),
        *(("acc_z", "az"), ("gyro_y (deg/s)", "gy"), ("GyrZ", "gz"), ("temperature", "-"), ("mag_x", "-")),
    ],
)
def test_columns_are_known_by_many_names(word: str, name: str) -> None:
    assert canonical(word) == name


def test_a_table_in_g_and_degrees_is_read(tmp_path: Path) -> None:
    samples = lying(faces=("level",))
    rows = np.column_stack((samples.time_s * 1e3, samples.force / GRAVITY_M_S2, np.degrees(samples.rate)))
    path = tmp_path / "rests.csv"
    header = "time_ms;Accel X;Accel Y;Accel Z;Gyro X (deg/s);Gyro Y (deg/s);Gyro Z (deg/s)"
    lines = [";".join(f"{value:.9g}" for value in row) for row in rows]
    path.write_text("\n".join(["# a logger", header, *lines, "1;2;three"]))
    read = read_table(path, None, None, None)
    assert read.force == pytest.approx(samples.force, abs=1e-6)
    assert read.rate == pytest.approx(samples.rate, abs=1e-6)
    assert read.time_s == pytest.approx(samples.time_s, abs=1e-6)


def test_a_table_without_names_or_times_needs_options(tmp_path: Path) -> None:
    samples = lying(faces=("level",))
    path = tmp_path / "bare.csv"
    np.savetxt(path, np.column_stack((samples.force, samples.rate)), delimiter=",")
    with pytest.raises(ConfigError, match="no column for ax"):
        read_table(path, None, 200.0, None)
    with pytest.raises(ConfigError, match="expected one named t or time, or --rate"):
        read_table(path, "ax,ay,az,gx,gy,gz", None, None)
    read = read_table(path, "ax,ay,az,gx,gy,gz", 200.0, None)
    assert read.force == pytest.approx(samples.force)
    archive = tmp_path / "trial.npz"
    np.savez(archive, acc=samples.force, gyr=samples.rate, fs=200.0)
    assert read_table(archive, None, None, None).rate == pytest.approx(samples.rate)
    with pytest.raises(ConfigError, match="cannot be read"):
        read_table(tmp_path / "absent.csv", None, None, None)


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6, 1e9])
def test_a_time_s_unit_shows_in_its_steps(tmp_path: Path, unit: float) -> None:
    samples = lying(faces=("level",))
    path = tmp_path / "rests.csv"
    rows = np.column_stack((samples.time_s * unit, samples.force, samples.rate))
    np.savetxt(path, rows, delimiter=",", header="timestamp,ax,ay,az,gx,gy,gz", comments="", fmt="%.9f")
    assert read_table(path, None, None, None).period_s == pytest.approx(0.005, rel=1e-6)


def test_archives_are_read_or_reported_in_one_line(tmp_path: Path) -> None:
    samples = lying(faces=("level",))
    force, rate, t = samples.force, samples.rate, samples.time_s
    apart = {f"a{axis}": force[:, k] for k, axis in enumerate("xyz")}
    apart |= {f"g{axis}": rate[:, k] for k, axis in enumerate("xyz")}
    good: list[dict[str, FloatArray]] = [
        {"acc": force.T, "gyr": rate.T, "fs": np.array([200.0])},
        {**apart, "t": t},
    ]
    path = tmp_path / "rests.npz"
    for arrays in good:
        np.savez(path, allow_pickle=False, **arrays)
        assert read_table(path, None, None, None).force == pytest.approx(force)
    for arrays in ({"acc": force, "gyr": rate[:-5], "t": t}, {"acc": force[:, :2], "gyr": rate, "t": t}):
        np.savez(path, allow_pickle=False, **arrays)
        with pytest.raises(ConfigError, match=r"columns of different lengths|no column for ax"):
            read_table(path, None, None, None)
    for content in (b"", b"PK\x03\x04 and then nothing", b"text"):
        path.write_bytes(content)
        with pytest.raises(ConfigError, match=r"rests.npz: cannot be read"):
            read_table(path, None, None, None)


# ---------------------------------------------------------------- in the driver


def test_the_driver_s_matrix_is_the_file_s_in_sensor_axes() -> None:
    mounting = (180.0, 0.0, 90.0)
    inertial = calibration_of(find_static_intervals(lying()))
    assert inertial.accelerometer is not None
    counts = (1000.0, -2000.0, 3000.0)
    a = inertial.accelerometer
    accel = body_axes(mounting, 0.002).corrected(a.matrix, a.offset_m_s2)
    gyro = body_axes(mounting, 0.001).corrected(None, inertial.gyro.bias_rad_s)
    true = mounting_matrix(mounting) @ np.array(a.matrix) @ (0.002 * np.array(counts) - a.offset_m_s2)
    assert np.array(accel.of(*counts)) == pytest.approx(true)
    rate = mounting_matrix(mounting) @ (0.001 * np.array(counts) - inertial.gyro.bias_rad_s)
    assert np.array(gyro.of(*counts)) == pytest.approx(rate)


def test_the_driver_takes_the_file_of_the_settings(tmp_path: Path) -> None:
    path = tmp_path / "inertial.yaml"
    content = calibration_of(find_static_intervals(lying())).model_copy(
        update={
            "gyro": gyro_calibration(
                replace(fit_gyro(find_static_intervals(lying())), bias=np.array([0.0, 0.0, 0.3]))
            )
        }
    )
    path.write_text(yaml.safe_dump(content.model_dump(mode="json")))
    plain, named = ImuRig(ImuConfig()), ImuRig(ImuConfig(inertial_calibration=str(path)))
    for rig in (plain, named):
        rig.run(1.0)
    before, after = plain.imu[-1], named.imu[-1]
    # face up, z up: a rate of the chip about its z is one of the body's the other way round
    assert after.rate_body_rad_s[2] - before.rate_body_rad_s[2] == pytest.approx(0.3, abs=1e-3)
    assert math.dist(after.specific_force_body_m_s2, before.specific_force_body_m_s2) > 0.3


def test_a_wrong_file_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "inertial.yaml"
    path.write_text("kind: mount\n")
    imu = ImuConfig(inertial_calibration=str(path))
    with pytest.raises(
        ConfigError, match=r"sense.imu.inertial_calibration: .*is of kind 'mount'; expected 'inertial'"
    ):
        load_inertial(SenseConfig(imu=imu))
    assert load_inertial(SenseConfig(imu=imu, source="autopilot")) is None  # it is not that one's
