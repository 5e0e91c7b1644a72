"""Faults of all that is not a sensor of ours: the pad, the autopilot, its battery, the companion computer.

Data of a scenario, as in `sitl.faults.faults`. What a companion computer does wrong acts in a harness that
runs the app in the simulator's process (`make bench-faults`); elsewhere such a scenario is refused.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from sitl.faults.times import FaultTimes

# ---------------------------------------------------------------- the pad


class PadCovered(FaultTimes):
    """A tarpaulin lies over the markers; the board is still there."""

    kind: Literal["pad_covered"]


class PadWrongIds(FaultTimes):
    """The board shows other markers than the pad's: another pad."""

    kind: Literal["pad_wrong_ids"]


class PadResized(FaultTimes):
    """The pad is printed larger or smaller than its file says, as A3 on A4."""

    kind: Literal["pad_resized"]
    scale: float = Field(default=0.71, ge=0.2, le=3.0, description="Factor on all lengths of the print")


class PadTwin(FaultTimes):
    """A second, identical pad is in view. It is a picture alone: nothing can stand on it."""

    kind: Literal["pad_twin"]
    north_m: float = Field(
        default=0.0, ge=-50.0, le=50.0, description="North, from the pad's centre to its twin's"
    )
    east_m: float = Field(default=2.0, ge=-50.0, le=50.0, description="East, from the same point")
    moves: bool = Field(
        default=True, description="With the pad; else it rests on the ground from where the pad was"
    )


class PadStops(FaultTimes):
    """The pad stands still at once, as against a kerb; at the end of the fault it goes on."""

    kind: Literal["pad_stops"]


class PadBrakes(FaultTimes):
    """The pad brakes to a standstill, straight on; at the end of the fault it goes on."""

    kind: Literal["pad_brakes"]
    deceleration_m_s2: float = Field(default=3.0, gt=0.0, le=20.0, description="Deceleration until it stands")


class PadTurnsBack(FaultTimes):
    """The pad brakes and drives back the way it came."""

    kind: Literal["pad_turns_back"]
    acceleration_m_s2: float = Field(default=2.0, gt=0.0, le=20.0, description="Backwards")


class PadLeaves(FaultTimes):
    """The pad drives away, straight on."""

    kind: Literal["pad_leaves"]
    speed_m_s: float = Field(default=6.0, gt=0.0, le=30.0, description="At last")
    acceleration_m_s2: float = Field(default=2.0, gt=0.0, le=20.0, description="Up to it")


class PadVanishes(FaultTimes):
    """The pad is gone: neither to be seen nor to be stood on. Its beacon stays where it was."""

    kind: Literal["pad_vanishes"]


class PadTilts(FaultTimes):
    """The pad tilts, as on a vehicle that drives on to a kerb."""

    kind: Literal["pad_tilts"]
    roll_deg: float = Field(default=15.0, ge=-45.0, le=45.0, description="About its heading")
    rate_deg_s: float = Field(default=15.0, gt=0.0, le=360.0, description="Rate of tilting")


# ---------------------------------------------------------------- the autopilot


class AutopilotRefuses(FaultTimes):
    """It denies a request, with or without force. `auto_disarm`: it does not disarm by itself either."""

    kind: Literal["autopilot_refuses"]
    what: Literal["arm", "take_off", "offboard", "land", "disarm", "auto_disarm"] = Field(
        description="Which request"
    )


class PilotMode(FaultTimes):
    """The pilot changes the mode, once."""

    kind: Literal["pilot_mode"]
    mode: Literal["position", "hold", "return", "land"] = Field(
        default="position", description="Mode, as the autopilot calls it"
    )


class AutopilotReboots(FaultTimes):
    """A watchdog's reset in flight: silence, then a new boot time, its hold mode, its default streams.

    The motors stay on, as ArduPilot's in-flight recovery keeps them.
    """

    kind: Literal["autopilot_reboots"]
    silent_s: float = Field(default=2.0, gt=0.0, le=60.0, description="Nothing is sent or taken")

    @property
    def lasts_s(self) -> float:
        """It is silent no longer than that."""
        return min(self.duration_s, self.silent_s)


class AutopilotDisarms(FaultTimes):
    """Its motors stop wherever it is: the pilot's switch, or a land detector that errs."""

    kind: Literal["autopilot_disarms"]


class AutopilotPositionLost(FaultTimes):
    """Its estimator gives no position: none is sent, and it says so. It flies on as it did."""

    kind: Literal["autopilot_position_lost"]


class BatteryCharge(FaultTimes):
    """The battery's remaining charge, as reported in SYS_STATUS and BATTERY_STATUS."""

    kind: Literal["battery"]
    remaining_percent: int = Field(default=15, ge=-1, le=100, description="-1: the autopilot does not know")


class FollowMe(FaultTimes):
    """The ground station sends its operator's place as FOLLOW_TARGET, unasked, as QGroundControl does."""

    kind: Literal["follow_me"]
    north_m: float = Field(default=20.0, ge=-500.0, le=500.0, description="Where the operator is, from home")
    east_m: float = Field(default=-15.0, ge=-500.0, le=500.0, description="East, from the same point")
    rate_hz: float = Field(default=1.0, gt=0.0, le=10.0, description="How often it is sent")


class SecondCompanion(FaultTimes):
    """A duplicate of the companion, under another component id, sends setpoints too: stand still."""

    kind: Literal["second_companion"]
    component_id: int = Field(default=196, ge=1, le=255, description="Component of the vehicle's system")
    rate_hz: float = Field(default=10.0, gt=0.0, le=50.0, description="How often it sends one")


class ForgedFrames(FaultTimes):
    """Somebody without the key sends frames in the autopilot's name, with the largest time stamp there is."""

    kind: Literal["forged_frames"]
    rate_hz: float = Field(default=1.0, gt=0.0, le=50.0, description="How often one is sent")


# ---------------------------------------------------------------- the companion computer


class ImuNan(FaultTimes):
    """The IMU's driver hands on samples that are no numbers."""

    kind: Literal["imu_nan"]


class SolverInfeasible(FaultTimes):
    """The MPC finds no solution."""

    kind: Literal["solver_infeasible"]


class SolverLate(FaultTimes):
    """The MPC's time is up before it has found its solution, in each cycle."""

    kind: Literal["solver_late"]


class SolverNan(FaultTimes):
    """The MPC's solution is no number, and it says that it solved."""

    kind: Literal["solver_nan"]


class DiskFull(FaultTimes):
    """Nothing more can be written to the log's disk."""

    kind: Literal["disk_full"]


class DiskSlow(FaultTimes):
    """Every write to the log's disk takes long."""

    kind: Literal["disk_slow"]
    write_s: float = Field(default=0.02, gt=0.0, le=10.0, description="Each, by the clock on the wall")


NonSensorFault = (
    PadCovered
    | PadWrongIds
    | PadResized
    | PadTwin
    | PadStops
    | PadBrakes
    | PadTurnsBack
    | PadLeaves
    | PadVanishes
    | PadTilts
    | AutopilotRefuses
    | PilotMode
    | AutopilotReboots
    | AutopilotDisarms
    | AutopilotPositionLost
    | BatteryCharge
    | FollowMe
    | SecondCompanion
    | ForgedFrames
    | ImuNan
    | SolverInfeasible
    | SolverLate
    | SolverNan
    | DiskFull
    | DiskSlow
)
