"""Files: where settings are found, and writing so that nobody ever sees half of a file."""

import fcntl
import io
import os
import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from companion.base.errors import ConfigError

SETTINGS_FILE: Final = "a file of settings in YAML"
YAML_SUFFIXES: Final = (".yaml", ".yml", ".json")  # JSON is YAML, too
_PACKAGE: Final = Path(__file__).resolve().parents[1]
# an installed package has them within it, a checkout beside it
_INSTALLED: Final = _PACKAGE / "configs"
CONFIG_FOLDER: Final = _INSTALLED if _INSTALLED.is_dir() else _PACKAGE.parent / "configs"
# where systemd/install.sh puts each version of the program, and the settings of the service
_SERVICE_PREFIX: Final = Path("/opt/companion")
_SERVICE_SETTINGS: Final = Path("/etc/companion/companion.yaml")


def shipped_file(name: str) -> Path:
    """A shipped file of settings as a person finds it, in the version that is in use."""
    installed = CONFIG_FOLDER.is_relative_to(_SERVICE_PREFIX)
    return (_SERVICE_PREFIX / "current" / "configs" if installed else CONFIG_FOLDER) / name


def default_settings() -> Path:
    """The settings of who names none: the service's for the program that it runs, else the shipped ones."""
    installed = CONFIG_FOLDER.is_relative_to(_SERVICE_PREFIX) and os.access(_SERVICE_SETTINGS, os.F_OK)
    return _SERVICE_SETTINGS if installed else CONFIG_FOLDER / "companion.yaml"


DEFAULT_SETTINGS: Final = default_settings()


def find_file(folder: str, name: str | Path) -> Path:
    """Path of a settings file given by path, or by name within configs/<folder>.

    Raises:
        ConfigError: no such file; for a name the line lists those that there are.
    """
    path = Path(name)
    if path.suffix in YAML_SUFFIXES and path.is_file():
        return path
    shipped = CONFIG_FOLDER / folder / f"{name}.yaml"
    if path.suffix == "" and shipped.is_file():
        return shipped
    if path.suffix in YAML_SUFFIXES:
        raise ConfigError(f"{folder}: no file '{name}'; expected the path of one that there is, or a name")
    names = ", ".join(sorted(p.stem for p in (CONFIG_FOLDER / folder).glob("*.yaml")))
    if path.is_dir():
        raise ConfigError(f"{path}: a folder; expected a .yaml file, or one of configs/{folder}: {names}")
    raise ConfigError(f"{folder}: no '{name}'; expected the path of a .yaml file or one of: {names}")


def cannot_read(
    path: Path, error: OSError, key: str | None = None, expected: str | None = None
) -> ConfigError:
    """The error for a file that cannot be read; `key` is the setting or option that names it."""
    lead = "" if key is None else f"{key}: "
    if isinstance(error, IsADirectoryError):
        return ConfigError(f"{lead}{path}: a folder; expected {expected or 'a file'}")
    tail = "" if expected is None else f"; expected {expected}"
    return ConfigError(f"{lead}{path}: cannot be read: {error.strerror}{tail}")


def must_exist(path: Path, expected: str) -> None:
    """See that a file or folder is there, before what takes long to import would open it.

    Raises:
        ConfigError: it is not; the line ends in what was `expected`.
    """
    if not path.exists():
        raise ConfigError(f"{path}: cannot be read: No such file or directory; {expected}")


def must_be_readable(path: Path, expected: str = SETTINGS_FILE) -> None:
    """Open a file and close it again, before what takes long to import would read it.

    Raises:
        ConfigError: it cannot be read; the line ends in what was `expected`.
    """
    try:
        path.open("rb").close()
    except OSError as error:
        raise cannot_read(path, error, expected=expected) from error


def must_be_writable(option: str, path: Path, suffix: str = "") -> None:
    """See that a file can be written, before the work whose result it is to hold.

    What `replaced` will write to is opened: permissions show nothing of a folder by that name or a read-only
    disk, and a file that may be written to is of no use in a folder that takes no other.

    Raises:
        ConfigError: it cannot, or does not end in the suffix.
    """
    expected = f"{option} {path}: expected a {suffix and f'{suffix} '}file in an existing folder"
    if not path.name.lower().endswith(suffix):
        raise ConfigError(expected)
    if path.exists() and not (path.is_file() or path.is_dir()):
        return  # a device or a named pipe
    try:
        written = _written_to(Path(os.path.realpath(path)))
        existed = written.exists()
        written.open("ab").close()
        if not existed:
            written.unlink()
    except OSError as error:
        raise ConfigError(f"{expected}: {error.strerror}") from error


def make_folder(option: str, folder: Path) -> Path:
    """The folder, which is made, and those above it.

    Raises:
        ConfigError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            f"{option} {folder}: cannot be made: {error.strerror}; expected a folder"
        ) from error
    return folder


@contextmanager
def unpacked(path: Path) -> Iterator[Path]:
    """Yield the path, or the folder in it where it is a zip file as `companion logs export` writes one.

    Raises:
        ConfigError: the zip file is damaged, or holds more than one folder.
    """
    if not (path.is_file() and zipfile.is_zipfile(path)):
        yield path
        return
    with tempfile.TemporaryDirectory() as scratch:
        try:
            with zipfile.ZipFile(path) as archive:
                archive.extractall(scratch)
        # a damaged one raises whatever Python raises where it was damaged
        except Exception as error:
            why = error.strerror if isinstance(error, OSError) else error
            raise ConfigError(
                f"{path}: cannot be unpacked: {why}; expected a whole exported flight"
            ) from error
        inside = list(Path(scratch).iterdir())
        if len(inside) != 1 or not inside[0].is_dir():
            raise ConfigError(f"{path}: expected one flight's folder in it, as companion logs export writes")
        yield inside[0]


def _written_to(target: Path) -> Path:
    """What is written first: the target itself if that is no file to be replaced, else one beside it."""
    if target.exists() and not target.is_file():
        return target
    return target.with_name(target.name + ".part")


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Yield the path to write to; what was written takes the place of a regular file when all is there.

    A symbolic link stays one: what it points to is written. A device or a named pipe is no place to rename a
    file onto: it is written to directly. A file that was there keeps its mode. After an error nothing is left
    beside it.
    """
    target = Path(os.path.realpath(path))
    part = _written_to(target)
    if part == target:
        yield target
        return
    try:
        yield part
        if target.exists():
            shutil.copymode(target, part)
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write a file whole, text as UTF-8, or leave what was there; see `replaced` for what is no file.

    Raises:
        ConfigError: it cannot be written.
    """
    try:
        with replaced(path) as part:
            part.write_bytes(content.encode() if isinstance(content, str) else content)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error


def save_figure(figure: Any, path: Path, **options: Any) -> None:
    """Write a figure of Matplotlib's whole, in the form that the name ends in; see `write_atomically`.

    Raises:
        ConfigError: it cannot be written.
    """
    data = io.BytesIO()
    figure.savefig(data, format=path.suffix.removeprefix(".") or "png", **options)
    write_atomically(path, data.getvalue())


def write_durably(path: Path, content: str) -> None:
    """Replace a text file so that even a power cut leaves the old one or the new one; its folder is made.

    Raises:
        ConfigError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replaced(path) as part, part.open("w", encoding="utf-8") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be written: {error.strerror}; expected a folder to write to"
        ) from None


# ---------------------------------------------------------------- devices
# One program of ours at a device: a second one reads away what the first waits for, or sets it up anew. A
# lock on the open file (flock(2)): the kernel drops it with the file, however the program ends. It keeps
# nobody else away who does not ask for it, such as `i2cdetect`.

TAKEN: Final = "busy; expected a device that no other program has open"


def take_alone(descriptor: int) -> None:
    """Take an open device for this program.

    Raises:
        BlockingIOError: another one has it.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise BlockingIOError(error.errno, TAKEN) from None
