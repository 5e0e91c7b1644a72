"""Made-up releases and a made-up system for the installer's tests: no systemd, no network, no root.

A release holds a wheel of a few lines in place of ours; its programs answer from files in the system's
folder: `active` (the service runs), `state` (else systemd's word for it), `status.json` (its answer),
`starts` (the versions that were started).
`after-switch.json` and `after-start.json` are its answers from then on, where they are there.
"""

from __future__ import annotations

import ensurepip
import hashlib
import json
import os
import shutil
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

SYSTEMD: Final = Path(__file__).resolve().parents[2] / "systemd"
PIP: Final = next((Path(ensurepip.__file__).parent / "_bundled").glob("pip-*.whl"), None)
TAG: Final = f"cp{sys.version_info[0]}{sys.version_info[1]}"
STANDING_BY: Final[dict[str, Any]] = {"phase": "standby", "order": None, "armed": False, "problems": []}

SYSTEMCTL: Final = """#!/bin/bash
version="$(basename "$(readlink -f "$COMPANION_BASE/opt/companion/current")")"
answers_as() {
    [ ! -e "$COMPANION_BASE/$1.json" ] || mv "$COMPANION_BASE/$1.json" "$COMPANION_BASE/status.json"
}
start() {
    echo "$version" >>"$COMPANION_BASE/starts"
    [ ! -L "$COMPANION_BASE/opt/companion/previous" ] \
        || basename "$(readlink "$COMPANION_BASE/opt/companion/previous")" >"$COMPANION_BASE/way_back"
    rm -f "$COMPANION_BASE"/{active,state}
    [ ! -e "$COMPANION_BASE/opt/companion/versions/$version/configs/fault" ] || return 1
    touch "$COMPANION_BASE/active"
    answers_as after-start
}
case "$*" in
    *is-active*) [ -e "$COMPANION_BASE/active" ] ;;
    *ActiveState*) [ -e "$COMPANION_BASE/active" ] && echo active \\
        || cat "$COMPANION_BASE/state" 2>/dev/null || echo failed ;;
    *MainPID*) wc -l <"$COMPANION_BASE/starts" ;;
    restart*) start ;;
    daemon-reload*) answers_as after-switch ;;
    disable*) rm -f "$COMPANION_BASE/active" ;;
    cat*) cat "$COMPANION_BASE"/etc/systemd/system/companion.service{,.d/*} ;;
esac
"""
SYSTEMD_RUN: Final = """#!/bin/bash
for word; do
    shift
    case "$word" in
        --property=Environment=*) eval "export ${word#*=*=}" ;;
        --property=EnvironmentFile=*) set -a && . "${word#*=*=}" && set +a ;;
        --setenv=*) export "${word#*=}" ;;
        --) exec "$@" ;;
    esac
done
"""
PASSED_ON: Final = '#!/bin/bash\nwhile [ "$1" != -- ]; do shift; done\nshift\nexec "$@"\n'
ANSWERS: Final = '#!/bin/sh\n[ -e "$COMPANION_BASE/active" ] && cat "$COMPANION_BASE/status.json"\n'
PROGRAM: Final = """
import json, os, pathlib, sys
from companion import __version__
base = pathlib.Path(os.environ["COMPANION_BASE"])
def main():
    if sys.argv[1:] == ["--version"]:
        print(__version__)
    elif (pathlib.Path(__file__).parent / "configs/mute").exists():
        sys.exit(2)
    elif (base / "status.json").exists() and (base / "active").exists():
        print((base / "status.json").read_text())
        sys.exit(1)  # not healthy, and it answers
    else:
        print("nobody answers", file=sys.stderr)
        sys.exit(2)
"""


@dataclass(frozen=True)
class System:
    """A root folder, and the programs that stand for the system's."""

    base: Path
    programs: Path

    @classmethod
    def made(cls, folder: Path) -> System:
        base, programs = folder / "root", folder / "programs"
        for path in (base / "etc/systemd/system", base / "etc/companion", programs):
            path.mkdir(parents=True)
        for name, text in {
            "systemctl": SYSTEMCTL,
            "systemd-run": SYSTEMD_RUN,
            "runuser": PASSED_ON,
            **dict.fromkeys(("groupadd", "useradd", "journalctl"), "#!/bin/sh\n"),
        }.items():
            (programs / name).write_text(text)
            (programs / name).chmod(0o755)
        (base / "starts").touch()
        return cls(base, programs)

    def run(self, *words: str | Path, **variables: str) -> subprocess.CompletedProcess[str]:
        """A program of the release."""
        return subprocess.run(
            [str(word) for word in words],
            env={
                **{key: value for key, value in os.environ.items() if not key.startswith(("PIP_", "PYTHON"))},
                "PATH": f"{self.programs}:{Path(sys.executable).parent}:{os.environ['PATH']}",
                "COMPANION_BASE": str(self.base),
                "COMPANION_USER": "root",
                "COMPANION_PATIENCE_S": "2",
                "COMPANION_STEADY_S": "0",
                **variables,
            },
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )

    def serves(self, **status: Any) -> None:
        """The service runs, and answers so."""
        (self.base / "active").touch()
        self.will_answer("status", **status)

    def will_answer(self, when: str, **status: Any) -> None:
        """What it answers from `after-switch` or `after-start` on."""
        (self.base / f"{when}.json").write_text(json.dumps({**STANDING_BY, **status}))

    def has(self, *versions: str) -> None:
        """Versions are laid down, without environments of their own; the first one is in use."""
        for version in versions:
            program = self.prefix / "versions" / version / ".venv/bin/companion"
            program.parent.mkdir(parents=True)
            program.write_text(ANSWERS)
            program.chmod(0o755)
            (self.prefix / "versions" / version / "companion.service").write_text(f"# {version}\n")
            (self.prefix / "versions" / version / "COMPLETE").touch()
        (self.prefix / "current").symlink_to(f"versions/{versions[0]}")

    @property
    def prefix(self) -> Path:
        return self.base / "opt/companion"

    @property
    def in_use(self) -> str | None:
        link = self.prefix / "current"
        return link.readlink().name if link.is_symlink() else None

    @property
    def versions(self) -> set[str]:
        return {path.name for path in (self.prefix / "versions").iterdir()}

    @property
    def starts(self) -> list[str]:
        return (self.base / "starts").read_text().split()


def release(folder: Path, version: str, *, fault: str = "", needs: str = "") -> Path:
    """A release. `fault`: "fault", it does not start, or "mute"; `needs`: what no wheel is there for."""
    bundle = folder / f"companion-{version}-{os.uname().machine}"
    (bundle / "wheels").mkdir(parents=True)
    assert PIP is not None
    shutil.copy(PIP, bundle / "wheels")
    _wheel(bundle / "wheels", version, fault=fault, needs=needs)
    for name in ("install.sh", "versions.sh", "companion-rollback", "companion.service"):
        shutil.copy(SYSTEMD / name, bundle)
    for name, text in {
        "README.md": "",
        "CHANGELOG.md": "",
        "LICENSE": "",
        "constraints.txt": "",
        "REVISION": "abc",
        "PYTHONS": TAG,
        "ARCHITECTURE": os.uname().machine,
    }.items():
        (bundle / name).write_text(f"{text}\n")
    with (bundle / "companion.service").open("a") as unit:
        unit.write(f"# {version}\n")
    sums = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  ./{path.relative_to(bundle)}\n"
        for path in sorted(bundle.rglob("*"))
        if path.is_file()
    ]
    (bundle / "SHA256SUMS").write_text("".join(sums))
    return bundle


def _wheel(folder: Path, version: str, *, fault: str, needs: str) -> None:
    info = f"companion_landing-{version}.dist-info"
    files = {
        "companion/__init__.py": f'__version__ = "{version}"\n',
        "companion/cli.py": PROGRAM,
        "companion/app/__init__.py": "",
        "companion/app/command.py": "",
        "companion/app/app.py": "",
        "companion/configs/companion.yaml": "# shipped\n",
        **({f"companion/configs/{fault}": ""} if fault else {}),
        f"{info}/METADATA": (
            f"Metadata-Version: 2.1\nName: companion-landing\nVersion: {version}\nProvides-Extra: release\n"
            + (f"Requires-Dist: {needs}\n" if needs else "")
        ),
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: tests\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/entry_points.txt": "[console_scripts]\ncompanion = companion.cli:main\n",
    }
    record = "".join(f"{name},,\n" for name in [*files, f"{info}/RECORD"])
    with zipfile.ZipFile(folder / f"companion_landing-{version}-py3-none-any.whl", "w") as wheel:
        for name, text in {**files, f"{info}/RECORD": record}.items():
            wheel.writestr(name, text)
