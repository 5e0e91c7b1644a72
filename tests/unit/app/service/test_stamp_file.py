"""The signing stamp on disk: written at orders and new streams, and at the end; read at the start."""

import asyncio
from pathlib import Path

import pytest

from companion.app.service.stamp_file import FILE_NAME, StampFile, StampKeeper
from companion.base.errors import ConfigError
from companion.link.codec import Codec, heartbeat
from companion.link.signing import LinkSigning, SigningKey

KEY, STAMP = bytes(range(32)), 30_000_000_000_000


def signing(kept_stamp: int = 0) -> LinkSigning:
    return LinkSigning(SigningKey(KEY, STAMP, kept_stamp))


def signed(stamp: int, component_id: int = 1) -> bytes:
    codec = Codec(1, component_id)
    codec.sign(LinkSigning(SigningKey(KEY, stamp)))
    return codec.encode(heartbeat())


def test_there_is_none_at_first_and_then_the_last(tmp_path: Path) -> None:
    file = StampFile(tmp_path / "state")
    assert file.read() == 0
    for stamp in (5, STAMP):
        file.write(stamp)
        assert file.read() == stamp
    assert [path.name for path in (tmp_path / "state").iterdir()] == [FILE_NAME]


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
    (tmp_path / FILE_NAME).mkdir()
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
