"""Landed detection, as real autopilots do it, from thrust and vertical motion alone.

Contact is suspected when a descent is commanded, thrust is clearly below hover thrust, and the vehicle still
neither moves nor accelerates vertically. The autopilot then reduces its thrust: in the air the vehicle would
start to fall, which ends the suspicion; on the ground nothing happens, and after `landed_time_s` it has
landed.

The control cascade and its states on the ground: idle, spool up, fly, detect the ground, idle again.

`outer` at 100 Hz turns a setpoint into attitude and thrust, `step` at the physics' rate turns these into
motor commands. On the ground with idling motors every integral stays zero. NED in the autopilot's own
frame, SI units.

From thrust and torques to motor commands for a layout of rotors, within what the motors can do.

When not everything fits, roll and pitch come first, then the collective thrust, then yaw; but at full thrust
yaw keeps a margin, for which the collective gives way (PX4 1.16, ControlAllocationSequentialDesaturation:
MINIMUM_YAW_MARGIN; ArduPilot's MOT_YAW_HEADROOM likewise keeps 0.2). Without it a vehicle that needs all its
thrust against the wind turns without end. FRD torques.
"""

import math
from dataclasses import dataclass
from typing import Final

from companion.base.geometry import IDENTITY, ZERO3, Quaternion, Vector3, add, yaw_from_quat
from sitl.autopilot.control.attitude_control import (
    AttitudeControl,
    AttitudeReference,
    RateGains,
    turn_about_down,
)
from sitl.autopilot.control.estimator import SimulatedEstimator
from sitl.autopilot.control.position_control import tilt_cosine
from sitl.autopilot.control.setpoints import AttitudeSetpoint, MotionSetpoint
from sitl.autopilot.control.shaping import clamp, low_pass
from sitl.autopilot.flight.profile import AutopilotProfile
from sitl.vehicle.quadrotor import QuadrotorParameters, RotorValues

YAW_MARGIN: Final = 0.15  # of the motors' range
_ROUNDING: Final = 1e-9


class MotorMixer:
    """`mix` for one airframe, in motor commands 0..1."""

    def __init__(self, airframe: QuadrotorParameters, idle: float) -> None:
        full, layout = airframe.max_thrust_n, airframe.layout
        self._per_roll_pitch_nm = 1.0 / (layout.tilting * airframe.arm_length_m * full)
        self._per_yaw_nm = 1.0 / (layout.count * airframe.torque_to_thrust_m * full)
        self._arms = tuple(zip(layout.forward, layout.right, strict=True))
        self._turns = layout.turns
        self._idle = idle
        self.saturated = False

    def mix(self, thrust: float, torque_nm: Vector3) -> RotorValues:
        """Motor commands for a collective thrust (0..1 of all of them) and body torques (N m)."""
        roll = torque_nm[0] * self._per_roll_pitch_nm
        pitch = torque_nm[1] * self._per_roll_pitch_nm
        yaw = torque_nm[2] * self._per_yaw_nm
        low, high = self._idle, 1.0
        tilts = [pitch * forward - roll * right for forward, right in self._arms]
        reach = max(map(abs, tilts))
        room = 0.5 * (high - low)
        self.saturated = reach > room
        if self.saturated:
            tilts = [tilt * room / reach for tilt in tilts]
            reach = room
        centre = min(max(thrust, low + reach), high - reach)
        # yaw lifts every other motor and lowers the rest: what all still have room for
        beyond = high + YAW_MARGIN * (high - low)
        yaw = clamp(yaw, max(0.0, min(centre - reach - low, beyond - centre - reach)))
        turned = list(zip(tilts, self._turns, strict=True))
        if centre + reach + abs(yaw) - high > _ROUNDING:
            over = max(centre + abs(tilt) + turn * yaw for tilt, turn in turned) - high
            if over > _ROUNDING:
                return tuple([max(low, centre - over + tilt + turn * yaw) for tilt, turn in turned])
        return tuple([centre + tilt + turn * yaw for tilt, turn in turned])


_CONTACT_AFTER_S = 0.35
_ACCELERATION_LIMIT_M_S2 = 1.0
_ACCELERATION_FILTER_S = 0.1


@dataclass(slots=True)
class LandedDetector:
    """`landed` and `contact` after each `update`; starts on the ground.

    `low_thrust_share` of the hover thrust is what a descent in the air never falls below for long.
    """

    landed_time_s: float
    low_thrust_share: float = 0.85
    landed: bool = True
    contact: bool = False
    _sign_for_s: float = 0.0
    _acceleration: float = 0.0
    _last_speed: float = 0.0

    def update(
        self, descending: bool, thrust_share: float, speed_m_s: float, speed_limit_m_s: float, dt_s: float
    ) -> None:
        """Take in one outer step: is a descent commanded, the thrust over the hover's, the vertical speed."""
        share = dt_s / (dt_s + _ACCELERATION_FILTER_S)
        self._acceleration += share * ((speed_m_s - self._last_speed) / dt_s - self._acceleration)
        self._last_speed = speed_m_s
        if self.landed:
            return
        still = abs(speed_m_s) < speed_limit_m_s and abs(self._acceleration) < _ACCELERATION_LIMIT_M_S2
        if not (descending and still and (self.contact or thrust_share < self.low_thrust_share)):
            self._sign_for_s, self.contact = 0.0, False
            return
        self._sign_for_s += dt_s
        self.contact = self._sign_for_s >= _CONTACT_AFTER_S
        self.landed = self._sign_for_s >= self.landed_time_s

    def lift_off(self) -> None:
        self.landed = self.contact = False
        self._sign_for_s = 0.0


_IDLE = 0.04
_SPOOL_UP_S = 1.2
# while contact is suspected the thrust decreases at this rate, down to this share
_TAKE_BACK_PER_S = 2.0
_LEAST_SHARE = 0.2
# full scale of the thrust field where it means a climb rate (ArduPilot's default speeds)
_CLIMB_RATE_M_S = 2.5
_DESCENT_RATE_M_S = 1.5
_HOLDS_HEIGHT = 0.5  # a thrust that is a climb rate
_DESCENDING_M_S = 0.05
# a hover, and how slowly the thrust in it is learnt (Copter::update_throttle_hover, AP_MOTORS_THST_HOVER_TC)
_LEVEL_COSINE = math.cos(math.radians(5.0))
_HOVERS_DOWN_M_S = 0.6
_HOVER_LEARNING_S = 10.0


class Cascade:
    """The controllers of one airframe with one profile's gains, and the landed detector."""

    def __init__(
        self, profile: AutopilotProfile, airframe: QuadrotorParameters, rates: RateGains | None = None
    ) -> None:
        self._hover = airframe.hover_share()
        gains = profile.attitude_gains
        self._position = profile.position_control(self._hover)
        self._thrust_is_upward = profile.thrust_is_upward
        self._throttle_hz = profile.throttle_hz
        self._attitude = AttitudeControl(airframe.inertia_kg_m2, gains, rates or gains.shares.rates(airframe))
        self._reference = None if gains.reference is None else AttitudeReference(gains.reference)
        self._mixer = MotorMixer(airframe, _IDLE)
        self._idling: RotorValues = (_IDLE,) * airframe.layout.count
        self._detector = LandedDetector(profile.landed_time_s, profile.landed_thrust_share)
        self._spool = 0.0
        self._share = 1.0
        self._feed_rate = ZERO3
        self._rates_alone = self._by_thrust = False
        self.thrust = self._throttle = 0.0
        self.attitude_setpoint: Quaternion = IDENTITY

    @property
    def landed(self) -> bool:
        return self._detector.landed

    @property
    def airborne(self) -> bool:
        """Off the ground and spooled up."""
        return not self._detector.landed and self._spool >= 1.0

    def settle(self, estimate: SimulatedEstimator) -> None:
        """Idle: reset the integrals and hold the present heading."""
        self._position.reset(yaw_from_quat(estimate.attitude), estimate.velocity_ned_m_s)
        self._attitude.reset()
        self._spool, self._share, self.thrust = 0.0, 1.0, 0.0
        self._throttle = 0.0
        self._feed_rate, self._rates_alone, self._by_thrust = ZERO3, False, False
        self.attitude_setpoint = self._position.attitude
        if self._reference is not None:
            self._reference.reset(self.attitude_setpoint)

    def disarm(self, estimate: SimulatedEstimator) -> None:
        """Motors off; the next flight starts from the ground."""
        self._detector = LandedDetector(self._detector.landed_time_s, self._detector.low_thrust_share)
        self.settle(estimate)

    def lift_off(self) -> None:
        """Leave the ground: the motors spool up over the next second."""
        self._detector.lift_off()

    def wants_up(
        self,
        setpoint: MotionSetpoint | AttitudeSetpoint,
        estimate: SimulatedEstimator,
        thrust_is_climb_rate: bool = False,
    ) -> bool:
        """Whether a setpoint commands a climb, as for a take-off."""
        if isinstance(setpoint, AttitudeSetpoint):
            still = _HOLDS_HEIGHT if thrust_is_climb_rate else self._hover
            return setpoint.thrust > 1.02 * still and not setpoint.holds_height
        return (
            setpoint.velocity_ned_m_s[2] < -0.1
            or setpoint.position_ned_m[2] < estimate.position_ned_m[2] - 0.3
            or setpoint.acceleration_ned_m_s2[2] < -1.0
        )

    def outer(
        self,
        setpoint: MotionSetpoint | AttitudeSetpoint,
        estimate: SimulatedEstimator,
        thrust_is_climb_rate: bool,
        still_speed_m_s: float,
        dt_s: float,
    ) -> None:
        frozen = self._spool < 1.0
        self._spool = min(1.0, self._spool + dt_s / _SPOOL_UP_S)
        if isinstance(setpoint, AttitudeSetpoint):
            descending = self._follow_attitude(setpoint, estimate, thrust_is_climb_rate, dt_s, frozen)
        else:
            descending = self._follow_motion(setpoint, estimate, dt_s, frozen)
        if frozen:
            self.thrust = min(self.thrust, self._spool)
        else:
            self._detect_ground(descending, estimate, still_speed_m_s, dt_s)

    def learn_hover(self, believed: float, estimate: SimulatedEstimator, dt_s: float) -> float:
        """Fly by a hover thrust; returns it, nearer to the thrust in a hover (MOT_HOVER_LEARN)."""
        self._position.hover = believed
        vz = estimate.velocity_ned_m_s[2]
        level = tilt_cosine(estimate.attitude) > _LEVEL_COSINE
        if not (self.airborne and level and abs(vz) < _HOVERS_DOWN_M_S and self.thrust > 0.0):
            return believed
        return believed + dt_s / (dt_s + _HOVER_LEARNING_S) * (self.thrust - believed)

    def step(self, estimate: SimulatedEstimator, dt_s: float) -> RotorValues:
        """Motor commands 0..1 of an armed vehicle."""
        if self._detector.landed:
            return self._idling
        reference, wanted, feed = self._reference, self.attitude_setpoint, self._feed_rate
        if reference is not None and not self._rates_alone:
            reference.step(wanted, feed, dt_s)
            wanted, feed = reference.attitude, reference.rate
        torque = self._attitude.step(
            estimate.attitude,
            estimate.rate_body_rad_s,
            None if self._rates_alone else wanted,
            feed,
            dt_s,
            frozen=self._spool < 1.0 or self._mixer.saturated or self._detector.contact,
        )
        return self._mixer.mix(self.thrust, torque)

    def _follow_motion(
        self, setpoint: MotionSetpoint, estimate: SimulatedEstimator, dt_s: float, frozen: bool
    ) -> bool:
        """Fly a motion setpoint; returns whether it is a descent."""
        law = self._position
        self._take_over_height(estimate)
        law.step(estimate.motion, setpoint, dt_s, frozen)
        self._leave_rates(estimate)
        self.attitude_setpoint = law.attitude
        self._throttle_up(estimate, dt_s)
        self._feed_rate = turn_about_down(estimate.attitude, law.yaw_rate_rad_s)
        # a law that shapes its setpoints still descends for a while after a climb is commanded
        return law.velocity_reference[2] > _DESCENDING_M_S and not self.wants_up(setpoint, estimate)

    def _follow_attitude(
        self,
        setpoint: AttitudeSetpoint,
        estimate: SimulatedEstimator,
        thrust_is_climb_rate: bool,
        dt_s: float,
        frozen: bool,
    ) -> bool:
        """Fly an attitude or body rates; returns whether that is a descent."""
        law = self._position
        law.follow(yaw_from_quat(estimate.attitude), estimate.velocity_ned_m_s)
        self._feed_rate = add(
            setpoint.rate_body_rad_s, turn_about_down(estimate.attitude, setpoint.yaw_rate_rad_s)
        )
        if setpoint.attitude is None:
            self._rates_alone, self.attitude_setpoint = True, estimate.attitude
        else:
            self._leave_rates(estimate)
            self.attitude_setpoint = setpoint.attitude
        share = min(max(setpoint.thrust, 0.0), 1.0)
        if not (thrust_is_climb_rate or setpoint.holds_height):
            self._by_thrust = True
            upward = self._thrust_is_upward and setpoint.attitude is not None
            self.thrust = min(1.0, share / tilt_cosine(estimate.attitude)) if upward else share
            self._throttle = self.thrust
            return share < 0.85 * self._hover
        self._take_over_height(estimate)
        climb = 0.0 if setpoint.holds_height else 2.0 * (share - _HOLDS_HEIGHT)
        climb *= _CLIMB_RATE_M_S if climb > 0.0 else _DESCENT_RATE_M_S
        law.step_climb(estimate.motion, estimate.attitude, climb, dt_s, frozen)
        self._throttle_up(estimate, dt_s)
        return climb < -_DESCENDING_M_S

    def _take_over_height(self, estimate: SimulatedEstimator) -> None:
        """From a thrust that was commanded to a law that makes its own."""
        if self._by_thrust:
            upward = self.thrust * tilt_cosine(estimate.attitude)
            self._position.start_height(estimate.position_ned_m, estimate.velocity_ned_m_s, upward)
        self._by_thrust = False

    def _throttle_up(self, estimate: SimulatedEstimator, dt_s: float) -> None:
        """Take the height law's thrust, directly or with tilt compensation and a low-pass."""
        law = self._position
        if self._throttle_hz is None:
            self.thrust = law.thrust
            return
        wanted = min(1.0, max(0.0, law.upward / tilt_cosine(estimate.attitude)))
        self.thrust = self._throttle = low_pass(self._throttle, wanted, self._throttle_hz, dt_s)

    def _leave_rates(self, estimate: SimulatedEstimator) -> None:
        """From body rates back to attitudes: the reference starts from the present attitude."""
        if self._rates_alone and self._reference is not None:
            self._reference.reset(estimate.attitude)
        self._rates_alone = False

    def _detect_ground(
        self, descending: bool, estimate: SimulatedEstimator, still_speed: float, dt_s: float
    ) -> None:
        speed = estimate.velocity_ned_m_s[2]
        self._detector.update(descending, self.thrust / self._hover, speed, still_speed, dt_s)
        change = -_TAKE_BACK_PER_S if self._detector.contact else _TAKE_BACK_PER_S
        self._share = min(1.0, max(_LEAST_SHARE, self._share + change * dt_s))
        self.thrust *= self._share
        if self._detector.landed:
            self.settle(estimate)
        elif self._share < 1.0:
            # in ground contact: stay level rather than tilt against the ground
            heading = yaw_from_quat(estimate.attitude)
            half = 0.5 * heading
            self.attitude_setpoint = (math.cos(half), 0.0, 0.0, math.sin(half))
