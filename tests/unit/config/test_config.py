"""Settings: what is wrong is said in one line with the file, the key and what was expected."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from companion.app.sensing import forced_calibrations
from companion.config import (
    CONFIG_FOLDER,
    NAMED_FILES,
    CameraConfig,
    CompanionConfig,
    ConfigError,
    VehicleConfig,
    find_file,
    load_config,
    load_model,
    merge,
    validate_recorded,
)
from companion.pad import load_pad


def write(folder: Path, text: str) -> Path:
    path = folder / "companion.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("text", ["", "# all of it\n# is commented out\n", "{}\n"])
def test_a_file_that_sets_nothing_leaves_every_default(tmp_path: Path, text: str) -> None:
    assert load_config(write(tmp_path, text)) == load_config(write(tmp_path, "plan: {}\n"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("pad: [", "broken YAML"),
        ("%YAML:1.0\n---\nflags: 0\n", "a file of OpenCV's own kind; expected YAML"),
        ("- 1\n- 2\n", "expected a mapping"),
        ("wings: 2\n", "unknown key 'wings'"),
        ("estimat: {}\n", "unknown key 'estimat'; did you mean 'estimate'?"),
        ("plan: {touchdown: {contact_speed: 0.2}}\n", "did you mean 'contact_speed_m_s'?"),
        ("sense: {imu: {buss: 'i2c:1'}}\n", "unknown key 'sense.imu.buss'; did you mean 'bus'?"),
        # names of an earlier version
        ("plan: {touchdown: {gave_up_s: 5}}\n", "did you mean 'giving_up_s'?"),
        ("plan: {touchdown: {contact_lean_deg: 5}}\n", "did you mean 'contact_deck_tilt_deg'?"),
        ("estimate: {pad: {patience_s: 1}}\n", "did you mean 'sighting_timeout_s'?"),
        ("estimate: {ekf: {orientation_patience_s: 3}}\n", "did you mean 'orientation_timeout_s'?"),
        ("link: {command_patience_s: 1}\n", "did you mean 'command_timeout_s'?"),
        ("control: {rate_hz: 1000}\n", "control.rate_hz: expected less than or equal to 100, found 1000"),
        ("control: {rate_hz: fast}\n", "control.rate_hz"),
        ("control: {limits: {tilt_deg: .nan}}\n", "control.limits.tilt_deg"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, text: str, expected: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    line = str(caught.value)
    assert expected in line
    assert str(path) in line
    assert "\n" not in line


def test_a_key_like_none_that_is_known_there_gets_no_guess(tmp_path: Path) -> None:
    # there is a rate_hz, but not in this place
    for text in ("wings: 2\n", "rate_hz: 30\n"):
        with pytest.raises(ConfigError) as caught:
            load_config(write(tmp_path, text))
        assert "did you mean" not in str(caught.value)


def test_the_files_that_settings_name_are_looked_for_beside_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, beside = tmp_path / "here", tmp_path / "etc"
    for folder in (here, beside):
        folder.mkdir()
        (folder / "both.yaml").touch()
    (here / "mine.yaml").touch()
    path = write(
        beside,
        "pad: mine.yaml\ncamera: both.yaml\nvehicle: x500\nmount: none.yaml\n"
        "sense: {imu: {magnetometer_calibration: both.yaml, inertial_calibration: /else/both.yaml}}\n",
    )
    monkeypatch.chdir(here)
    config = load_config(path)
    assert config.pad == "mine.yaml"  # of the current folder
    assert config.camera == config.sense.imu.magnetometer_calibration == str(beside / "both.yaml")
    assert (config.vehicle, config.mount) == ("x500", "none.yaml")
    assert config.sense.imu.inertial_calibration == "/else/both.yaml"


@pytest.mark.parametrize("keys", NAMED_FILES)
def test_every_such_setting_exists(keys: tuple[str, ...]) -> None:
    tree: Any = CompanionConfig().model_dump()
    for key in keys:
        tree = tree[key]
    assert tree is None or isinstance(tree, str)


def test_a_missing_file_names_what_there_is() -> None:
    with pytest.raises(ConfigError, match=r"no 'nowhere'; expected .* moving_1300"):
        find_file("pads", "nowhere")
    with pytest.raises(ConfigError, match=r": a folder; expected a .yaml file, or one of .* moving_1300"):
        find_file("pads", CONFIG_FOLDER)


def test_an_unreadable_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(tmp_path / "absent.yaml")
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not UTF-8"):
        load_config(binary)


def test_overrides_lie_over_the_file_and_leave_the_rest(tmp_path: Path) -> None:
    path = write(tmp_path, "control: {rate_hz: 20}\nplan: {fuzzy: landing}\n")
    config = load_config(path, {"control": {"rate_hz": 40.0}})
    assert config.control.rate_hz == 40.0
    assert config.plan.fuzzy == "landing"
    assert merge({"a": {"b": 1, "c": 2}}, {"a": {"b": 3}}) == {"a": {"b": 3, "c": 2}}


@pytest.mark.parametrize("size", ["{width_px: 1280, height_px: 960}", "{width_px: 320, height_px: 240}"])
def test_a_camera_whose_size_was_edited_without_its_calibration_is_refused(tmp_path: Path, size: str) -> None:
    shipped = yaml.safe_load((CONFIG_FOLDER / "cameras" / "sitl_640x480.yaml").read_text(encoding="utf-8"))
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump({**shipped, **yaml.safe_load(size)}), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"cx_px 321.4: expected near the middle of \d+ px"):
        load_model(CameraConfig, path)


def test_every_shipped_settings_file_loads() -> None:
    assert isinstance(load_config(CONFIG_FOLDER / "companion.yaml"), CompanionConfig)
    for path in (CONFIG_FOLDER / "pads").glob("*.yaml"):
        assert load_pad(path).markers
    for path in (CONFIG_FOLDER / "cameras").glob("*.yaml"):
        assert load_model(CameraConfig, path).fx_px > 0
    for path in (CONFIG_FOLDER / "vehicles").glob("*.yaml"):
        assert load_model(VehicleConfig, path).leg_height_m > 0


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("pad: a\npad: b\n", ":2:1: broken YAML: 'pad' stands here twice"),
        (f"pad: [{'x' * 500}]\n", f"pad: expected a valid string, found ['{'x' * 78}..."),
        ("? [a, b]\n: 1\n", "broken YAML: found unhashable key"),
        (f"pad: {'9' * 5000}\n", "broken YAML: Exceeds the limit"),
        ("orders: {rc_channel: on}\n", "orders.rc_channel: expected a valid integer, found 'on'"),
        ("link: {heartbeat_timeout_s: true}\n", "expected a valid number, found 'true'"),
        ("link: {heartbeat_timeout_s: 1:05}\n", "expected a valid number, found '1:05'"),
        ("sense: {source: boards}\nplan: {}\nsense: {source: autopilot}\n", "'sense' stands here twice"),
        ("estimate: {magnetic_field_ned_ut: [20900, 600, 42900]}\n", "expected a size of 15 to 100 µT"),
        ("sense: {range: {minimum_m: 0.5, maximum_m: 0.5}}\n", "expected more than minimum_m"),
        (
            "plan: {landing: {retry_height_m: 0.3}}\n",
            "retry_height_m: expected at least wait_height_m (0.35)",
        ),
        (
            "plan: {landing: {approach_height_m: 1, wait_height_m: 1.2}}\n",
            "approach_height_m: expected at least wait_height_m (1.2)",
        ),
        ("plan: {touchdown: {giving_up_s: 54}}\n", "mission.phases.touchdown_s 45: expected at least 60.6"),
        ("sense: 3\n", "sense: expected keys with values, found 3"),
    ],
)
def test_what_would_fly_otherwise_than_meant_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert expected in str(caught.value)


def test_plain_words_are_what_they_say(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(
        "orders: {rc_channel: 010, mavlink: no}\nplan: {mission: {may_arm: yes, take_off_height_m: 6e0}}\n"
    )
    settings = load_config(path)
    assert (settings.orders.rc_channel, settings.orders.mavlink) == (10, False)
    assert (settings.plan.mission.may_arm, settings.plan.mission.take_off_height_m) == (True, 6.0)


def test_a_list_that_is_too_long_is_reported_in_plain_words(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    pole = "{kind: cylinder, centre_ned_m: [1, 2, 3], radius_m: 1, height_m: 2}"
    path.write_text(f"plan: {{obstacles: [{pole}]}}", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"centre_ned_m: expected at most 2 items, found 3$"):
        load_config(path)


def test_settings_of_an_earlier_version_are_read_without_what_is_gone() -> None:
    recorded = CompanionConfig().model_dump(mode="json")
    recorded["estimate"]["ekf"]["gone_long_since"] = 1.0
    recorded["sense"]["also_gone"] = {"a": 1}
    notes: list[str] = []
    assert validate_recorded(CompanionConfig, recorded, "the log", notes) == CompanionConfig()
    assert notes == ["the log: estimate.ekf.gone_long_since, sense.also_gone: not in this version, left out"]


def test_a_recorded_setting_that_is_wrong_is_refused_all_the_same() -> None:
    recorded = CompanionConfig().model_dump(mode="json")
    recorded["sense"]["also_gone"] = 1
    recorded["control"]["rate_hz"] = -1.0
    with pytest.raises(ConfigError, match=r"^the log: control\.rate_hz: expected"):
        validate_recorded(CompanionConfig, recorded, "the log")


# ---------------- Calibrations that were written by force are told at every start

PROVENANCE = {"tool": "t", "source": "s", "date": "2026-01-01T00:00:00+00:00", "samples": 4}
QUALITY = {
    **{"board": "charuco", "board_bow_m": 0.0, "corners": 90, "rms_px": 0.1, "rms_all_px": 0.1},
    **{"held_out_rms_px": None, "fx_std_px": 9.0, "fy_std_px": 9.0, "cx_std_px": 9.0, "cy_std_px": 9.0},
    **{"distortion_std": [0.1] * 5, "projection_std_px": 9.0, "coverage": 0.3, "largest_tilt_deg": 9.0},
}


def settings(tmp_path: Path, verdict: list[str], forced: list[str]) -> CompanionConfig:
    camera = load_model(CameraConfig, find_file("cameras", "sitl_640x480")).model_dump(mode="json")
    camera["calibration"] = {**QUALITY, "provenance": PROVENANCE, "verdict": verdict}
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(camera))
    inertial = {
        "gyro": {"bias_rad_s": [0.0] * 3, "std_rad_s": 0.1, "temperature_c": 20.0},
        "forced": forced,
        "provenance": PROVENANCE,
    }
    (tmp_path / "inertial.yaml").write_text(yaml.safe_dump(inertial))
    return CompanionConfig.model_validate(
        {
            "camera": str(tmp_path / "mine.yaml"),
            "sense": {"imu": {"inertial_calibration": str(tmp_path / "inertial.yaml")}},
        }
    )


@pytest.mark.parametrize(
    ("verdict", "forced", "words"),
    [
        ([], [], []),
        (["too few views"], [], ["mine.yaml was written by force: too few views"]),
        ([], ["it moved"], ["inertial.yaml was written by force: it moved"]),
    ],
)
def test_forced_calibrations_are_reported(
    verdict: list[str], forced: list[str], words: list[str], tmp_path: Path
) -> None:
    lines = list(forced_calibrations(settings(tmp_path, verdict, forced)))
    assert len(lines) == len(words)
    assert all(line.endswith(word) for line, word in zip(lines, words, strict=True))


def test_what_is_shipped_is_beyond_doubt() -> None:
    assert list(forced_calibrations(CompanionConfig())) == []
