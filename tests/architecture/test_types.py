"""Types: mypy, strict, over all there is; beside other tests it costs no time of its own."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_types_fit() -> None:
    done = subprocess.run(
        (sys.executable, "-m", "mypy"), cwd=ROOT, capture_output=True, text=True, timeout=500, check=False
    )
    assert done.returncode == 0, f"{done.stdout[-3000:]}{done.stderr[-1000:]}"
