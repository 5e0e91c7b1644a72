"""Vision only: the pad as a landing target for the autopilot's own landing, and nothing else.

One target for each exposure that shows the pad, as soon as all that it needs has come: a pad that is not
seen is silence. Where there is an estimate of the vehicle, an exposure counts once the pad filter has taken
it; else it is sent as the frame shows it. Nothing here flies.
"""

from typing import Final

from companion.base.autopilots import PROFILES
from companion.base.geometry import Quaternion, Vector3, quat_rotate_inverse
from companion.base.messages import LandingTargetPose, PadSighting, PadState, VehicleState
from companion.config import ControlConfig
from companion.control.landing_target import SeenPad, TargetLead, landing_target
from companion.estimate.estimator import StateEstimator
from companion.link.session import Session
from companion.pad import Pad

STANDBY_WORDS: Final = "vision only: the pad is sent to the autopilot, which lands by itself"
OLDEST_S: Final = 1.0  # an exposure that could not be sent by then says nothing of now


class TargetOutput:
    """Ask `due` in every cycle."""

    def __init__(self, config: ControlConfig, pad: Pad, estimator: StateEstimator, session: Session) -> None:
        self._size_m = (pad.width_m, pad.length_m)
        self._lead = TargetLead(config.target_lead_s) if config.target_lead_s > 0.0 else None
        self._estimator, self._session = estimator, session
        self._sent_exposure_s = float("-inf")

    def due(
        self, vehicle: VehicleState | None, pad: PadState | None, sighting: PadSighting | None, now_s: float
    ) -> LandingTargetPose | None:
        """The target of the newest exposure that shows the pad, unless it has been sent or is old.

        `vehicle` and `pad` are the estimates at now_s, `sighting` is the newest one.
        """
        kind, seen, estimate = self._session.state.autopilot_kind, None, None
        if vehicle is None or not vehicle.aligned:
            seen = None if sighting is None else SeenPad.by_sighting(sighting)
        elif pad is not None:
            at_exposure = self._estimator.pad(pad.seen_time_s)
            attitude = self._estimator.attitude(pad.seen_time_s)
            if at_exposure is not None and attitude is not None:
                seen, estimate = SeenPad.by_estimate(at_exposure, attitude), (at_exposure, attitude)
        if kind is None or not self._session.state.connected or seen is None:
            return None
        if not self._sent_exposure_s < seen.time_s <= now_s <= seen.time_s + OLDEST_S:
            return None
        make, own_pose = PROFILES[kind], None
        if make.target_frame == "local_ned":
            own_pose = self._own_pose(seen.time_s)
            if own_pose is None:
                return None  # it may come until the next cycle
        self._sent_exposure_s = seen.time_s
        if estimate is not None and self._lead is not None:
            at_exposure, attitude = estimate
            moved_ned_m = self._lead.ned_m(at_exposure, now_s, make)
            seen = seen.moved(quat_rotate_inverse(attitude, moved_ned_m))
        return landing_target(seen, self._size_m, own_pose)

    def _own_pose(self, time_s: float) -> tuple[Vector3, Quaternion] | None:
        pose = None if self._session.poses is None else self._session.poses.at(time_s)
        return None if pose is None else (pose.position_ned_m, pose.attitude)

    def problems(self, now_s: float) -> list[str]:
        """What keeps the pad from being sent, if it is seen."""
        state = self._session.state
        if not state.connected:
            return ["autopilot: no heartbeat"]
        if state.autopilot_kind is None:
            return ["autopilot: expected PX4 or ArduPilot"]
        local = PROFILES[state.autopilot_kind].target_frame == "local_ned"
        if local and (self._session.poses is None or not self._session.poses.fresh(now_s)):
            return ["autopilot: its position and attitude do not come (LOCAL_POSITION_NED, ATTITUDE)"]
        return []
