"""The documentation builds as a site, without a warning and without the network."""

import os
import re
import subprocess
import sys
from pathlib import Path

from companion.config import CONFIG_FOLDER

ROOT = CONFIG_FOLDER.parent
# what a browser would fetch by itself; links that a reader follows may lead anywhere
FETCHED = re.compile(r"<(?:script|img|link rel=\"(?:stylesheet|preconnect)\")[^>]*\"(?:https?:)?//")


def test_the_site_builds_and_fetches_nothing(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) > 30
    assert [page.name for page in pages if FETCHED.search(page.read_text(encoding="utf-8"))] == []
