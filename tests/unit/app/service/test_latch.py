"""The latch: what the file says decides whether a start may fly, whoever killed the last one."""

import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.app.service.latch import FILE_NAME, FlightLatch, LatchState, state_folder, unattended
from companion.base.errors import ConfigError
from companion.cli import cli


@pytest.fixture
def latch(tmp_path: Path) -> FlightLatch:
    return FlightLatch(tmp_path / "flights")


def test_a_first_start_by_a_person_may_fly_and_the_next_after_its_end_too(latch: FlightLatch) -> None:
    assert latch.begin(unattended=False) is None
    assert latch.read()[0] is LatchState.BEGUN
    latch.end("landed")
    assert latch.read() == (LatchState.ENDED, "landed")
    assert latch.begin(unattended=False) is None


@pytest.mark.parametrize("by_service", [False, True])
def test_after_a_flight_that_never_ended_only_the_operator_s_word_helps(
    latch: FlightLatch, by_service: bool
) -> None:
    latch.permit()
    assert latch.begin(unattended=by_service) is None  # and then it is killed
    for _ in range(3):
        reason = latch.begin(unattended=by_service)
        assert reason is not None
        assert "never ended" in reason
        assert "companion permit" in reason
    latch.permit()
    assert latch.begin(unattended=by_service) is None


def test_under_a_service_manager_each_flight_needs_its_own_permission(latch: FlightLatch) -> None:
    refused = latch.begin(unattended=True)
    assert refused is not None
    assert "service manager" in refused
    latch.permit()
    assert latch.begin(unattended=True) is None
    latch.end("landed")
    refused = latch.begin(unattended=True)
    assert refused is not None
    assert "the last one ended: landed" in refused


@pytest.mark.parametrize(
    "content", ["", "{", "[]", "7", '{"state": "flown", "words": ""}', '{"state": "ended"}']
)
def test_a_file_that_nobody_understands_is_no_permission(latch: FlightLatch, content: str) -> None:
    latch.permit()
    latch.path.write_text(content, encoding="utf-8")
    for by_service in (False, True):
        assert latch.begin(unattended=by_service) is not None


def test_the_file_is_replaced_as_a_whole(latch: FlightLatch) -> None:
    latch.permit()
    held = latch.path.open(encoding="utf-8")
    with held:
        latch.end("landed")
        assert json.load(held)["state"] == "permitted"  # the old one, complete
    assert [path.name for path in latch.folder.iterdir()] == [FILE_NAME]


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes anywhere")
def test_a_latch_that_cannot_be_written_ends_in_one_line(latch: FlightLatch) -> None:
    latch.folder.mkdir(mode=0o500)
    with pytest.raises(ConfigError, match="cannot be written"):
        latch.begin(unattended=False)


def test_a_folder_that_is_a_file_ends_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"taken.*cannot be written"):
        FlightLatch(tmp_path / "taken").permit()


def test_without_a_record_it_is_in_the_state_directory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/companion:/var/lib/other")
    assert state_folder() == Path("/var/lib/companion")
    monkeypatch.delenv("STATE_DIRECTORY")
    monkeypatch.setenv("XDG_STATE_HOME", "/somewhere")
    assert state_folder() == Path("/somewhere/companion")


def test_systemd_is_known_by_its_socket(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    assert not unattended()
    monkeypatch.setenv("NOTIFY_SOCKET", "/run/systemd/notify")
    assert unattended()


def test_the_command_says_what_stood_there(tmp_path: Path) -> None:
    FlightLatch(tmp_path).begin(unattended=False)
    result = CliRunner().invoke(cli, ["permit", "--record", str(tmp_path)])
    assert result.exit_code == 0
    assert result.output.endswith("the next start may fly (the last flight never ended)\n")
    assert FlightLatch(tmp_path).read()[0] is LatchState.PERMITTED
