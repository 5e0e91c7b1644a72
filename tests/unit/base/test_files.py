"""Files are written whole."""

import errno
import os
import re
import shutil
import stat
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from companion.base.files import must_be_writable, save_figure, unpacked, write_atomically, write_durably
from companion.config import CONFIG_FOLDER, ConfigError


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text("old")
    write_atomically(path, "new\n")
    assert path.read_text() == "new\n"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_a_link_and_a_file_keeps_its_mode(tmp_path: Path) -> None:
    target, link = tmp_path / "kept.json", tmp_path / "link.json"
    target.write_text("old")
    target.chmod(0o640)
    link.symlink_to(target.name)
    write_atomically(link, "new\n")
    assert link.is_symlink()
    assert target.read_text() == "new\n"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    dangling = tmp_path / "dangling.json"
    dangling.symlink_to("made.json")
    write_atomically(dangling, "made\n")
    assert (tmp_path / "made.json").read_text() == "made\n"


def test_a_named_pipe_is_written_to_and_stays_one(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with ThreadPoolExecutor(1) as pool:
        read = pool.submit(pipe.read_text)
        write_atomically(pipe, "through\n")
        assert read.result(10.0) == "through\n"
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]


def test_a_device_stays_one(tmp_path: Path) -> None:
    device = tmp_path / "full"
    try:
        os.mknod(device, stat.S_IFCHR | 0o666, os.makedev(1, 7))
        device.open("wb").close()
    except PermissionError:
        pytest.skip("a device file needs root, on a file system that has them")
    with pytest.raises(ConfigError, match="cannot be written: No space left"):
        write_atomically(device, "lost\n")
    assert device.is_char_device()
    assert list(tmp_path.iterdir()) == [device]


@pytest.mark.parametrize(
    ("write", "place", "name"), [(write_atomically, Path, "write_bytes"), (write_durably, os, "fsync")]
)
def test_a_disk_that_fills_up_leaves_the_old_file_and_nothing_else(
    write: Callable[[Path, str], None],
    place: object,
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / "result.json"
    path.write_text("old")

    def full(file: Path | int, *_: object) -> None:
        if isinstance(file, Path):
            file.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(place, name, full)
    with pytest.raises(ConfigError, match="No space left"):
        write(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_no_other_place_renames_a_file_onto_an_output() -> None:
    # what stands in the way of an output is known to `replaced` alone; the latch is nobody's choice
    own = {"companion/base/files.py", "companion/app/service/latch.py"}
    root = CONFIG_FOLDER.parent
    for folder in ("companion", "sitl", "calibration"):
        for path in (root / folder).rglob("*.py"):
            renames = re.search(r"\b(part|fresh|scratch)\.(replace|rename)\(", path.read_text())
            assert renames is None or str(path.relative_to(root)) in own, path


def test_a_figure_is_drawn_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "path.png"
    save_figure(Figure(figsize=(1.0, 1.0)), path, dpi=50)
    drawn = path.read_bytes()
    assert drawn.startswith(b"\x89PNG")

    def full(self: Path, _: bytes) -> int:
        self.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(ConfigError, match=r"path\.png: cannot be written: No space left"):
        save_figure(Figure(figsize=(1.0, 1.0)), path, dpi=60)
    assert path.read_bytes() == drawn
    assert list(tmp_path.iterdir()) == [path]


def test_no_other_place_draws_a_figure_into_a_file() -> None:
    root = CONFIG_FOLDER.parent
    for folder in ("companion", "sitl", "calibration"):
        for path in (root / folder).rglob("*.py"):
            own = path.match("companion/base/*") or path.match("companion/base/printing/*")
            if not (own or "research" in path.parts):  # the paper's figures are no operator's
                assert ".savefig(" not in path.read_text(), path


def test_an_exported_flight_is_unpacked_and_anything_else_is_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "flight-0007").mkdir()
    (tmp_path / "flight-0007" / "flight.mcap").write_bytes(b"log")
    with unpacked(tmp_path / "flight-0007") as flight:
        assert flight == tmp_path / "flight-0007"
    packed = tmp_path / "flight-0007.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        archive.write(tmp_path / "flight-0007" / "flight.mcap", "flight-0007/flight.mcap")
    with unpacked(packed) as flight:
        assert flight.name == "flight-0007"
        assert (flight / "flight.mcap").read_bytes() == b"log"
    with zipfile.ZipFile(packed, "a") as archive:
        archive.writestr("flight-0008/flight.mcap", b"another")
    with pytest.raises(ConfigError, match="expected one flight's folder"), unpacked(packed):
        pass


def test_a_damaged_zip_is_named(tmp_path: Path) -> None:
    packed = tmp_path / "flight-0007.zip"
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("flight-0007/flight.mcap", bytes(range(256)) * 40)
    data = packed.read_bytes()
    for damaged in (data[:60] + b"\xff" + data[61:], data[:100] + data[200:]):
        packed.write_bytes(damaged)
        with (
            pytest.raises(ConfigError, match=r"zip: cannot be unpacked: [^\[]"),
            unpacked(packed),
        ):
            pass


def test_an_output_is_tried_where_it_will_be_written(tmp_path: Path) -> None:
    """Beside it, whether or not it is there: a file that may be written to can lie where no other may."""
    there, missing, link = (tmp_path / name for name in ("there.yaml", "missing.yaml", "link.yaml"))
    there.write_text("old\n")
    link.symlink_to(tmp_path / "folder" / "target.yaml")
    (tmp_path / "folder").mkdir()
    for path in (there, missing, link):
        must_be_writable("--output", path, ".yaml")
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["folder", "link.yaml", "there.yaml"]
    assert there.read_text() == "old\n"
    for beside in (there, missing, tmp_path / "folder" / "target.yaml"):
        beside.with_name(f"{beside.name}.part").mkdir()  # so that nobody, root neither, can write one
    for path in (there, missing, link):
        with pytest.raises(ConfigError, match=r"--output .*: expected a \.yaml file in an existing folder"):
            must_be_writable("--output", path, ".yaml")
        with pytest.raises(ConfigError, match="cannot be written"):
            write_atomically(path, "new\n")


def test_a_folder_that_is_not_there_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none/result.json: cannot be written: No such file"):
        write_atomically(tmp_path / "none" / "result.json", "new\n")


@pytest.mark.parametrize("installed", [True, False])
def test_the_shipped_settings_are_in_the_installed_package_and_beside_it_in_a_checkout(
    installed: bool, tmp_path: Path
) -> None:
    base = tmp_path / "companion" / "base"
    base.mkdir(parents=True)
    for package in (base, base.parent):
        (package / "__init__.py").touch()
    for module in ("files.py", "errors.py"):
        shutil.copy(CONFIG_FOLDER.parent / "companion" / "base" / module, base)
    for folder in (base.parent, tmp_path) if installed else (tmp_path,):
        (folder / "configs").mkdir()
    said = subprocess.run(
        [sys.executable, "-c", "from companion.base.files import CONFIG_FOLDER; print(CONFIG_FOLDER)"],
        cwd=tmp_path,
        env={"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert Path(said.strip()) == (base.parent if installed else tmp_path) / "configs"


def test_the_wheel_puts_the_settings_into_the_package() -> None:
    project = tomllib.loads((CONFIG_FOLDER.parent / "pyproject.toml").read_text())
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["packages"] == ["companion", "sitl", "calibration"]
    assert wheel["force-include"] == {"configs": "companion/configs"}
