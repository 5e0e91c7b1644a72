"""The reasons that forbid a flight, in words: checked before arming is requested and before control is taken.

Pure. An order is followed or refused in the cycle in which it arrives and never kept, because whoever gave
it is looking at the vehicle now. The failsafes in flight use the same words.
"""

import math
from collections.abc import Iterator

from companion.base.messages import AutopilotState, LandedState, Order, OrderKind, Refusal, VehicleState
from companion.base.second_sources import refused
from companion.config import MissionConfig, PlanConfig
from companion.plan.events import MissionEvent
from companion.plan.inputs import PlanInputs
from companion.plan.landing.contact import KNOWN_S
from companion.plan.mission.bounds import Bounds
from companion.plan.mission.mode_monitor import in_offboard

ORDER_EVENTS = {OrderKind.LAND: MissionEvent.LAND_ORDERED, OrderKind.FLY: MissionEvent.FLY_ORDERED}
# TIMESYNC goes out at 5 Hz, SYS_STATUS comes at 2 Hz
OLDEST_S = 3.0
_TWIN_GONE_S = 5.0  # heartbeats come once a second


def refused_words(autopilot: AutopilotState) -> str:
    """What the link refused for its version or its signature, if anything, to follow other words."""
    if autopilot.mavlink_1:
        return " (it sends MAVLink 1; expected MAVLink 2: SERIALx_PROTOCOL 2, MAV_PROTO_VER 0 or 2)"
    count = autopilot.refused_frames
    return f" ({count} frames refused: no right signature, see link.signing_key)" if count else ""


def rival_words(autopilot: AutopilotState, now_s: float, within_s: float = _TWIN_GONE_S) -> str:
    """Who else has just sent setpoints to the vehicle, in words; "" when nobody has."""
    if autopilot.rival is None or now_s - autopilot.rival_time_s > within_s:
        return ""
    system_id, component_id = autopilot.rival
    return f"setpoints of system {system_id}, component {component_id}"


def offboard_words(autopilot: AutopilotState) -> str:
    """Why a PX4 that was found in OFFBOARD is not ready to arm, to follow other words; "" for any other."""
    if not in_offboard(autopilot):
        return ""
    return " (PX4 does not arm in OFFBOARD without setpoints: change its mode, for example to Hold)"


def late_words(autopilot: AutopilotState, mission: MissionConfig) -> str:
    """That the autopilot's answers take too long to fly by; "" where they do not, or none has come."""
    late_s, most_s = autopilot.round_trip_s, mission.largest_round_trip_s
    return "" if late_s is None or late_s <= most_s else f"round trip {late_s:.2f} s, limit {most_s:g}"


def untold(autopilot: AutopilotState, now_s: float) -> Iterator[str]:
    """What the autopilot has to tell, and has not told lately.

    A battery without a monitor is not known, which its report says.
    """
    answered_s = -math.inf if autopilot.round_trip_s is None else autopilot.round_trip_time_s
    for what, time_s, oldest_s in (
        ("attitude (ATTITUDE)", autopilot.attitude_time_s, KNOWN_S),
        ("checks and battery (SYS_STATUS)", autopilot.status_time_s, OLDEST_S),
        ("time (TIMESYNC)", answered_s, OLDEST_S),
    ):
        if now_s - time_s > oldest_s:
            yield f"the autopilot does not tell its {what}"


def velocity_words(vehicle: VehicleState, mission: MissionConfig) -> str:
    """That its velocity is not known well enough to fly by; "" when it is."""
    std_m_s, most_m_s = vehicle.velocity_std_m_s, mission.largest_speed_std_m_s
    return "" if std_m_s <= most_m_s else f"{std_m_s:.1f} m/s, limit {most_m_s:g}"


def not_ready_to_arm(inputs: PlanInputs, mission: MissionConfig, now_s: float) -> Iterator[str]:
    """What a flight from the ground waits for."""
    autopilot, vehicle = inputs.autopilot, inputs.vehicle
    yield from _either_way(inputs, mission, now_s, "low", mission.battery.low)
    if not autopilot.ready_to_arm:
        yield f"autopilot not ready to arm{offboard_words(autopilot)}"
    if autopilot.ekf_ready is False:
        yield "autopilot has no position estimate"
    if vehicle is None or not vehicle.aligned:
        yield "attitude not aligned"
    if vehicle is None or not vehicle.has_gps or vehicle.origin is None:
        yield "no GPS position"


def not_ready(
    inputs: PlanInputs, mission: MissionConfig, now_s: float, *, ours: bool = False
) -> Iterator[str]:
    """What stands against a landing wherever the vehicle is; on the ground it can be ready too.

    `ours`: setpoints that fly it now are our own.
    """
    yield from _either_way(inputs, mission, now_s, "critical", mission.battery.critical)
    # PX4 flies in it only while somebody's setpoints come, and we send none
    if inputs.autopilot.armed and in_offboard(inputs.autopilot) and not ours:
        yield "already in OFFBOARD by another program's setpoints"
    if inputs.camera_problem is not None:
        yield f"no pad camera: {inputs.camera_problem}"
    yield from estimate_problems(inputs.vehicle, mission, now_s)


def _either_way(
    inputs: PlanInputs, mission: MissionConfig, now_s: float, battery: str, least_share: float
) -> Iterator[str]:
    autopilot = inputs.autopilot
    if not autopilot.connected:
        yield f"no heartbeat from the autopilot{refused_words(autopilot)}"
    elif autopilot.autopilot_kind is None:
        yield "no PX4 or ArduPilot multirotor"
    else:
        yield from untold(autopilot, now_s)
    if autopilot.motors_cut:
        yield "kill switch, emergency stop or flight termination"
    if autopilot.home is None:
        yield "no home position for the fence"
    if late := late_words(autopilot, mission):
        yield f"link late: {late}"
    if inputs.setup_problem:
        yield inputs.setup_problem
    share = autopilot.battery_share
    if share is not None and share <= least_share:
        yield f"battery {battery}: {100.0 * share:.0f} % left, limit {100.0 * least_share:.0f} %"
    if now_s - autopilot.twin_time_s <= _TWIN_GONE_S:
        yield "duplicate companion on the link; expected one"
    if others := rival_words(autopilot, now_s):
        yield f"foreign setpoints: {others}"
    if inputs.computer.problem is not None:
        yield inputs.computer.problem
    for _, words in refused(inputs.comparisons):
        yield words


def estimate_problems(vehicle: VehicleState | None, mission: MissionConfig, now_s: float) -> Iterator[str]:
    """What stands against flying by an estimate of the vehicle."""
    if vehicle is None or not vehicle.aligned or now_s - vehicle.sensed_time_s > KNOWN_S:
        yield "no current vehicle estimate"
    elif vehicle.origin is None:
        yield "no GPS position in our estimate yet"
    elif uncertain := velocity_words(vehicle, mission):
        yield f"velocity uncertain: {uncertain}"


def refusal(order: Order, inputs: PlanInputs, config: PlanConfig, now_s: float) -> Refusal | None:
    """Why an order is not followed now; None when it is."""
    if order.kind is OrderKind.STOP:
        return Refusal("nothing to stop: in standby")
    if order.kind is OrderKind.FLY:
        return _not_flying(inputs, config)
    missing = next(_missing_to_land(inputs, config, now_s), None)
    return None if missing is None else Refusal(missing)


def _not_flying(inputs: PlanInputs, config: PlanConfig) -> Refusal | None:
    """What the flight itself waits for (`Departure`) is no reason; who may not arm, and who did, is."""
    if not config.mission.may_arm:
        return Refusal("not allowed: plan.mission.may_arm is false", lasting=True)
    if inputs.autopilot.connected and inputs.autopilot.armed:
        return Refusal("the vehicle is armed already; order a landing instead")
    return None


def _missing_to_land(inputs: PlanInputs, config: PlanConfig, now_s: float) -> Iterator[str]:
    if inputs.autopilot.connected:
        if not inputs.autopilot.armed:
            yield "the vehicle is not armed"
        if inputs.autopilot.landed is LandedState.ON_GROUND:
            yield "the vehicle is on the ground"
        elif inputs.autopilot.landed is LandedState.UNDEFINED:  # control would lift a vehicle that stands
            yield "the autopilot does not tell whether it is in the air (EXTENDED_SYS_STATE)"
    yield from not_ready(inputs, config.mission, now_s)
    if inputs.thrust_doubt:
        yield inputs.thrust_doubt
    if config.obstacles:
        yield "plan.obstacles need a take-off by the app"
    for _, words in Bounds(config).detect(inputs.vehicle, None, inputs.autopilot, now_s):
        yield words
