"""Steps of the EKF's position, as when GPS returns after an outage: the vehicle itself does not move.

EKF's NED, m, s.
"""

from companion.base.geometry import Vector3, add, norm, scale, subtract
from companion.base.messages import VehicleState
from companion.plan.trajectory.reference_generator import RESET_DISTANCE_M


class EstimateSteps:
    """Call `update` in every cycle; `step_m` is this cycle's step, None without one."""

    def __init__(self) -> None:
        self._before: VehicleState | None = None
        self.step_m: Vector3 | None = None

    def update(self, vehicle: VehicleState | None) -> None:
        """Take in a cycle: what the velocity does not explain is a step, where it leads off the reference."""
        before, self.step_m = self._before, None
        if vehicle is None:
            return
        self._before = vehicle
        if before is None:
            return
        half_s = 0.5 * (vehicle.time_s - before.time_s)
        flown_m = scale(add(before.velocity_ned_m_s, vehicle.velocity_ned_m_s), half_s)
        step_m = subtract(subtract(vehicle.position_ned_m, before.position_ned_m), flown_m)
        self.step_m = step_m if norm(step_m) > RESET_DISTANCE_M else None
