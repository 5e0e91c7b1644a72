"""`calibrate-magnetometer` end to end from files: what it writes, what it refuses, what it tells."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration.magnetometer import job
from companion.base.geometry import FloatArray
from companion.base.magnetic_field import field_ned_ut
from companion.config import ConfigError, load_model
from companion.config.magnetometer import MagnetometerCalibration
from tests.programs import ProgramHere, exit_code
from tests.unit.calibration.magnetometer.magnetometer_truth import FIELD_UT, turned

CASE = turned(11, samples=1500)
ZURICH = "47.4,8.55,430"
calibrate = partial(exit_code, "calibrate-magnetometer")


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def csv(name: str, raw: FloatArray, force: FloatArray | None = None) -> str:
    heading, rows = ("mx,my,mz", raw) if force is None else ("mx,my,mz,ax,ay,az", np.hstack([raw, force]))
    np.savetxt(name, rows, delimiter=",", header=heading, comments="", fmt="%.4f")
    return name


def test_a_recording_becomes_a_file_a_picture_and_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    source = csv("turns.csv", CASE.raw, CASE.force)
    assert calibrate(source, "--position", ZURICH, "--date", "2026-05-01", "--sensor", "mpu9250") == 0
    shown = capsys.readouterr().out
    assert "World Magnetic Model 2026.3, --position" in shown
    assert "residual" in shown
    file = load_model(MagnetometerCalibration, Path("magnetometer.yaml"))
    strength = float(np.linalg.norm(field_ned_ut(47.4, 8.55, 430.0, 2026.33)))
    assert file.field_strength == pytest.approx(strength, rel=1e-5)
    assert (file.sensor, file.axes, file.raw_unit, file.calibrated_unit) == ("mpu9250", "sensor", "uT", "uT")
    assert np.linalg.norm(np.array(file.hard_iron) - CASE.centre) < 0.015 * FIELD_UT
    assert np.linalg.norm(file.apply(CASE.raw), axis=1).mean() == pytest.approx(strength, rel=3e-3)
    assert file.provenance.samples + file.provenance.dropped == 1500
    assert file.provenance.date.endswith("+00:00")  # as camera and mount have it
    assert file.quality.verdict == "usable"
    assert Path("magnetometer.png").stat().st_size > 20_000
    # the same samples give the same file, but for the date
    first = Path("magnetometer.yaml").read_text()
    assert (
        calibrate(source, "--position", ZURICH, "--date", "2026-05-01", "--sensor", "mpu9250", "--no-plot")
        == 0
    )
    again = yaml.safe_load(Path("magnetometer.yaml").read_text())
    again["provenance"]["date"] = file.provenance.date
    assert again == yaml.safe_load(first)


def test_the_settings_field_serves_where_they_say_it(capsys: pytest.CaptureFixture[str]) -> None:
    Path("mine.yaml").write_text("estimate:\n  magnetic_field_ned_ut: [21.0, 1.0, 43.0]\n")
    assert calibrate(csv("a.csv", CASE.raw), "--config", "mine.yaml", "--no-plot") == 0
    assert "estimate.magnetic_field_ned_ut of mine.yaml" in capsys.readouterr().out


def test_a_bad_one_is_refused_and_nothing_is_written(capsys: pytest.CaptureFixture[str]) -> None:
    noisy = CASE.raw + np.random.default_rng(0).normal(0.0, 12.0, CASE.raw.shape)
    source = csv("a.csv", noisy)
    assert calibrate(source, "--no-plot") == 1
    told = capsys.readouterr().err
    assert told.startswith("calibrate-magnetometer: refused: a.csv: ")
    assert told.count("\n") == 1
    assert not Path("magnetometer.yaml").exists()
    assert calibrate(source, "--no-plot", "--force") == 0
    file = load_model(MagnetometerCalibration, Path("magnetometer.yaml"))
    assert file.quality.verdict == "refused"
    assert file.quality.forced


def test_each_reason_of_a_refusal_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    part = CASE.raw[CASE.raw[:, 2] > np.quantile(CASE.raw[:, 2], 0.9)]
    noisy = part + np.random.default_rng(0).normal(0.0, 3.0, part.shape)
    assert calibrate(csv("part.csv", noisy), "--no-plot") == 1
    said = capsys.readouterr()
    for reason in ("of the sphere is covered", "hard iron is known to"):
        assert (said.out + said.err).count(reason) == said.err.count(reason) == 1


def test_a_plane_is_refused_even_by_force(capsys: pytest.CaptureFixture[str]) -> None:
    flat = CASE.raw * (1.0, 1.0, 0.0)
    assert calibrate(csv("flat.csv", flat), "--force") == 1
    refusal = capsys.readouterr().err
    assert "in a plane" in refusal
    assert "--force has nothing to write" in refusal
    assert not Path("magnetometer.yaml").exists()


def test_an_old_file_stays_when_the_new_one_is_refused() -> None:
    Path("magnetometer.yaml").write_text("old")
    assert calibrate(csv("flat.csv", CASE.raw * (1.0, 1.0, 0.0))) == 1
    assert Path("magnetometer.yaml").read_text() == "old"


def test_interrupted_it_leaves_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(job, "write_picture", interrupt)
    assert calibrate(csv("a.csv", CASE.raw)) == 130
    assert "interrupted" in capsys.readouterr().err
    assert sorted(path.name for path in Path().iterdir()) == ["a.csv"]


def test_a_picture_that_cannot_be_written_does_not_cost_the_calibration(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(path: Path, _: object) -> None:
        raise ConfigError(f"{path}: cannot be written: No space left on device")

    monkeypatch.setattr(job, "write_picture", full)
    assert calibrate(csv("a.csv", CASE.raw)) == 2
    assert "magnetometer.png: cannot be written" in capsys.readouterr().err
    assert load_model(MagnetometerCalibration, Path("magnetometer.yaml")).quality.verdict == "usable"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((), "nothing to calibrate: expected RECORDING, --bus, --connect or --config"),
        (("none.csv",), "none.csv: cannot be read: No such file or directory"),
        (("a.csv", "--bus", "i2c:1"), "RECORDING: expected it without --bus"),
        (("--bus", "i2c:1", "--connect", "udp:127.0.0.1:1"), "--bus and --connect: expected one of them"),
        (("--bus", "two"), "bus 'two': expected i2c:NUMBER"),
        (("--connect", "carrier pigeon"), "expected serial:PATH:BAUD"),
        (("a.csv", "--position", "here"), "--position here: expected latitude,longitude"),
        (("a.csv", "--position", "91,0"), "--position 91,0: expected"),
        (("a.csv", "--date", "yesterday"), "--date yesterday: expected YYYY-MM-DD"),
        (("a.csv", "--sensor", "bmm"), "'bmm' is not one of 'mpu9250', 'autopilot', 'other'"),
        (("a.csv", "--fit", "best"), "'best' is not one of 'auto', 'likelihood', 'residual'"),
        (("a.csv", "-o", "no/where.yaml"), "--output no/where.yaml: expected a .yaml file"),
        # the recording itself
        (("a.csv", "-o", "a.csv"), "--output a.csv: expected a .yaml file in an existing folder"),
        (("a.csv", "--plot", "no/where.png"), "--plot no/where.png: expected a file"),
        (("a.csv", "--plot", "a.xyz"), "--plot a.xyz: expected a name that ends in .png"),
        (("a.csv", "--date", "0001-01-01"), "--date 0001-01-01: expected YYYY-MM-DD, from 2000 to 2040"),
        (("a.csv", "--colour"), "see calibrate-magnetometer --help"),
    ],
)
def test_what_a_user_can_mend_is_one_line(
    words: tuple[str, ...], expected: str, program: ProgramHere
) -> None:
    csv("a.csv", CASE.raw[:60])
    told = program("calibrate-magnetometer", *words).refusal
    assert expected in told
    assert told.startswith("calibrate-magnetometer: ")


def test_help_has_examples(program: ProgramHere) -> None:
    shown = program("calibrate-magnetometer", "--help").out
    assert "calibrate-magnetometer turns.csv --unit mG" in shown
    assert "Exit codes" in shown
