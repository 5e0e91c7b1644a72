"""What holds for every test: no test finds what another has left on disk."""

import hashlib
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def own_state_folder(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The app's state (its latch) in a folder of this test, which is made when it is written to."""
    name = hashlib.sha256(request.node.nodeid.encode()).hexdigest()[:16]
    folder: Path = tmp_path_factory.getbasetemp() / "state" / name
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))
    for variable in ("STATE_DIRECTORY", "NOTIFY_SOCKET"):
        monkeypatch.delenv(variable, raising=False)
