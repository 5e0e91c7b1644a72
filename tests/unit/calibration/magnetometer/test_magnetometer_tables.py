"""Tables of every shape are read; what cannot be is told in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibration.magnetometer.recording import MagnetometerRecording
from calibration.magnetometer.sources import read_recording
from calibration.magnetometer.tables import read_numpy_table, read_text_table
from companion.base.geometry import FloatArray
from companion.config import ConfigError
from tests.unit.calibration.magnetometer.magnetometer_truth import turned

RAW = turned(0, samples=80).raw
FORCE = turned(0, samples=80).force


def table(heading: str, rows: FloatArray, separator: str = ",", form: str = "{:.4f}") -> str:
    lines = [separator.join(form.format(value) for value in row) for row in rows.tolist()]
    return heading + "\n".join(lines) + "\n"


def read(path: Path, text: str, **options: str | float | None) -> MagnetometerRecording:
    path.write_text(text, encoding="utf-8")
    given = {"columns": None, "unit": None, "field_ut": None, **options}
    return read_recording(path, sensor="other", rng=np.random.default_rng(0), **given)  # type: ignore[arg-type]


with_force = np.hstack([FORCE, RAW])
with_time = np.hstack([np.arange(80.0)[:, None], RAW])
everything = np.hstack([np.arange(80.0)[:, None], FORCE, 0.1 * FORCE, RAW])


@pytest.mark.parametrize(
    "text",
    [
        table("mx,my,mz\n", RAW),
        table("", RAW),
        table("Fs,50.00\nInitialization time,60\nmx,my,mz\n", RAW),
        table("# a comment\n# mag_x mag_y mag_z\n", RAW, " "),
        table("Mag X (uT);Mag Y (uT);Mag Z (uT)\n", RAW, ";"),
        table("t\tmagX\tmagY\tmagZ\n", with_time, "\t"),
        table("time,field.magnetic_field.x,field.magnetic_field.y,field.magnetic_field.z\n", with_time),
        table("ax,ay,az,mx,my,mz\n", with_force),
        table("", with_force),
        table("t,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z,Mag_X,Mag_Y,Mag_Z\n", everything),
        table('"time","x_mag","y_mag","z_mag"\n', with_time),
        table("x y z\n", RAW, "   "),
        table("X;Y;Z\n", RAW, ";").replace(".", ","),
        table("mx,my,mz\n", RAW) + "1.0,2.0\nnot,a,row\n",
        table("timestamp,magneticFieldX,magneticFieldY,magneticFieldZ\n", with_time).replace("\n", "\r\n"),
        "\ufeff" + table("mx,my,mz,\n", RAW).replace("\n", ",\n").replace(",,", ","),
    ],
)
def test_the_samples_are_found(tmp_path: Path, text: str) -> None:
    recording = read(tmp_path / "samples.csv", text)
    assert recording.unit == "uT"
    assert recording.raw == pytest.approx(RAW, abs=1e-4)


def stamped(stamp: str, separator: str, labels: tuple[str, str, str] = ("", "", "")) -> str:
    rows = [[f"{label}{value:.4f}" for label, value in zip(labels, row, strict=True)] for row in RAW.tolist()]
    lines = (stamp.format(k // 10, 100 * (k % 10)) + separator.join(row) for k, row in enumerate(rows))
    return "\n".join(lines)


@pytest.mark.parametrize(
    "text",
    [
        stamped("12:03:{:02d}.{:03d} -> ", ","),
        stamped("12:03:{:02d}.{:03d} -> ", "\t"),
        stamped("[2026-11-27 12:03:{:02d}.{:03d}] ", ", "),
        stamped("2026-11-27T12:03:{:02d}.{:03d}Z,", ","),
        stamped("12:03:{:02d}.{:03d} -> ", ",", ("mx:", "my:", "mz:")),
        stamped("", "\t", ("MagX = ", "MagY = ", "MagZ = ")),
    ],
)
def test_a_serial_monitors_time_stamps_and_labels_cost_no_column(tmp_path: Path, text: str) -> None:
    found = read(tmp_path / "monitor.txt", text)
    assert found.raw == pytest.approx(RAW, abs=1e-3)


def printed(row: str, before: str = "", after: str = "") -> str:
    return before + "\n".join(row.format(*values) for values in RAW.tolist()) + after


@pytest.mark.parametrize(
    "text",
    [
        printed("({:.4f}, {:.4f}, {:.4f})"),  # print(sensor.magnetic)
        printed("Magnetometer: ({:.4f}, {:.4f}, {:.4f})"),
        printed("[{:.4f} {:.4f} {:.4f}]"),  # NumPy's
        printed("[ {:.4f}  {:.4f}  {:.4f}]"),
        printed("(np.float64({:.4f}), np.float64({:.4f}), np.float64({:.4f}))"),
        printed("Vector3(x={:.4f}, y={:.4f}, z={:.4f})"),
        printed("  [{:.4f}, {:.4f}, {:.4f}],", "[\n", "\n]\n"),
        printed('{{"t": 1, "mx": {:.4f}, "my": {:.4f}, "mz": {:.4f}}}'),
        printed('{{"acc": [0.0, 0.0, 9.8], "mag": [{:.4f}, {:.4f}, {:.4f}]}}'),
    ],
)
def test_rows_as_python_and_json_print_them_are_read(tmp_path: Path, text: str) -> None:
    found = read(tmp_path / "printed.txt", text)
    assert found.raw == pytest.approx(RAW, abs=1e-3)


def test_labels_name_the_columns(tmp_path: Path) -> None:
    rows = (
        f"mx:{m[0]:.4f},my:{m[1]:.4f},mz:{m[2]:.4f},ax:{a[0]:.4f},ay:{a[1]:.4f},az:{a[2]:.4f}"
        for m, a in zip(RAW.tolist(), FORCE.tolist(), strict=True)
    )
    found = read(tmp_path / "plotter.txt", "\n".join(rows))
    assert found.raw == pytest.approx(RAW, abs=1e-3)
    assert found.force == pytest.approx(FORCE, abs=1e-3)


@pytest.mark.parametrize("mark", ["\ufeff", ""])
@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_utf_16_is_read(tmp_path: Path, encoding: str, mark: str) -> None:
    path = tmp_path / "unicode.txt"
    path.write_bytes((mark + table("mx\tmy\tmz\n", RAW, "\t")).encode(encoding))
    assert read_text_table(path, None).raw == pytest.approx(RAW, abs=1e-3)


@pytest.mark.parametrize("value", [-2147483648, 2147483647, -32768, 32767, -4096])
def test_what_drivers_give_in_the_place_of_a_reading_is_passed_over_and_told(
    tmp_path: Path, value: int
) -> None:
    spoilt = np.round(6.0 * RAW)
    spoilt[10:24, 1] = value
    found = read(tmp_path / "a.csv", table("mx,my,mz\n", spoilt, form="{:.0f}"))
    assert len(found.raw) == 66
    assert f"14 samples passed over, in which a reading is {value}" in found.notes
    with pytest.raises(ConfigError, match=rf"6 magnetometer samples, 14 samples passed over.*{value}"):
        read(tmp_path / "a.csv", table("mx,my,mz\n", spoilt[4:24], form="{:.0f}"))


@pytest.mark.parametrize(
    ("heading", "unit", "factor", "expected"),
    [
        ("mx_uT,my_uT,mz_uT\n", None, 0.01, r"by the heading's uT the field is 0\.\d+ µT; .* see --unit G$"),
        ("mx,my,mz\n", "uT", 0.01, r"by --unit uT the field is 0\.\d+ µT; .* see --unit G$"),
        ("mx,my,mz\n", "uT", 10.0, r"by --unit uT the field is \d+ µT; .* see --unit mG$"),
        ("mx,my,mz\n", "G", 1.0, r"by --unit G the field is .* see --unit uT$"),
    ],
)
def test_a_unit_in_which_the_field_is_not_the_earths_is_refused_with_the_one_in_which_it_is(
    tmp_path: Path, heading: str, unit: str | None, factor: float, expected: str
) -> None:
    with pytest.raises(ConfigError, match=expected):
        read(tmp_path / "a.csv", table(heading, factor * RAW, form="{:.6f}"), unit=unit)


def test_an_accelerometer_beside_it_is_taken(tmp_path: Path) -> None:
    recording = read(tmp_path / "a.csv", table("ax,ay,az,mx,my,mz\n", with_force))
    assert recording.force == pytest.approx(FORCE, abs=1e-4)


def test_of_two_magnetometers_the_raw_one_is_taken(tmp_path: Path) -> None:
    heading = "mag_cal_x,mag_cal_y,mag_cal_z,mag_raw_x,mag_raw_y,mag_raw_z\n"
    assert read(tmp_path / "a.csv", table(heading, with_force)).raw == pytest.approx(RAW, abs=1e-4)


def test_numbers_that_no_sensor_measures_are_passed_over(tmp_path: Path) -> None:
    text = table("mx,my,mz\n", RAW) + "1e30,0,0\n0,-1e200,0\nnan,1,2\n0,inf,1\n"
    assert read(tmp_path / "a.csv", text).raw == pytest.approx(RAW, abs=1e-4)


@pytest.mark.parametrize("columns", ["c,d,e", "4,5,6"])
def test_columns_can_be_named(tmp_path: Path, columns: str) -> None:
    rows = np.hstack([FORCE, RAW, FORCE])
    recording = read(tmp_path / "a.csv", table("t,a,b,c,d,e,f,g,h\n", rows), columns=columns)
    assert recording.raw == pytest.approx(RAW, abs=1e-4)


@pytest.mark.parametrize(
    ("heading", "factor", "options", "unit"),
    [
        ("mx,my,mz\n", 0.01, {}, "uT"),  # gauss, by the size
        ("mx_mG,my_mG,mz_mG\n", 10.0, {}, "uT"),
        ("mx [nT],my [nT],mz [nT]\n", 1000.0, {}, "uT"),
        ("mx,my,mz\n", 1e-6, {"unit": "T"}, "uT"),
        ("mx,my,mz\n", 100.0, {}, "counts"),
        ("mx,my,mz\n", 10.0, {"unit": "counts"}, "counts"),
        ("mx,my,mz\n", 10.0, {"field_ut": 48.0}, "uT"),
    ],
)
def test_the_unit_is_reported_or_worked_out(
    tmp_path: Path, heading: str, factor: float, options: dict[str, str | float], unit: str
) -> None:
    text = table(heading, factor * RAW, form="{:.9f}")
    recording = read(tmp_path / "a.csv", text, **options)
    assert recording.unit == unit
    assert recording.raw == pytest.approx(RAW if unit == "uT" else factor * RAW, abs=1e-2)


def test_whole_numbers_are_counts_unless_the_field_says_otherwise(tmp_path: Path) -> None:
    text = table("mx,my,mz\n", 10.0 * RAW, form="{:.0f}")
    assert read(tmp_path / "a.csv", text).unit == "counts"
    assert read(tmp_path / "a.csv", text, field_ut=48.0).unit == "uT"


def test_numpys_arrays_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, mag=RAW.T, acc=FORCE, fs=50.0)
    found = read_numpy_table(path)
    assert found.raw == pytest.approx(RAW)
    assert found.force == pytest.approx(FORCE)
    np.savez(path, mx=RAW[:, 0], my=RAW[:, 1], mz=RAW[:, 2])
    assert read_numpy_table(path).raw == pytest.approx(RAW)
    np.save(tmp_path / "b.npy", RAW)
    assert read_numpy_table(tmp_path / "b.npy").raw == pytest.approx(RAW)


@pytest.mark.parametrize(
    ("text", "options", "expected"),
    [
        ("", {}, "no table in it"),
        ("hello\nworld\n", {}, "no table in it"),
        (table("a,b,c,d\n", with_time), {}, "no magnetometer's columns among a, b, c, d"),
        (table("ax,ay,az\n", FORCE), {}, "no magnetometer's columns among ax, ay, az"),
        (table("gyro_x;gyro_y;gyro_z\n", FORCE, ";"), {}, "no magnetometer's columns among gyro_x"),
        (table("a,b,c,d\n", with_time), {"columns": "b,c,x"}, "no column 'x'"),
        (table("a,b,c,d\n", with_time), {"columns": "b,c"}, "expected three columns"),
        (table("mx,my,mz\n", RAW), {"unit": "furlong"}, "--unit furlong: expected one of"),
        (table("mx,my,mz\n", RAW[:10]), {}, "10 magnetometer samples; expected 50 or more"),
    ],
)
def test_what_cannot_be_read_is_reported_in_one_line(
    tmp_path: Path, text: str, options: dict[str, str], expected: str
) -> None:
    with pytest.raises(ConfigError, match=expected) as caught:
        read(tmp_path / "a.csv", text, **options)
    assert "\n" not in str(caught.value)


def test_files_that_are_not_there_or_not_what_they_seem(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        read_text_table(tmp_path / "none.csv", None)
    (tmp_path / "x.npz").write_bytes(b"PK\x03\x04 broken")
    with pytest.raises(ConfigError, match="numpy's arrays"):
        read_numpy_table(tmp_path / "x.npz")
    np.savez(tmp_path / "y.npz", other=RAW)
    with pytest.raises(ConfigError, match="no magnetometer among other"):
        read_numpy_table(tmp_path / "y.npz")


@pytest.mark.parametrize(
    "arrays",
    [
        {"mag": RAW.astype(str)},
        {"mag": RAW * 1j},
        {"mag": RAW.astype("datetime64[s]")},
        {"mx": RAW[:, 0], "my": RAW[:, 1], "mz": RAW[1:, 2]},
    ],
)
def test_arrays_that_are_no_fields_are_reported(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    np.savez(tmp_path / "a.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="no magnetometer among m"):
        read_numpy_table(tmp_path / "a.npz")
