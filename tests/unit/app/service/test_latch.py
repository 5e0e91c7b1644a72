"""The latch: what the file says decides whether a start may fly, whoever killed the last one."""

import asyncio
import json
import os
import pty
import sys
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from companion.app.command import Output, fly_the_vehicle
from companion.app.hardware import STAMP_FILE_NAME as STAMP_NAME
from companion.app.hardware import StampFile, StampKeeper
from companion.app.service import latch as latch_module
from companion.app.service.latch import FILE_NAME, PERMIT_S, FlightLatch, LatchState, state_folder, unattended
from companion.base.errors import ConfigError
from companion.cli import cli
from companion.link.codec import Codec, heartbeat
from companion.link.signing import LinkSigning
from tests.unit.link.transport.transport_ends import free_port


@pytest.fixture
def latch(tmp_path: Path) -> FlightLatch:
    return FlightLatch(tmp_path / "flights")


def refused(latch: FlightLatch, *, unattended: bool) -> str:
    """Why a flight may not begin; "" once it has begun."""
    reason = latch.refusal(unattended=unattended)
    if reason is None:
        latch.begin()
    return reason or ""


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
        assert "older than 60 min" in refused(latch, unattended=by_service)
    now_s = 150.0
    boot.write_text("second\n")
    assert "before the computer started anew" in refused(latch, unattended=False)
    latch.permit()
    assert latch.refusal(unattended=True) is None


def test_a_start_that_dies_before_its_flight_leaves_no_permission(latch: FlightLatch) -> None:
    latch.permit()
    assert latch.refusal(unattended=True) is None  # and then it is killed, or fails in a way it should not
    for by_service in (False, True):
        assert "begun no flight" in refused(FlightLatch(latch.folder), unattended=by_service)


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
    assert refused(latch, unattended=False) == ""
    assert latch.read()[0] is LatchState.BEGUN
    latch.end("landed")
    assert latch.read() == (LatchState.ENDED, "landed")
    assert refused(latch, unattended=False) == ""


@pytest.mark.parametrize("by_service", [False, True])
def test_after_a_flight_that_never_ended_only_the_operator_s_word_helps(
    latch: FlightLatch, by_service: bool
) -> None:
    latch.permit()
    assert refused(latch, unattended=by_service) == ""  # and then it is killed
    for _ in range(3):
        reason = refused(latch, unattended=by_service)
        assert "never ended" in reason
        assert "companion permit" in reason
    latch.permit()
    assert refused(latch, unattended=by_service) == ""


def test_under_a_service_manager_each_flight_needs_its_own_permission(latch: FlightLatch) -> None:
    assert "not started at a terminal" in refused(latch, unattended=True)
    latch.permit()
    assert refused(latch, unattended=True) == ""
    latch.end("landed")
    assert "the last one ended: landed" in refused(latch, unattended=True)


@pytest.mark.parametrize(
    "content",
    [
        "", "{", "[]", "7", '{"state": "flown", "words": ""}', '{"state": "ended"}',
        pytest.param('{"state": "permitted", "words": ""}', id="an older version's permission"),
    ],
)  # fmt: skip
def test_a_file_that_nobody_understands_is_no_permission(latch: FlightLatch, content: str) -> None:
    latch.permit()
    latch.path.write_text(content, encoding="utf-8")
    for by_service in (False, True):
        assert refused(latch, unattended=by_service) != ""


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
        refused(latch, unattended=False)


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
    refused(FlightLatch(tmp_path), unattended=False)
    result = CliRunner().invoke(cli, ["permit", "--record", str(tmp_path)])
    assert result.exit_code == 0
    assert result.output.endswith("the next start may fly (the last flight never ended)\n")
    assert FlightLatch(tmp_path).read()[0] is LatchState.PERMITTED


@pytest.fixture
def permitted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FlightLatch:
    """Of a vehicle that may arm, under systemd."""
    monkeypatch.setenv("NOTIFY_SOCKET", "/run/systemd/notify")
    latch = FlightLatch(tmp_path)
    latch.permit()
    return latch


def start(latch: FlightLatch, *settings: str) -> None:
    file = latch.folder / "companion.yaml"
    file.write_text("\n".join(("plan: {mission: {may_arm: true}}", *settings)), encoding="utf-8")
    fly_the_vehicle(file, Output(latch.folder, None, live=False, console=Console(quiet=True)))


def test_a_permitted_start_that_ends_in_a_settings_error_leaves_the_next_one_permitted(
    permitted: FlightLatch,
) -> None:
    with pytest.raises(ConfigError, match="nobody_s"):
        start(permitted, "vehicle: nobody_s", f"link: {{connection: 'udpin:127.0.0.1:{free_port()}'}}")
    assert permitted.read()[0] is LatchState.PERMITTED


def test_a_permitted_start_that_fails_in_a_way_it_should_not_leaves_the_next_one_in_standby(
    permitted: FlightLatch, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_memory(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("companion.app.command.LivePage", no_memory)
    with pytest.raises(MemoryError):
        start(permitted)
    assert permitted.read()[0] is not LatchState.PERMITTED
    assert permitted.refusal(unattended=True) is not None


# ----------------
# The signing stamp on disk: written at orders and new streams, and at the end; read at the start.

KEY, STAMP = bytes(range(32)), 30_000_000_000_000


def signing(kept_stamp: int = 0) -> LinkSigning:
    return LinkSigning(KEY, STAMP, kept_stamp)


def signed(stamp: int, component_id: int = 1) -> bytes:
    codec = Codec(1, component_id)
    codec.sign(LinkSigning(KEY, stamp))
    return codec.encode(heartbeat())


def test_there_is_none_at_first_and_then_the_last(tmp_path: Path) -> None:
    file = StampFile(tmp_path / "state")
    assert file.read() == 0
    for stamp in (5, STAMP):
        file.write(stamp)
        assert file.read() == stamp
    assert [path.name for path in (tmp_path / "state").iterdir()] == [STAMP_NAME]


@pytest.mark.parametrize(
    "content", ["", "{", "[]", "{}", '{"stamp": -1}', '{"stamp": "5"}', '{"stamp": 1.5}']
)
def test_a_file_that_says_nothing_ends_the_start_in_one_line(tmp_path: Path, content: str) -> None:
    file = StampFile(tmp_path)
    file.path.write_text(content)
    with pytest.raises(ConfigError, match=r"signing\.json: unreadable; expected .* may be deleted") as caught:
        file.read()
    assert "\n" not in str(caught.value)


def test_one_that_cannot_be_read_or_written_says_so(tmp_path: Path) -> None:
    (tmp_path / STAMP_NAME).mkdir()
    with pytest.raises(ConfigError, match="a folder"):
        StampFile(tmp_path).read()
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be written"):
        StampFile(tmp_path / "file").write(1)


async def kept(file: StampFile, stamp: int) -> bool:
    """Whether the file has this stamp within a few turns of threads and loop."""
    for _ in range(500):
        if file.read() == stamp:
            return True
        await asyncio.sleep(0.01)
    return False


async def test_an_order_and_a_new_stream_are_kept_at_once_and_all_at_the_end(tmp_path: Path) -> None:
    file, ours = StampFile(tmp_path), signing()
    keeper = StampKeeper(file, ours, pytest.fail)
    task = asyncio.create_task(keeper.run())
    assert await kept(file, STAMP)
    assert ours.accepts(signed(STAMP + 10))
    keeper.note(ordered=False)
    assert await kept(file, STAMP + 11)
    assert ours.accepts(signed(STAMP + 20))
    keeper.note(ordered=True)
    assert await kept(file, STAMP + 21)
    assert ours.accepts(signed(STAMP + 30))
    keeper.note(ordered=False)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    assert file.read() == STAMP + 31
    after = signing(file.read())
    assert [after.accepts(signed(STAMP + n)) for n in (10, 20, 30, 31)] == [False, False, False, True]


async def test_a_full_disk_is_told_and_ends_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    told: list[str] = []
    keeper = StampKeeper(StampFile(tmp_path / "file"), signing(), told.append)
    task = asyncio.create_task(keeper.run())
    for _ in range(500):
        if told:
            break
        await asyncio.sleep(0.01)
    assert "recorded orders could be sent again after a restart" in told[0]
    assert not task.done()
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_without_a_key_nothing_is_kept(tmp_path: Path) -> None:
    keeper = StampKeeper(StampFile(tmp_path), None, pytest.fail)
    keeper.note(ordered=True)
    await keeper.run()
    assert StampFile(tmp_path).read() == 0
