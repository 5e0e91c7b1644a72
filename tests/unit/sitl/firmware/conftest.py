"""A program of either kind, which answers from its first step."""

from pathlib import Path

import pytest

from companion.base.autopilot_kind import AutopilotKind
from sitl.firmware import px4
from tests.unit.sitl.firmware.fake_firmware import Fake, fake


@pytest.fixture(params=["px4", "ardupilot"])
def kind(request: pytest.FixtureRequest) -> AutopilotKind:
    chosen: AutopilotKind = request.param
    return chosen


@pytest.fixture
def program(kind: AutopilotKind, tmp_path: Path) -> Fake:
    return fake(kind, tmp_path)


@pytest.fixture
def answered_from_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """However busy the machine, the fake is not taken for one that boots."""
    monkeypatch.setattr(px4, "BOOTING_STEP_S", 5.0)
