"""A simulated vehicle in another process, standing on its pad."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from companion.config import CONFIG_FOLDER

ROOT = CONFIG_FOLDER.parent
PATIENCE_S = 40.0


@contextmanager
def held(folder: Path, scenario: str = "static") -> Iterator[Path]:
    """A vehicle that stands on its pad, as a process; yields the settings file that it has written."""
    settings = folder / "mine.yaml"
    ports = ("--port", "0", "--gcs-port", "0", "--tcp-port", "0")
    words = (
        "-m",
        "sitl.cli",
        "hand-held",
        "--motion",
        "still",
        "--scenario",
        scenario,
        "--folder",
        str(folder),
        *ports,
    )
    with subprocess.Popen(
        (sys.executable, *words, "--settings", str(settings)), cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        try:
            for line in process.stdout:
                if str(settings) in line:
                    break
            yield settings
        finally:
            process.terminate()
            process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
