"""Real autopilots' logs, where they lie beside the checkout (they are too large to keep in it)."""

import pytest

from companion.config import CONFIG_FOLDER
from companion.flightlog.replay.compare import ReplayResult, build_result
from companion.flightlog.replay.job import read_log
from companion.flightlog.replay.run import replay
from companion.flightlog.replay.settings import choose

LOGS = CONFIG_FOLDER.parent.parent / "shared" / "data" / "flightlogs"


def replayed(name: str) -> ReplayResult:
    path = LOGS / name
    if not path.exists():
        pytest.skip(f"{path} is not there: a log of somebody's flight, not part of the project")
    record = read_log(path)
    choice = choose(record, None)
    result = replay(record.events, choice.rig)
    return build_result(
        record, result, log=str(path), settings=choice.name, field=choice.field, repeats=choice.repeats
    )


def test_a_handheld_px4_of_2016_without_gps() -> None:
    result = replayed("sample.ulg")
    errors = result.errors["recorded"]
    assert errors.inclination_deg is not None
    assert errors.heading_deg is not None
    assert errors.inclination_deg.rms < 1.5
    assert errors.heading_deg.rms < 1.0
    assert result.samples == {"imu": 17070, "mag": 6759}


def test_a_px4_of_2021_whose_magnetometer_is_disturbed() -> None:
    errors = replayed("sample_log_small.ulg").errors["recorded"]
    assert errors.inclination_deg is not None
    assert errors.inclination_deg.rms < 0.5


def test_an_arducopter_of_2015_until_it_crashes() -> None:
    result = replayed("log171.bin")
    errors = result.errors["recorded"]
    assert errors.inclination_deg is not None
    assert result.field.source == "World Magnetic Model at -35.362, 149.166, 2015.9"
    assert result.samples == {"gps": 1038, "imu": 11916, "mag": 2384}
    assert errors.velocity_m_s is not None
