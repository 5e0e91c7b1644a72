"""Files are written whole."""

from pathlib import Path

import pytest

from companion.base.files import write_atomically
from companion.config import ConfigError


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text("old")
    write_atomically(path, "new\n")
    assert path.read_text() == "new\n"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none/result.json: cannot be written: No such file"):
        write_atomically(tmp_path / "none" / "result.json", "new\n")
