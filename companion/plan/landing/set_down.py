"""Straight down without the pad, in the EKF's NED, until something solid is below. m and s.

LAND is asked for meanwhile: until the autopilot is in it, our own setpoints bring the vehicle down.
"""

from __future__ import annotations

from companion.base.messages import LandedState, PadState, VehicleState
from companion.base.motion import Motion
from companion.config import TouchdownConfig, VehicleConfig
from companion.plan.events import DetectedEvent, MissionEvent
from companion.plan.inputs import PlanInputs
from companion.plan.landing.contact import ContactFilter, feet_motion, imu_fresh
from companion.plan.landing.relative_state import vehicle_motion
from companion.plan.trajectory.reference_generator import ReferenceGenerator

# A reference that far below makes the controller sink two or three times as fast as is planned.
_AHEAD_M = 0.1


class SetDown:
    """`begin` when the pad is given up, `step` every cycle from then on."""

    def __init__(
        self, config: TouchdownConfig, vehicle: VehicleConfig, generator: ReferenceGenerator
    ) -> None:
        self._config, self._vehicle, self._generator = config, vehicle, generator

    def begin(self, vehicle: VehicleState | None, now_s: float) -> None:
        """Sink from the vehicle's own motion on, and no more sideways than that."""
        if vehicle is not None:
            actual = vehicle_motion(vehicle)
            down = Motion(actual.position_m, (0.0, 0.0, actual.velocity_m_s[2]))
            self._generator.start("local", down, now_s)
        self._generator.sink(self._config.contact_speed_m_s, self._config.blend_s, now_s)

    def step(
        self, sight: PadState | None, inputs: PlanInputs, contact: ContactFilter, now_s: float
    ) -> DetectedEvent | None:
        """Go on down; returns what shows that something solid is below."""
        if self._runs_ahead(inputs, now_s):
            self.begin(inputs.vehicle, now_s)
        landed = inputs.autopilot.landed
        if landed is LandedState.ON_GROUND:
            return MissionEvent.LANDING_DETECTED, "the autopilot reports landed"
        # it means to go down, though its reference begins anew with the vehicle's own speed
        feet = feet_motion(
            sight,
            self._config.contact_speed_m_s,
            inputs.range,
            now_s,
            config=self._config,
            vehicle=self._vehicle,
            obeys=not inputs.link.silent,
            felt=imu_fresh(inputs.vehicle, now_s),
            state=inputs.vehicle,
        )
        contact.update(feet, now_s)
        if contact.contact:
            return MissionEvent.CONTACT, contact.in_words()
        return None

    def _runs_ahead(self, inputs: PlanInputs, now_s: float) -> bool:
        """Whether the vehicle does not come down with the reference, which would pull it after it later."""
        vehicle, autopilot = inputs.vehicle, inputs.autopilot
        if vehicle is None:
            return False
        if inputs.link.silent or not autopilot.offboard:
            return True
        ahead_m = self._generator.at(now_s).position_m[2] - vehicle.position_ned_m[2]
        # without the IMU its height is a guess
        return imu_fresh(vehicle, now_s) and ahead_m > _AHEAD_M
