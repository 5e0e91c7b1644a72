"""The latch: what the file says decides whether a start may fly, whoever killed the last one."""

import json
import os
import pty
import sys
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from companion.app.command import Output, fly_the_vehicle
from companion.app.service import latch as latch_module
from companion.app.service.latch import (
    FILE_NAME,
    PERMIT_S,
    FlightLatch,
    LatchState,
    state_folder,
    unattended,
)
from companion.base.errors import ConfigError
from companion.cli import cli
from tests.unit.link.transport.transport_ends import free_port


@pytest.fixture
def latch(tmp_path: Path) -> FlightLatch:
    return FlightLatch(tmp_path / "flights")


def begin(latch: FlightLatch, *, unattended: bool) -> str | None:
    """Begin a flight where that may be; returns why not."""
    reason = latch.refusal(unattended=unattended)
    if reason is None:
        latch.begin()
    return reason


def test_a_start_that_ends_in_order_before_its_flight_uses_no_permission_up(latch: FlightLatch) -> None:
    latch.permit()
    for _ in range(3):  # each ends in an error of the settings
        assert latch.refusal(unattended=True) is None
        latch.end("by an error in the settings")
    assert latch.read()[0] is LatchState.PERMITTED


def test_a_permission_of_another_boot_or_of_hours_ago_is_none(
    latch: FlightLatch, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    now_s, boot = 100.0, tmp_path / "boot_id"
    boot.write_text("first\n")
    monkeypatch.setattr(latch_module, "up_s", lambda: now_s)
    monkeypatch.setattr(latch_module, "BOOT_ID", boot)
    latch.permit()
    now_s += PERMIT_S
    assert latch.refusal(unattended=True) is None
    latch.end("by an error in the settings")  # given back, it is as old as it was
    now_s += 2.0
    for by_service in (False, True):
        reason = latch.refusal(unattended=by_service)
        assert reason is not None
        assert "older than 60 min" in reason
    now_s = 150.0
    boot.write_text("second\n")
    reason = latch.refusal(unattended=False)
    assert reason is not None
    assert "before the computer started anew" in reason
    latch.permit()
    assert latch.refusal(unattended=True) is None


def test_a_permission_that_an_older_version_wrote_is_none(latch: FlightLatch) -> None:
    latch.permit()
    latch.path.write_text('{"state": "permitted", "words": ""}')
    assert latch.refusal(unattended=True) is not None


def test_a_start_that_dies_before_its_flight_leaves_no_permission(latch: FlightLatch) -> None:
    latch.permit()
    assert latch.refusal(unattended=True) is None  # and then it is killed, or fails in a way it should not
    for by_service in (False, True):
        reason = FlightLatch(latch.folder).refusal(unattended=by_service)
        assert reason is not None
        assert "begun no flight" in reason


def test_a_permission_that_another_start_took_over_is_not_given_back_twice(latch: FlightLatch) -> None:
    latch.permit()
    assert latch.refusal(unattended=True) is None
    other = FlightLatch(latch.folder)
    other.permit()
    assert other.refusal(unattended=True) is None
    latch.end("by an error in the settings")
    with pytest.raises(ConfigError, match="another start"):
        latch.begin()
    other.begin()
    assert latch.read()[0] is LatchState.BEGUN


@pytest.mark.parametrize("by_service", [False, True])
def test_two_starts_have_one_permission_between_them(latch: FlightLatch, by_service: bool) -> None:
    other = FlightLatch(latch.folder)
    latch.permit()
    assert latch.refusal(unattended=by_service) is None
    assert other.refusal(unattended=by_service) is not None
    latch.begin()  # opening the devices took a while
    with pytest.raises(ConfigError, match="another start"):
        other.begin()
    other.end("by an error in the settings")
    assert latch.read()[0] is LatchState.BEGUN


def test_a_first_start_by_a_person_may_fly_and_the_next_after_its_end_too(latch: FlightLatch) -> None:
    assert begin(latch, unattended=False) is None
    assert latch.read()[0] is LatchState.BEGUN
    latch.end("landed")
    assert latch.read() == (LatchState.ENDED, "landed")
    assert begin(latch, unattended=False) is None


@pytest.mark.parametrize("by_service", [False, True])
def test_after_a_flight_that_never_ended_only_the_operator_s_word_helps(
    latch: FlightLatch, by_service: bool
) -> None:
    latch.permit()
    assert begin(latch, unattended=by_service) is None  # and then it is killed
    for _ in range(3):
        reason = begin(latch, unattended=by_service)
        assert reason is not None
        assert "never ended" in reason
        assert "companion permit" in reason
    latch.permit()
    assert begin(latch, unattended=by_service) is None


def test_under_a_service_manager_each_flight_needs_its_own_permission(latch: FlightLatch) -> None:
    refused = begin(latch, unattended=True)
    assert refused is not None
    assert "not started at a terminal" in refused
    latch.permit()
    assert begin(latch, unattended=True) is None
    latch.end("landed")
    refused = begin(latch, unattended=True)
    assert refused is not None
    assert "the last one ended: landed" in refused


@pytest.mark.parametrize(
    "content", ["", "{", "[]", "7", '{"state": "flown", "words": ""}', '{"state": "ended"}']
)
def test_a_file_that_nobody_understands_is_no_permission(latch: FlightLatch, content: str) -> None:
    latch.permit()
    latch.path.write_text(content, encoding="utf-8")
    for by_service in (False, True):
        assert begin(latch, unattended=by_service) is not None


def test_the_file_is_replaced_as_a_whole(latch: FlightLatch) -> None:
    latch.permit()
    held = latch.path.open(encoding="utf-8")
    with held:
        latch.begin()
        assert json.load(held)["state"] == "permitted"  # the old one, complete
    assert [path.name for path in latch.folder.iterdir()] == [FILE_NAME]


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes anywhere")
def test_a_latch_that_cannot_be_written_ends_in_one_line(latch: FlightLatch) -> None:
    latch.folder.mkdir(mode=0o500)
    with pytest.raises(ConfigError, match="cannot be written"):
        begin(latch, unattended=False)


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


def test_only_a_person_at_a_terminal_attends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    with Path(os.devnull).open(encoding="utf-8") as nothing:  # a container, cron, a script
        monkeypatch.setattr(sys, "stdin", nothing)
        assert unattended()
    main, terminal = pty.openpty()
    with os.fdopen(terminal, encoding="utf-8") as typed:
        monkeypatch.setattr(sys, "stdin", typed)
        assert not unattended()
        monkeypatch.setenv("NOTIFY_SOCKET", "/run/systemd/notify")
        assert unattended()
    os.close(main)
    monkeypatch.setattr(sys, "stdin", None)
    assert unattended()


def test_the_command_says_what_stood_there(tmp_path: Path) -> None:
    begin(FlightLatch(tmp_path), unattended=False)
    result = CliRunner().invoke(cli, ["permit", "--record", str(tmp_path)])
    assert result.exit_code == 0
    assert result.output.endswith("the next start may fly (the last flight never ended)\n")
    assert FlightLatch(tmp_path).read()[0] is LatchState.PERMITTED


def test_a_permitted_start_that_ends_in_a_settings_error_leaves_the_next_one_permitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = tmp_path / "companion.yaml"
    link = f"link: {{connection: 'udpin:127.0.0.1:{free_port()}'}}"
    settings.write_text(
        f"plan: {{mission: {{may_arm: true}}}}\nvehicle: nobody_s\n{link}\n", encoding="utf-8"
    )
    monkeypatch.setenv("NOTIFY_SOCKET", "/run/systemd/notify")
    latch = FlightLatch(tmp_path)
    latch.permit()
    with pytest.raises(ConfigError, match="nobody_s"):
        fly_the_vehicle(settings, Output(Console(quiet=True), tmp_path, None, live=False))
    assert latch.read()[0] is LatchState.PERMITTED


def test_a_permitted_start_that_fails_in_a_way_it_should_not_leaves_the_next_one_in_standby(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_memory(*_: object) -> None:
        raise MemoryError

    settings = tmp_path / "companion.yaml"
    settings.write_text("plan: {mission: {may_arm: true}}\n", encoding="utf-8")
    monkeypatch.setenv("NOTIFY_SOCKET", "/run/systemd/notify")
    monkeypatch.setattr("companion.app.command.LivePage", no_memory)
    latch = FlightLatch(tmp_path)
    latch.permit()
    with pytest.raises(MemoryError):
        fly_the_vehicle(settings, Output(Console(quiet=True), tmp_path, None, live=False))
    assert latch.read()[0] is not LatchState.PERMITTED
    assert latch.refusal(unattended=True) is not None
