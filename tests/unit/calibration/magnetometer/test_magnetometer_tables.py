"""Tables of every shape are read; what cannot be is told in one line."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.magnetometer.calibrate import Calibrated, TrueField, calibrate
from calibration.magnetometer.recording import (
    NAMES,
    MagnetometerRecording,
    Onboard,
    onboard_of,
    parameters_for,
)
from calibration.magnetometer.report import lines
from calibration.magnetometer.sources import read_numpy_table, read_recording, read_text_table
from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import FloatArray, vector3
from companion.base.messages import ImuSample, MagSample
from companion.config import CONFIG_FOLDER, CompanionConfig, ConfigError, VehicleConfig, find_file, load_model
from companion.config.magnetometer import MagnetometerCalibration, Sensor
from companion.flightlog.record import FlightLog
from companion.link.codec import Codec, mavlink
from companion.pad import load_pad
from tests.unit.calibration.magnetometer.magnetometer_truth import Turned, turned
from tests.unit.flightlog.replay.log_files import DataFlash

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


def printed(row: str, before: str = "", after: str = "") -> str:
    return before + "\n".join(row.format(*values) for values in RAW.tolist()) + after


@pytest.mark.parametrize(
    "text",
    [
        stamped("12:03:{:02d}.{:03d} -> ", ","),
        stamped("12:03:{:02d}.{:03d} -> ", "\t"),
        stamped("[2026-11-27 12:03:{:02d}.{:03d}] ", ", "),
        stamped("2026-11-27T12:03:{:02d}.{:03d}Z,", ","),
        stamped("12:03:{:02d}.{:03d} -> ", ",", ("mx:", "my:", "mz:")),
        stamped("", "\t", ("MagX = ", "MagY = ", "MagZ = ")),
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
def test_a_serial_monitors_stamps_and_labels_and_what_python_and_json_print_cost_no_column(
    tmp_path: Path, text: str
) -> None:
    assert read(tmp_path / "printed.txt", text).raw == pytest.approx(RAW, abs=1e-3)


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


# ----------------
# Logs of autopilots and of ours: what the compass measured is found under what was made of it.

CASE = turned(7, samples=400, half=False, noise=0.005)
FIELD = TrueField((20.0, 0.0, 43.634), "test")
ARDUPILOT = {
    "COMPASS_OFS_X": 120.0, "COMPASS_OFS_Y": -40.0, "COMPASS_OFS_Z": 33.0,
    "COMPASS_DIA_X": 1.05, "COMPASS_DIA_Y": 0.97, "COMPASS_DIA_Z": 1.02,
    "COMPASS_ODI_X": 0.03, "COMPASS_ODI_Y": -0.02, "COMPASS_ODI_Z": 0.01, "COMPASS_SCALE": 1.1,
}  # fmt: skip
PX4 = {
    "CAL_MAG0_ROT": 0.0,
    **{f"CAL_MAG0_{axis}OFF": value for axis, value in zip("XYZ", (0.1, -0.05, 0.02), strict=True)},
    **{f"CAL_MAG0_{axis}SCALE": value for axis, value in zip("XYZ", (1.02, 0.95, 1.1), strict=True)},
    **{f"CAL_MAG0_{axis}ODIAG": value for axis, value in zip("XYZ", (0.01, 0.02, -0.03), strict=True)},
}
PARAMETERS: dict[AutopilotKind, dict[str, float]] = {"ardupilot": ARDUPILOT, "px4": PX4}


def known(autopilot_kind: AutopilotKind) -> Onboard:
    found = onboard_of(autopilot_kind, PARAMETERS[autopilot_kind])
    assert found is not None
    return found


def heard(onboard: Onboard, raw: FloatArray) -> FloatArray:
    """What the autopilot makes of it, by its own formula."""
    made: FloatArray = (raw + onboard.offset_ut) @ onboard.matrix.T
    return made


def read_log(path: Path) -> MagnetometerRecording:
    rng = np.random.default_rng(0)
    return read_recording(path, columns=None, unit=None, sensor="other", field_ut=None, rng=rng)


def calibrated(recording: MagnetometerRecording, case: Turned = CASE) -> Calibrated:
    rng = np.random.default_rng(0)
    done = calibrate(recording, rng, field=FIELD, aligned=False, tool="t", date="d")
    assert done.centre == pytest.approx(case.centre, abs=0.15)
    return done


# ---------------------------------------------------------------- parameters


def test_ardupilots_formula_is_its_own() -> None:
    onboard = known("ardupilot")
    x, y, z = (20.0 + 12.0, -30.0 - 4.0, 40.0 + 3.3)
    expected = (1.1 * (1.05 * x + 0.03 * y - 0.02 * z), 1.1 * (0.03 * x + 0.97 * y + 0.01 * z))
    assert heard(onboard, np.array([[20.0, -30.0, 40.0]]))[0, :2] == pytest.approx(expected)


def test_px4s_formula_is_its_own() -> None:
    onboard = known("px4")
    x, y, z = (20.0 - 10.0, -30.0 + 5.0, 40.0 - 2.0)
    expected = 1.02 * x + 0.01 * y + 0.02 * z
    assert heard(onboard, np.array([[20.0, -30.0, 40.0]]))[0, 0] == pytest.approx(expected)


@pytest.mark.parametrize("autopilot_kind", ["ardupilot", "px4"])
def test_the_parameters_say_what_the_fit_says(autopilot_kind: AutopilotKind) -> None:
    raw = CASE.raw[:20]
    parameters = parameters_for(autopilot_kind, CASE.matrix, CASE.centre)
    assert set(parameters) <= set(NAMES[autopilot_kind])
    onboard = onboard_of(autopilot_kind, parameters)
    assert onboard is not None
    assert heard(onboard, raw) == pytest.approx((raw - CASE.centre) @ CASE.matrix)


@pytest.mark.parametrize("autopilot_kind", ["ardupilot", "px4"])
def test_a_calibration_goes_on_top_of_the_autopilots(autopilot_kind: AutopilotKind) -> None:
    onboard = known(autopilot_kind)
    assert onboard.undo(heard(onboard, CASE.raw)) == pytest.approx(CASE.raw)
    matrix, centre = onboard.on_top(CASE.matrix, CASE.centre)
    on_top = (heard(onboard, CASE.raw) - centre) @ matrix.T
    assert on_top == pytest.approx((CASE.raw - CASE.centre) @ CASE.matrix)


def test_a_compass_that_is_turned_or_unknown_is_not_guessed() -> None:
    assert onboard_of("px4", {**PX4, "CAL_MAG0_ROT": 4.0}) is None
    assert onboard_of("ardupilot", {}) is None
    assert onboard_of("ardupilot", dict.fromkeys(ARDUPILOT, 0.0)) is not None  # 0 diagonals: none


# ---------------------------------------------------------------- files


def write_tlog(
    path: Path, autopilot_kind: AutopilotKind, field: FloatArray, *, parameters: bool = True
) -> Path:
    kind = mavlink.MAV_AUTOPILOT_PX4 if autopilot_kind == "px4" else mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    messages = [mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, kind, 0, 0, 0, 3)]
    if parameters:
        messages += [
            mavlink.MAVLink_param_value_message(name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32, 30, k)
            for k, (name, value) in enumerate(PARAMETERS[autopilot_kind].items())
        ]
    for k, row in enumerate(field.tolist()):
        us = 20_000 * k
        if autopilot_kind == "px4":
            gauss = [0.01 * value for value in row]
            messages.append(
                mavlink.MAVLink_highres_imu_message(
                    us, 0.0, 0.0, -9.8, 0.0, 0.0, 0.0, *gauss, 0.0, 0.0, 0.0, 20.0, 0xFFFF
                )
            )
        else:
            mgauss = [round(10.0 * value) for value in row]
            messages.append(mavlink.MAVLink_raw_imu_message(us, 0, 0, -1000, 0, 0, 0, *mgauss))
    codec = Codec(1, 1)
    path.write_bytes(b"".join(b"\0\6\xfd\1\2\3\4\5" + codec.encode(message) for message in messages))
    return path


@pytest.mark.parametrize("autopilot_kind", ["ardupilot", "px4"])
def test_a_tlogs_compass_is_undone_and_the_file_goes_on_top(
    tmp_path: Path, autopilot_kind: AutopilotKind
) -> None:
    sent = heard(known(autopilot_kind), CASE.raw)
    recording = read_log(write_tlog(tmp_path / "a.tlog", autopilot_kind, sent))
    assert recording.sensor == "autopilot"
    assert recording.raw == pytest.approx(CASE.raw, abs=0.08)
    done = calibrated(recording)
    # the file is for what the app hears; the parameters are for the compass
    size = np.linalg.norm(done.file.apply(sent), axis=1)
    assert size == pytest.approx(FIELD.strength_ut, rel=0.03)
    new = onboard_of(autopilot_kind, done.parameters)
    assert new is not None
    assert np.linalg.norm(heard(new, CASE.raw), axis=1) == pytest.approx(FIELD.strength_ut, rel=0.03)
    assert done.file.autopilot_parameters == pytest.approx(PARAMETERS[autopilot_kind])


def test_a_refused_calibration_offers_no_parameters(tmp_path: Path) -> None:
    sent = heard(known("ardupilot"), CASE.raw)
    done = calibrated(read_log(write_tlog(tmp_path / "a.tlog", "ardupilot", sent)))
    good = done.file.quality.model_copy(update={"verdict": "good", "reasons": ()})
    accepted = replace(done, file=done.file.model_copy(update={"quality": good}))
    assert any("COMPASS_OFS_X" in line for line in lines(accepted))
    quality = done.file.quality.model_copy(update={"verdict": "refused", "reasons": ("too little turning",)})
    refused = replace(done, file=done.file.model_copy(update={"quality": quality}))
    assert lines(refused)[0] == "refused: too little turning"
    assert not any("COMPASS_" in line for line in lines(refused))


def test_without_parameters_the_calibration_is_of_what_is_heard(tmp_path: Path) -> None:
    recording = read_log(write_tlog(tmp_path / "a.tlog", "ardupilot", CASE.raw, parameters=False))
    assert "not known" in recording.notes[0]
    done = calibrated(recording)
    assert done.parameters == {}


def test_a_dataflash_logs_own_offsets_are_taken_off(tmp_path: Path) -> None:
    onboard, log = known("ardupilot"), DataFlash()
    log.define("PARM", "QNff", "TimeUS,Name,Value,Default")
    log.define("MAG", "QBhhhhhhhhhBI", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S")
    for name, value in ARDUPILOT.items():
        log.add("PARM", 0, name.encode(), value, value)
    motors, learnt = np.array([2.0, -1.0, 0.5]), np.array([1.0, 2.0, 3.0])
    for k, row in enumerate(CASE.raw):
        # the offsets change half way, as they are learnt
        offset = onboard.offset_ut + (learnt if k > 200 else 0.0)
        field = onboard.matrix @ (row + offset) + motors
        words = [round(10.0 * value) for value in (*field, *offset, *motors)]
        log.add("MAG", 50_000 * k, 0, *words, 1, 0)
    path = tmp_path / "00000001.BIN"
    path.write_bytes(log.data)
    recording = read_log(path)
    assert recording.raw == pytest.approx(CASE.raw, abs=0.12)
    assert "COMPASS_OFS_X" in calibrated(recording).parameters


def write_flight(
    folder: Path,
    settings: CompanionConfig,
    field: FloatArray,
    applied: MagnetometerCalibration | None = None,
) -> Path:
    log = FlightLog(folder, start_unix_s=1.7e9)
    vehicle = load_model(VehicleConfig, find_file("vehicles", "x500"))
    used = {} if applied is None else {"magnetometer": applied}
    log.write_settings(config=settings, vehicle=vehicle, pad=load_pad(settings.pad), **used)
    for k, row in enumerate(field.tolist()):
        log.write("imu", ImuSample(0.01 * k, (0.0,) * 3, (0.0, 0.0, -9.8), 20.0), 0.01 * k)
        log.write("mag", MagSample(0.01 * k, vector3(row)), 0.01 * k)
    log.close()
    return folder


def test_a_flight_of_ours_is_turned_back_into_the_sensors_axes(tmp_path: Path) -> None:
    body = CASE.raw * (1.0, -1.0, -1.0)  # the default mounting
    recording = read_log(write_flight(tmp_path / "flight", CompanionConfig(), body))
    assert recording.sensor == "mpu9250"
    assert recording.raw == pytest.approx(CASE.raw)
    assert recording.force is not None
    assert recording.force[0] == pytest.approx((0.0, 0.0, 9.8))


def with_calibration(sensor: Sensor, path: Path) -> CompanionConfig:
    section = "imu" if sensor == "mpu9250" else "autopilot"
    source = "boards" if sensor == "mpu9250" else "autopilot"
    return CompanionConfig.model_validate(
        {"sense": {"source": source, section: {"magnetometer_calibration": str(path)}}}
    )


def test_a_flight_with_a_calibration_is_read_as_if_without(tmp_path: Path) -> None:
    applied = calibrated(MagnetometerRecording("x", "autopilot", CASE.raw)).file
    file = tmp_path / "applied.yaml"
    file.write_text(applied.model_dump_json())
    settings = with_calibration("autopilot", file)
    path = write_flight(tmp_path / "flight", settings, applied.apply(CASE.raw), applied)
    assert read_log(path).raw == pytest.approx(CASE.raw)
    # by now the file of that name holds another one, or is gone: the log knows what it was
    other = applied.model_copy(update={"hard_iron": (30.0, -20.0, 10.0)})
    file.write_text(other.model_dump_json())
    assert read_log(path).raw == pytest.approx(CASE.raw)
    file.unlink()
    assert read_log(path).raw == pytest.approx(CASE.raw)


def test_a_flight_whose_log_lacks_its_calibration_is_refused(tmp_path: Path) -> None:
    applied = calibrated(MagnetometerRecording("x", "autopilot", CASE.raw)).file
    file = tmp_path / "applied.yaml"
    file.write_text(applied.model_dump_json())
    path = write_flight(tmp_path / "flight", with_calibration("autopilot", file), applied.apply(CASE.raw))
    with pytest.raises(ConfigError, match=r"applied\.yaml, which is not in the log"):
        read_log(path)


@pytest.mark.parametrize(
    ("name", "write", "expected"),
    [
        ("a.tlog", lambda path: path.write_bytes(b"\0" * 100), "no magnetometer in it; expected RAW_IMU"),
        ("a.bin", lambda path: path.write_bytes(bytes(DataFlash().data)), "no MAG messages"),
        (
            "a.ulg",
            lambda path: path.write_bytes(b"ULog\x01\x12\x35\x01" + b"\0" * 8),
            "no magnetometer in it",
        ),
        ("a.mcap", lambda path: path.write_bytes(b"\x89MCAP0\r\n"), "no magnetometer samples in the log"),
    ],
)
def test_logs_without_a_compass_are_reported_in_one_line(
    tmp_path: Path, name: str, write: Callable[[Path], object], expected: str
) -> None:
    path = tmp_path / name
    write(path)
    with pytest.raises(ConfigError, match=expected) as caught:
        read_log(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("name", "residual"), [("ck_acc_mag.csv", 0.01255), ("qmc5883l_noisy.csv", 0.0618)])
def test_real_logs_are_fitted_no_worse_than_published(name: str, residual: float) -> None:
    data = os.environ.get("COMPANION_DATA", CONFIG_FOLDER.parent.parent / "shared" / "data")
    path = Path(data) / "magnetometer" / name
    if not path.exists():
        pytest.skip(f"{path} is not there: somebody's recording, not part of the project")
    recording = read_log(path)
    done = calibrate(recording, np.random.default_rng(0), field=None, aligned=False, tool="t", date="d")
    assert done.file.quality.residual <= residual + 5e-6
