"""What the service reads before it opens a device is read, and what is wrong with it said in one line."""

from pathlib import Path

import pytest

from companion.config import CONFIG_FOLDER
from companion.tools.preflight.start_check import main

TOKEN = "0123456789abcdef0123"


def settings(folder: Path, text: str) -> str:
    path = folder / "companion.yaml"
    path.write_text(text)
    return str(path)


def secret(folder: Path, name: str, mode: int = 0o600) -> Path:
    path = folder / name
    path.write_text(TOKEN)
    path.chmod(mode)
    return path


def test_the_shipped_settings_start(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(CONFIG_FOLDER / "companion.yaml")]) == 0
    assert capsys.readouterr().err == ""


def test_keys_and_tokens_are_read(tmp_path: Path) -> None:
    token, key = secret(tmp_path, "token"), secret(tmp_path, "key")
    text = f"serve: {{address: '0.0.0.0:8080', token_file: {token}}}\n"
    text += f"link: {{signing_key: {key}, actions: pymavlink}}\n"
    assert main([settings(tmp_path, text)]) == 0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("wings: 2\n", "wings"),
        ("vehicle: no_such\n", "no_such"),
        ("camera: no_such\n", "no_such"),
        ("pad: no_such\n", "no_such"),
        ("sense: {imu: {inertial_calibration: no.yaml}}\n", "no.yaml"),
        ("sense: {imu: {magnetometer_calibration: no.yaml}}\n", "no.yaml"),
        ("serve: {address: '0.0.0.0:8080', token_file: open}\n", "others may read it; expected 0600"),
        ("serve: {address: '0.0.0.0:8080', token_file: none}\n", "No such file"),
        ("link: {signing_key: open, actions: pymavlink}\n", "others may read it; expected 0600"),
    ],
)
def test_what_would_end_the_start_is_said_in_one_line(
    text: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    secret(tmp_path, "open", 0o644)
    assert main([settings(tmp_path, text)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
