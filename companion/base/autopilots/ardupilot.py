"""ArduPilot's ArduCopter, versions 4.3 to 4.7."""

from typing import Final

from companion.base.autopilots.profile import AutopilotMake, OtherName

ARDUPILOT: Final = AutopilotMake(
    kind="ardupilot",
    title="ArduPilot",
    mavlink_autopilot=3,
    flown_versions=((4, 6),),
    modes={  # COPTER_MODE of MAVLink's ardupilotmega dialect
        "STABILIZE": 0,
        "ACRO": 1,
        "ALT_HOLD": 2,
        "AUTO": 3,
        "GUIDED": 4,
        "LOITER": 5,
        "RTL": 6,
        "CIRCLE": 7,
        "LAND": 9,
        "POSHOLD": 16,
        "BRAKE": 17,
        "GUIDED_NOGPS": 20,
        "SMART_RTL": 21,
    },
    control_mode="GUIDED",
    # LOITER reads the pilot's sticks, and without a radio it sinks: BRAKE stops and holds
    hold_mode="BRAKE",
    land_mode="LAND",
    stick_modes=frozenset({"STABILIZE", "ACRO", "ALT_HOLD", "LOITER", "POSHOLD"}),
    # it takes off in its control mode alone
    waits_in=frozenset({"GUIDED"}),
    climbs_in=frozenset({"GUIDED"}),
    after_take_off="GUIDED",
    # it shapes velocities and accelerations so slowly that no loop around them is quick
    setpoint="attitude",
    raises_thrust_by_tilt=True,
    thrust_may_be_climb_rate=True,  # GUID_OPTIONS
    needs_setpoints_to_arm=False,
    unused_parameter=0.0,  # it takes NaN for a number
    takes_off_from_home=True,
    # the mode is a pilot's word, and it has no CURRENT_MODE
    rates_hz={"EKF_STATUS_REPORT": 2.0, "HEARTBEAT": 5.0},
    prearm_in_health_alone=False,  # an old one has no such bit at all
    reports_outputs=True,
    target_frame="body",  # AC_PrecLand_Companion.cpp; other positions are dropped
    carries_target_on=True,  # with bit 0 of PLND_OPTIONS
    # HIGHRES_IMU is not in every firmware, and replaces RAW_IMU where another client asked for it
    imu_messages=("RAW_IMU", "SCALED_IMU", "HIGHRES_IMU"),
    # the two-pole filters at 20 Hz (INS_GYRO_FILTER, INS_ACCEL_FILTER) delay by sqrt(2) / (2 pi 20 Hz)
    imu_latency_s=0.011,
    stream_advice="ArduPilot: SRx_RAW_SENS, SRx_EXTRA3, and the port's baud rate",
    integers_as_bytes=False,
    read_parameters=(
        "ANGLE_MAX",
        "WPNAV_ACCEL",
        "PSC_JERK_XY",
        "MOT_THST_HOVER",
        "GUID_TIMEOUT",
        "FENCE_ENABLE",
        "FENCE_TYPE",
        "FENCE_ACTION",
        "FS_GCS_ENABLE",
        "SYSID_MYGCS",
    ),
    loss_parameters=("GUID_TIMEOUT",),
    levels_without_setpoints=True,
    # ArduCopter 4.7 renamed and rescaled (ardupilot.org, parameter name changes from 4.6 to 4.7)
    other_names={
        "ANGLE_MAX": (OtherName("ATC_ANGLE_MAX", 100.0),),  # centidegrees; degrees
        "LAND_SPEED": (OtherName("LAND_SPD_MS", 100.0),),  # cm/s; m/s
        "WPNAV_ACCEL": (OtherName("WP_ACC", 100.0),),  # cm/s²; m/s²
        "PSC_JERK_XY": (OtherName("PSC_NE_JERK", 1.0),),  # m/s³
        "SYSID_MYGCS": (OtherName("MAV_GCS_SYSID", 1.0),),
    },
)
