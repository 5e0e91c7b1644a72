"""Every kind of measurement of the pad: a line each, beside that of `base.messages.PAD_OBSERVATIONS`."""

from __future__ import annotations

from typing import Any, Final

from companion.estimate.pad.beacon_in_ned import BEACON
from companion.estimate.pad.observation import ObservationKind
from companion.estimate.pad.sighting_in_ned import SIGHTING

KINDS: Final[tuple[ObservationKind[Any, Any], ...]] = (SIGHTING, BEACON)

BY_MESSAGE: Final[dict[type, ObservationKind[Any, Any]]] = {kind.message: kind for kind in KINDS}
