"""The table of second sources before a flight: what two of them can say of a vehicle that stands. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from companion.base.messages import Quantity, SourceComparison
from companion.base.second_sources import SourceState, judged
from companion.tools.preflight.findings import Finding, FindingGroup

# of the difference of two horizons at rest: accelerometers' offsets, and how the boards lie
HORIZON_STD_DEG: Final = 0.8
_GROUP: Final = FindingGroup("second sources")


def compared(devices: Sequence[Finding], link: Sequence[Finding]) -> list[Finding]:
    """Our horizon against the autopilot's, by what the IMU's and the link's findings have measured."""
    horizons = [
        next((finding.horizon_rad for finding in found if finding.horizon_rad is not None), None)
        for found in (devices, link)
    ]
    ours, theirs = horizons
    if ours is None or theirs is None:
        return [_GROUP.skip(Quantity.ATTITUDE, "it takes our IMU at rest and the autopilot's attitude")]
    comparison = SourceComparison(
        0.0,
        Quantity.ATTITUDE,
        _words(ours),
        _words(theirs),
        difference=math.degrees(math.dist(ours, theirs)),
        std=HORIZON_STD_DEG,
    )
    row, state, figures = next(each for each in judged([comparison]) if each[0].quantity == Quantity.ATTITUDE)
    if state is SourceState.REFUSED:
        return [_GROUP.fail(row.quantity, figures, row.hint)]
    if state is SourceState.DIFFERS:
        return [_GROUP.warn(row.quantity, figures, row.hint)]
    return [_GROUP.ok(row.quantity, figures)]


def _words(horizon_rad: tuple[float, float]) -> str:
    roll_deg, pitch_deg = map(math.degrees, horizon_rad)
    return f"roll {roll_deg:.1f}, pitch {pitch_deg:.1f} deg"
