"""PX4, versions 1.14 to 1.17."""

import math
from typing import Final

from companion.base.autopilots.profile import AutopilotMake


def _custom_mode(main: int, sub: int = 0) -> int:
    """The main mode in bits 16 to 23, the sub mode in bits 24 to 31 (px4_custom_mode.h)."""
    return (main << 16) | (sub << 24)


PX4: Final = AutopilotMake(
    kind="px4",
    title="PX4",
    mavlink_autopilot=12,
    flown_versions=((1, 16), (1, 17)),
    modes={
        "MANUAL": _custom_mode(1),
        "ALTCTL": _custom_mode(2),
        "POSCTL": _custom_mode(3),
        "AUTO.READY": _custom_mode(4, 1),
        "AUTO.TAKEOFF": _custom_mode(4, 2),
        "AUTO.LOITER": _custom_mode(4, 3),
        "AUTO.MISSION": _custom_mode(4, 4),
        "AUTO.RTL": _custom_mode(4, 5),
        "AUTO.LAND": _custom_mode(4, 6),
        "AUTO.FOLLOW_TARGET": _custom_mode(4, 8),
        "AUTO.PRECLAND": _custom_mode(4, 9),
        "ACRO": _custom_mode(5),
        "OFFBOARD": _custom_mode(6),
        "STABILIZED": _custom_mode(7),
    },
    # outside AUTO only POSCTL and the VTOL modes use sub modes
    main_mode_bits=0xFF0000,
    control_mode="OFFBOARD",
    hold_mode="AUTO.LOITER",
    land_mode="AUTO.LAND",
    stick_modes=frozenset({"MANUAL", "ALTCTL", "POSCTL", "ACRO", "STABILIZED"}),
    waits_in=frozenset({"LOITER", "TAKEOFF", "READY", "HOLD"}),
    # it flies to a position in LOITER as well
    climbs_in=frozenset({"LOITER", "TAKEOFF"}),
    after_take_off="AUTO.LOITER",
    # It skips its horizontal velocity loop for a setpoint without such a velocity; that loop's integral and
    # derivative, and its own estimate of the velocity, would else act on every turn and gust besides ours.
    setpoint="acceleration",
    raises_thrust_by_tilt=False,
    thrust_may_be_climb_rate=False,
    needs_setpoints_to_arm=True,  # mode_req_offboard_signal of its failsafe_flags
    unused_parameter=math.nan,
    takes_off_from_home=False,
    # the mode is a pilot's word, and it refuses another rate of HEARTBEAT (1 Hz)
    rates_hz={"CURRENT_MODE": 10.0},
    prearm_in_health_alone=True,
    reports_outputs=False,
    target_frame="local_ned",  # mavlink_receiver.cpp; other positions are refused with a text
    carries_target_on=False,
    # its RAW_IMU is in counts, and its SCALED_IMU has the field in the compass's own axes
    imu_messages=("HIGHRES_IMU",),
    imu_latency_s=0.004,  # half the integration interval and the chip's filter
    stream_advice="PX4: MAV_x_MODE Onboard, MAV_x_RATE for the bandwidth",
    integers_as_bytes=True,
    read_parameters=("MPC_TILTMAX_AIR", "MPC_THR_HOVER", "COM_OF_LOSS_T", "COM_OBL_RC_ACT"),
    loss_parameters=("COM_OF_LOSS_T", "COM_OBL_RC_ACT"),
    levels_without_setpoints=False,
)
