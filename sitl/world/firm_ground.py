"""A world with the ground that ArduPilot's SITL and PX4's SIH have: it stops dead what comes down on it.

Theirs is level, acts at the reference point and not at the feet, and knows no pad that would carry the
vehicle along: in one step a vehicle that reaches it has no velocity any more, and the accelerometer feels
that step. ArduPilot's levels the vehicle besides, PX4's leaves its attitude alone; here it stays. For a
vehicle that plays an external one. NED, FRD, SI.
"""

from __future__ import annotations

from sitl.vehicle.quadrotor import QuadrotorState, packed
from sitl.world.contact import NO_CONTACT, ContactLoad
from sitl.world.world import STANDING_FEET, World

_STANDS = ContactLoad(on_ground=STANDING_FEET)


class FirmGroundWorld(World):
    """A scenario's world under one seed, whose surface stops the vehicle instead of its legs."""

    def _update_contact(self, clear_m: float, dt_s: float) -> None:
        """The legs bear nothing: `_advance` puts the load."""

    def _advance(self, state: QuadrotorState, dt_s: float) -> None:
        """Stop what would sink below the height that it stands at."""
        north, east, down = state.position_ned_m
        standing_m = self.board.surface_down_m(self.pad_state, north, east) - self.landed_reference_height_m
        self._load = NO_CONTACT
        if down >= standing_m and state.velocity_ned_m_s[2] >= 0.0:
            self._load = _STANDS
            old = self._state
            x, y, _ = old.position_ned_m
            stopped = (0.0, 0.0, 0.0, *old.attitude, 0.0, 0.0, 0.0)
            state = packed(old, (x, y, standing_m), stopped, state.thrust_share, dt_s)
        super()._advance(state, dt_s)
