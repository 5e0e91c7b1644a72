"""Decides whether the app may control by attitude and thrust: hover thrust known, vehicle not falling.

With all other kinds of setpoint the autopilot's own loops hold the height. NED, SI units.
"""

from typing import Final

from companion.base.messages import AutopilotSetup, AutopilotState, LandedState, VehicleState
from companion.config import VehicleConfig
from companion.control.limits import LONGEST_STEP_S
from companion.control.response.plant import Plant

# so much faster than planned, and than thrust explains, for so long, is a fall
FALLS_M_S: Final = 0.5
FALLS_S: Final = 0.3  # see above
FRESH_S: Final = 0.25  # reports of the thrust come 20 times a second, half a round trip (0.3 s) late at most


class ThrustGuard:
    """`feel` in every cycle; `begin` and `watch` before a setpoint is made. `fault`: why none by attitude."""

    def __init__(self, plant: Plant, vehicle: VehicleConfig, *, measures: bool) -> None:
        """`measures`: the hover thrust is to be measured in the air before the first attitude leaves."""
        self._plant, self.measures = plant, measures and plant.by_attitude
        self._told: dict[str, float | None] = {f"vehicle '{vehicle.name}'": vehicle.hover_thrust}
        self._felt_s: float | None = None
        self.reset()

    def reset(self) -> None:
        """What was flown before says nothing any more."""
        self.fault, self._fell = "", ""
        self._falls_since_s: float | None = None

    @property
    def doubt(self) -> str:
        """What stands against control by thrust now; empty when nothing does."""
        return self._plant.hover.doubt(self._told) if self.measures else ""

    def feel(
        self,
        vehicle: VehicleState | None,
        autopilot: AutopilotState,
        setup: AutopilotSetup,
        now_s: float,
    ) -> None:
        """Learn what thrust holds the vehicle in the air while others fly it."""
        elapsed_s = 0.0 if self._felt_s is None else min(now_s - self._felt_s, LONGEST_STEP_S)
        self._felt_s = now_s
        self._told["the autopilot's parameter"] = setup.hover_thrust
        flies = autopilot.armed and autopilot.landed is LandedState.IN_AIR
        if vehicle is not None:
            known = flies and now_s - min(autopilot.thrust_time_s, vehicle.sensed_time_s) <= FRESH_S
            self._plant.hold(vehicle, autopilot.thrust if known else None, elapsed_s)

    def begin(self) -> None:
        """Nothing of ours is flown yet: see whether it may be."""
        self.fault = self._fell or self.doubt

    def watch(self, sink_m_s: float, planned_m_s: float, now_s: float) -> None:
        """Compare how fast it sinks with the plan. Who falls is not flown by thrust, until it is caught.

        The autopilot's own velocity loop catches it; the thrust that does so is felt meanwhile, and `begin`
        asks whether it is known well enough to be ours again.
        """
        faster_m_s = min(sink_m_s - planned_m_s, self._plant.hover.unexplained_m_s)
        if self._fell and sink_m_s <= planned_m_s:
            self._fell = ""
        if not self._plant.by_attitude or faster_m_s <= FALLS_M_S:
            self._falls_since_s = None
            return
        self._falls_since_s = now_s if self._falls_since_s is None else self._falls_since_s
        if now_s - self._falls_since_s >= FALLS_S and not self.fault:
            thrust = self._plant.hover.value
            self._fell = self.fault = (
                f"sinks {sink_m_s - planned_m_s:.1f} m/s faster than planned, hover thrust {thrust:.2f}"
            )
