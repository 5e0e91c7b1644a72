"""The preflight check: everything that can be known of a vehicle that stands there, untouched."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from companion.app.service.autopilot_lock import app_at
from companion.base.clock import start_unix_s
from companion.config import CompanionConfig
from companion.tools.preflight.autopilot import check_link, without_link
from companion.tools.preflight.calibrations import check_files
from companion.tools.preflight.computer import SERVICE, ServiceState, check_computer, service_state
from companion.tools.preflight.devices import check_devices, without_devices
from companion.tools.preflight.findings import Finding
from companion.tools.preflight.second_sources import compared

TAKEN: Final = "is running and has it: two programs on one device harm both"
STOP_IT: Final = f"sudo systemctl stop {SERVICE}, check, and start it again"


async def preflight(
    config: CompanionConfig, path: Path, record: Path | None, *, linked: bool = True
) -> list[Finding]:
    """Check all at once; it takes about a quarter of a minute.

    An app that is running keeps its devices. Not `linked`, the autopilot is left out.
    """
    now = datetime.fromtimestamp(start_unix_s(virtual=True), UTC)
    files, found = check_files(config, path, now)
    state = service_state()
    if (running := _running(config, state)) is not None:
        who, hint = running
        found += without_devices(config, f"{who} {TAKEN}", hint) + without_link(f"{who} {TAKEN}")
    else:
        devices, link = await asyncio.gather(
            check_devices(config, files.camera),
            check_link(config, files.vehicle) if linked else _not_linked(),
        )
        found += devices + link + compared(devices, link, config.estimate, now)
    return found + check_computer(record, state, now)


def _running(config: CompanionConfig, state: ServiceState | None) -> tuple[str, str] | None:
    """Which app has the devices, and how to stop it: the service, or one that was started otherwise."""
    if state is not None and state.running:
        return "the service", STOP_IT
    who = app_at(config.link.connection)
    return None if who is None else (who, "stop it, check, and start it again")


async def _not_linked() -> list[Finding]:
    return without_link("--no-link")
