"""What a flight was flown with: versions of this program and its libraries, and its git revision."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Final

from companion import __version__

# what computes the estimates is what their last digits hang on
VERSIONED: Final = ("numpy", "scipy", "filterpy", "pymap3d")
ROOT: Final = Path(__file__).resolve().parents[2]
# what systemd/install.sh leaves beside the environment, since an installed program has no history
REVISION_FILE: Final = Path(sys.prefix).parent / "REVISION"
GIT_PATIENCE_S: Final = 5.0


def versions() -> dict[str, str]:
    """Versions by name, and `revision` where it is known; what is not installed has none."""
    found = {"companion": __version__}
    for name in VERSIONED:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    if (known := revision()) is not None:
        found["revision"] = known
    return found


@cache
def revision() -> str | None:
    """The git commit that runs, with "-dirty" after it where the files differ from it; None without one."""
    with contextlib.suppress(OSError):
        return REVISION_FILE.read_text(encoding="utf-8").strip() or None
    if not (ROOT / ".git").exists():
        return None
    command = ("git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*")
    try:
        described = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=GIT_PATIENCE_S,
            check=True,
            env={**os.environ, "GIT_OPTIONAL_LOCKS": "0"},
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return described.stdout.strip() or None
