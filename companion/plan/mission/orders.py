"""Which orders a planner in standby follows: what has to hold before the vehicle is taken over.

Pure. An order is followed or refused in the cycle in which it comes, never kept for later: whoever gave it
looks at the vehicle now.
"""

from collections.abc import Iterator

from companion.base.messages import AutopilotState, LandedState, Order, OrderKind, Refusal, VehicleState
from companion.base.second_sources import refused
from companion.config import MissionConfig, PlanConfig
from companion.plan.events import MissionEvent
from companion.plan.inputs import PlanInputs
from companion.plan.mission.bounds import Bounds
from companion.plan.mission.departure import TWIN_GONE_S, refused_words, rival_words
from companion.plan.mission.mode_monitor import in_offboard

ORDER_EVENTS = {OrderKind.LAND: MissionEvent.LAND_ORDERED, OrderKind.FLY: MissionEvent.FLY_ORDERED}
_STALE_S = 0.5


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


def not_ready(
    inputs: PlanInputs, mission: MissionConfig, now_s: float, *, ours: bool = False
) -> Iterator[str]:
    """What stands against a landing wherever the vehicle is; on the ground it can be ready too.

    `ours`: setpoints that fly it now are our own.
    """
    yield from _autopilot(inputs.autopilot, mission)
    if now_s - inputs.autopilot.twin_time_s <= TWIN_GONE_S:
        yield "duplicate companion on the link; expected one"
    if others := rival_words(inputs.autopilot, now_s):
        yield f"foreign setpoints: {others}"
    # PX4 flies in it only while somebody's setpoints come, and we send none
    if inputs.autopilot.armed and in_offboard(inputs.autopilot) and not ours:
        yield "already in OFFBOARD by another program's setpoints"
    if inputs.camera_problem is not None:
        yield f"no pad camera: {inputs.camera_problem}"
    if inputs.computer.problem is not None:
        yield inputs.computer.problem
    yield from estimate_problems(inputs.vehicle, mission, now_s)
    for _, words in refused(inputs.comparisons):
        yield words


def _missing_to_land(inputs: PlanInputs, config: PlanConfig, now_s: float) -> Iterator[str]:
    if inputs.autopilot.connected:
        yield from _not_in_the_air(inputs.autopilot)
    yield from not_ready(inputs, config.mission, now_s)
    if inputs.thrust_doubt:
        yield inputs.thrust_doubt
    if config.obstacles:
        yield "plan.obstacles need a take-off by the app"
    for _, words in Bounds(config.mission).detect(inputs.vehicle, None, inputs.autopilot, now_s):
        yield words


def _not_in_the_air(autopilot: AutopilotState) -> Iterator[str]:
    if not autopilot.armed:
        yield "the vehicle is not armed"
    if autopilot.landed is LandedState.ON_GROUND:
        yield "the vehicle is on the ground"


def _autopilot(autopilot: AutopilotState, mission: MissionConfig) -> Iterator[str]:
    if not autopilot.connected:
        yield f"no heartbeat from the autopilot{refused_words(autopilot)}"
    elif autopilot.autopilot_kind is None:
        yield "no PX4 or ArduPilot multirotor"
    if autopilot.motors_cut:
        yield "kill switch, emergency stop or flight termination"
    if autopilot.home is None:
        yield "no home position for the fence"
    late_s, most_s = autopilot.round_trip_s, mission.largest_round_trip_s
    if late_s is not None and late_s > most_s:
        yield f"link late: round trip {late_s:.2f} s, limit {most_s:g}"
    share = autopilot.battery_share
    if share is not None and share <= mission.battery.critical:
        yield f"battery critical: {100.0 * share:.0f} % left"


def estimate_problems(vehicle: VehicleState | None, mission: MissionConfig, now_s: float) -> Iterator[str]:
    """What stands against flying by an estimate of the vehicle."""
    if vehicle is None or not vehicle.aligned or now_s - vehicle.sensed_time_s > _STALE_S:
        yield "no current vehicle estimate"
    elif vehicle.origin is None:
        yield "no GPS position in our estimate yet"
    elif not vehicle.velocity_std_m_s <= mission.largest_speed_std_m_s:
        std_m_s, most_m_s = vehicle.velocity_std_m_s, mission.largest_speed_std_m_s
        yield f"velocity uncertain: {std_m_s:.1f} m/s, limit {most_m_s:g}"
