"""The driver on captures of real u-blox receivers, with another program's reading of them beside.

The captures are not part of the project: without the folder these tests are skipped.
"""

import json
from pathlib import Path
from typing import Any

import pytest

from companion.base.messages import GpsFix
from companion.config import CONFIG_FOLDER, GpsConfig
from companion.sense.gps.neo6m import Neo6m

ROOT = CONFIG_FOLDER.parent
CANDIDATES = [parent / "shared" / "data" / "gps" for parent in ROOT.parents]  # beside the checkout
FOLDER = next((folder for folder in CANDIDATES if folder.is_dir()), CANDIDATES[0])
BYTES_A_SECOND = 960
DEGREE_M = 111_320.0
pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"no captures of real receivers in {FOLDER}, which are no part of the project"
)
CAPTURES = sorted(FOLDER.glob("*.log"))


def decode(data: bytes, piece: int) -> list[GpsFix]:
    driver = Neo6m(GpsConfig(baud=9600))
    fixes: list[GpsFix] = []
    for start in range(0, len(data), piece):
        end = min(len(data), start + piece)
        fixes += driver.feed(data[start:end], end / BYTES_A_SECOND)
    return fixes


def reference(capture: Path) -> list[dict[str, Any]]:
    """The other program's three-dimensional fixes, one for each instant."""
    found: dict[str, dict[str, Any]] = {}
    for line in capture.with_name(capture.name + ".chk").read_text(errors="replace").splitlines():
        if line.startswith("{"):
            report = json.loads(line)
            if report["class"] == "TPV" and report.get("mode", 0) >= 3 and "time" in report:
                found.setdefault(report["time"], report)
    return list(found.values())


@pytest.mark.parametrize("piece", [1, 7, 64, 100_000])
@pytest.mark.parametrize("capture", CAPTURES, ids=lambda path: path.stem)
def test_every_fix_is_one_of_the_references(capture: Path, piece: int) -> None:
    fixes, expected = decode(capture.read_bytes(), piece), reference(capture)
    assert expected
    assert fixes
    # a fix of several messages cannot be told before the last: an epoch at either end may be missing
    assert len(expected) - 2 <= len(fixes) <= len(expected)
    for fix in fixes:
        near = min(
            expected, key=lambda e: abs(e["lat"] - fix.latitude_deg) + abs(e["lon"] - fix.longitude_deg)
        )
        assert abs(fix.latitude_deg - near["lat"]) * DEGREE_M < 0.02
        assert abs(fix.longitude_deg - near["lon"]) * DEGREE_M < 0.02
        speed = (fix.velocity_ned_m_s[0] ** 2 + fix.velocity_ned_m_s[1] ** 2) ** 0.5
        assert speed == pytest.approx(near["speed"], abs=0.3)
        # NAV-SOL alone knows the ellipsoid, and says how little it knows of the sea
        assert any(abs(fix.altitude_m - near[key]) < 0.06 for key in ("altMSL", "altHAE"))
        assert abs(fix.altitude_m - near["altMSL"]) <= fix.vertical_accuracy_m


@pytest.mark.parametrize("capture", CAPTURES, ids=lambda path: path.stem)
def test_fixes_come_in_order(capture: Path) -> None:
    times = [fix.time_s for fix in decode(capture.read_bytes(), 64)]
    assert times == sorted(set(times))


def test_a_start_without_a_fix_gives_no_position() -> None:
    """nl551e: eleven seconds of sentences before the first fix, none of them a position."""
    data = next(path for path in CAPTURES if path.stem == "nl551e").read_bytes()
    first_fix = data.index(b",A,5200.")
    start = data.rindex(b"$GPRMC", 0, first_fix)
    assert data[:start].count(b"$GPRMC") >= 3
    assert decode(data[:start], 64) == []
    assert decode(data, 64)


@pytest.mark.parametrize("capture", CAPTURES, ids=lambda path: path.stem)
def test_a_capture_with_every_hundredth_byte_damaged_gives_no_other_position(capture: Path) -> None:
    data = bytearray(capture.read_bytes())
    for at in range(50, len(data), 100):
        data[at] ^= 0x10
    expected = reference(capture)
    for fix in decode(bytes(data), 64):
        assert min(abs(e["lat"] - fix.latitude_deg) * DEGREE_M for e in expected) < 0.02
