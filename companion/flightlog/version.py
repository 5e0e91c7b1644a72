"""What a flight was flown with: settings, versions of this program and its libraries, its git revision."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Final

import yaml
from pydantic import BaseModel

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


@dataclass(frozen=True, slots=True)
class SettingsRecord:
    """Settings and versions as a log holds them: `models` as JSON by name, `text` the YAML for people."""

    settings: Mapping[str, BaseModel]
    models: dict[str, str]
    versions: dict[str, str]
    text: str

    @classmethod
    def of(cls, settings: Mapping[str, BaseModel]) -> SettingsRecord:
        """Asks git for the revision and writes YAML: 0.05 s on a desktop."""
        known = versions()
        models = {name: model.model_dump_json() for name, model in settings.items()}
        plain = {"versions": known, **{name: json.loads(text) for name, text in models.items()}}
        text = yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, width=110)
        return cls(settings, models, known, text)
