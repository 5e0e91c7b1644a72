"""The computer: its clock, its disk, its power, and whether the service is installed, enabled and running."""

import os
import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from companion.app.service.systemd import SERVICE, ServiceState, output_of, throttled_bits
from companion.flightlog.commands import SERVICE_FLIGHTS
from companion.tools.preflight.findings import Finding, FindingGroup

LEAST_FREE_MB, LOW_FREE_MB = 200, 2000  # a flight leaves up to 100 MB a minute
# of vcgencmd get_throttled
UNDER_VOLTAGE, THROTTLED, HOT, UNDER_VOLTAGE_SINCE = 0x1, 0x4, 0x8, 0x10000
_GROUP: Final = FindingGroup("computer")


def check_computer(record: Path | None, state: ServiceState | None, now: datetime) -> list[Finding]:
    """All findings about the computer; `record` is where flights are kept, if not in the usual place."""
    installed = SERVICE_FLIGHTS.is_dir() or (state is not None and state.load == "loaded")
    folder = record or (SERVICE_FLIGHTS if installed else Path.cwd())
    return [_clock(now), _disk(folder), _power(), _service(state)]


def _clock(now: datetime) -> Finding:
    installed = datetime.fromtimestamp(Path(__file__).stat().st_mtime, UTC)
    if now < installed:
        hint = "network or GPS time: a Raspberry Pi does not know the date; logs and signing want it"
        return _GROUP.warn("clock", f"{now:%Y-%m-%d %H:%M} UTC, before this was installed", hint)
    detail = output_of("timedatectl", "show", "--property=NTPSynchronized", "--value")
    if detail is None:
        return _GROUP.skip("clock", f"{now:%Y-%m-%d %H:%M} UTC; no timedatectl to say whether it is set")
    if detail.strip() != "yes":
        return _GROUP.warn(
            "clock", f"{now:%Y-%m-%d %H:%M} UTC, not synchronised", "network, or chrony with the GPS"
        )
    return _GROUP.ok("clock", f"{now:%Y-%m-%d %H:%M} UTC, synchronised")


def _disk(folder: Path) -> Finding:
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    free_mb = shutil.disk_usage(there).free / 1e6
    detail = f"{free_mb / 1000:.1f} GB free for {folder}"
    if free_mb < LEAST_FREE_MB:
        return _GROUP.fail(
            "disk", detail, f"expected {LEAST_FREE_MB} MB or more: the flight log would end in flight"
        )
    if free_mb < LOW_FREE_MB:
        return _GROUP.warn("disk", detail, f"expected {LOW_FREE_MB / 1000:g} GB or more for a day's flights")
    if not os.access(there, os.W_OK):
        ours = folder == SERVICE_FLIGHTS
        hint = "sudo -u companion companion check" if ours else "--record DIR: where flights are to be kept"
        return _GROUP.skip("disk", f"{detail}, not writable by this user", hint)
    return _GROUP.ok("disk", detail)


def _power() -> Finding:
    bits = throttled_bits()
    if bits is None:
        return _GROUP.skip("power", "no vcgencmd: not a Raspberry Pi, or not for this user")
    if bits & UNDER_VOLTAGE:
        return _GROUP.fail(
            "power", f"under-voltage now (0x{bits:x})", "a 5 V supply of 3 A (5 A for a Pi 5), short wires"
        )
    if bits & (THROTTLED | HOT):
        return _GROUP.warn("power", f"throttled (0x{bits:x})", "cooling: frames and setpoints come late")
    if bits & UNDER_VOLTAGE_SINCE:
        return _GROUP.warn(
            "power", f"under-voltage since the boot (0x{bits:x})", "a stronger 5 V supply, short wires"
        )
    return _GROUP.ok("power", "no under-voltage, not throttled")


def _service(state: ServiceState | None) -> Finding:
    if state is None:
        return _GROUP.skip("service", "no systemd is running here")
    if state.load != "loaded":
        return _GROUP.warn(
            "service",
            f"{SERVICE}: {state.load or 'unknown'}",
            "sudo ./install.sh of a release, or sudo systemd/install.sh",
        )
    detail = f"{state.enabled or 'unknown'}, {state.active}"
    if state.active == "failed":
        return _GROUP.fail("service", detail, f"journalctl --unit {SERVICE}")
    if state.enabled != "enabled":
        return _GROUP.warn("service", detail, f"sudo systemctl enable {SERVICE}: it does not start at boot")
    return _GROUP.ok("service", detail)
