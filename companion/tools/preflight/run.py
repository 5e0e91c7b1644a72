"""The preflight check: everything that can be known of a vehicle that stands there, untouched."""

import asyncio
import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from companion.app.hardware import app_at
from companion.app.service.systemd import SERVICE, ServiceState, service_state
from companion.base.clock import start_unix_s
from companion.base.magnetic_field import compare_declination
from companion.base.messages import Quantity, SourceComparison
from companion.base.second_sources import SourceState, judged
from companion.config import CompanionConfig, EstimateConfig
from companion.tools.preflight.autopilot import check_link, without_link
from companion.tools.preflight.calibrations import check_files
from companion.tools.preflight.computer import check_computer
from companion.tools.preflight.devices import check_devices, without_devices
from companion.tools.preflight.findings import NO_HINT, TAKEN, Finding, FindingGroup

# of the difference of two horizons at rest: accelerometers' offsets, and how the boards lie
HORIZON_STD_DEG: Final = 0.8
_GROUP: Final = FindingGroup("second sources")


def compared(
    devices: Sequence[Finding], link: Sequence[Finding], config: EstimateConfig, now: datetime
) -> list[Finding]:
    """What the findings of devices and link have measured: two horizons, and the magnetic field's place."""
    return [_horizons(devices, link), _declination([*devices, *link], config, now)]


def _horizons(devices: Sequence[Finding], link: Sequence[Finding]) -> Finding:
    horizons = [
        next((finding.horizon_rad for finding in found if finding.horizon_rad is not None), None)
        for found in (devices, link)
    ]
    ours, theirs = horizons
    if ours is None or theirs is None:
        return _GROUP.skip(Quantity.ATTITUDE, "it takes our IMU at rest and the autopilot's attitude")
    return _judged(
        SourceComparison(
            0.0,
            Quantity.ATTITUDE,
            _words(ours),
            _words(theirs),
            difference=math.degrees(math.dist(ours, theirs)),
            std=HORIZON_STD_DEG,
        )
    )


def _declination(found: Sequence[Finding], config: EstimateConfig, now: datetime) -> Finding:
    """The setting of the field against the model's where it stands: our fix, else the autopilot's home."""
    told_ned_ut, told_std_ut = config.magnetic_field_ned_ut, config.ekf.field_std_ut
    if told_ned_ut is None:
        return _GROUP.skip(
            Quantity.DECLINATION, "the World Magnetic Model's is taken in flight; it needs a GPS fix"
        )
    place = next((finding.place for finding in found if finding.place is not None), None)
    if place is None:
        return _GROUP.skip(Quantity.DECLINATION, "it takes a GPS fix, or the autopilot's home")
    return _judged(compare_declination(told_ned_ut, told_std_ut, place, now.timestamp()))


def _judged(comparison: SourceComparison) -> Finding:
    quantity = comparison.quantity
    row, state, figures = next(each for each in judged([comparison]) if each[0].quantity == quantity)
    if state is SourceState.REFUSED:
        return _GROUP.fail(row.quantity, figures, row.hint)
    if state is SourceState.DIFFERS:
        return _GROUP.warn(row.quantity, figures, row.hint)
    return _GROUP.ok(row.quantity, figures)


def _words(horizon_rad: tuple[float, float]) -> str:
    roll_deg, pitch_deg = map(math.degrees, horizon_rad)
    return f"roll {roll_deg:.1f}, pitch {pitch_deg:.1f} deg"


# ---------------------------------------------------------------- the preflight check

STOP_IT: Final = f"sudo systemctl stop {SERVICE}, check, and start it again"


async def preflight(
    config: CompanionConfig, path: Path, record: Path | None, *, linked: bool = True
) -> list[Finding]:
    """Check all at once; it takes about a quarter of a minute.

    An app that is running keeps its devices. Not `linked`, the autopilot is left out.
    """
    now = datetime.fromtimestamp(start_unix_s(virtual=True), UTC)
    camera, vehicle, found = check_files(config, path, now)
    state = service_state()
    if (running := _running(config, state)) is not None:
        who, hint = running
        devices = without_devices(config, f"{who} {TAKEN}", hint)
        link = without_link(f"{who} {TAKEN}", hint)
    else:
        devices, link = await asyncio.gather(
            check_devices(config, camera),
            check_link(config, vehicle) if linked else asyncio.sleep(0.0, without_link("--no-link", NO_HINT)),
        )
    found += devices + link + compared(devices, link, config.estimate, now)
    return found + check_computer(record, state, now)


def _running(config: CompanionConfig, state: ServiceState | None) -> tuple[str, str] | None:
    """Which app has the devices, and how to stop it: the service, or one that was started otherwise."""
    if state is not None and state.running:
        return "the service", STOP_IT
    who = app_at(config.link.connection)
    return None if who is None else (who, "stop it, check, and start it again")
