"""Injection of the faults that are no sensor's: the pad, what is in view, the autopilot, the computer.

What lasts is applied again whenever a fault starts or ends (`NON_SENSOR`); what happens once has a beginning
and, some, an end (`BEGIN`, `END`). SI units, NED.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from companion.base.geometry import Vector3
from companion.config import ConfigError
from companion.pad import Pad
from sitl.autopilot import SimulatedAutopilot
from sitl.autopilot.flight.profile import AutopilotProfile
from sitl.camera.camera import CameraModel
from sitl.camera.textures import covered_texture, other_ids_texture
from sitl.faults import non_sensor_faults
from sitl.faults.computer import ComputerFaults
from sitl.mavlink.ground_station import GroundStation
from sitl.mavlink.intruders import Companion, Forger
from sitl.pad.incidents import AT_ONCE_M_S2, IncidentMotion

COMPUTER_KINDS: Final = frozenset(
    {"imu_nan", "solver_infeasible", "solver_late", "solver_nan", "disk_full", "disk_slow"}
)
AUTOPILOT_KINDS: Final = frozenset(
    {
        "autopilot_refuses",
        "pilot_mode",
        "autopilot_reboots",
        "autopilot_disarms",
        "autopilot_position_lost",
        "battery",
        "second_companion",
    }
)
# the board's surface over the ground, for a pad that somebody has left there
TWIN_HEIGHT_M: Final = 0.1
RESUMES_M_S2: Final = 3.0


@dataclass(slots=True)
class NonSensorTargets:
    """What these faults act on; without a harness of the app nobody has a `computer`.

    `restart_streams`: the autopilot's links begin with their default streams again.
    """

    camera: CameraModel
    pad: Pad
    motion: IncidentMotion
    autopilot: SimulatedAutopilot | None = None
    restart_streams: Callable[[], None] = field(default=lambda: None)
    computer: ComputerFaults | None = None
    station: GroundStation | None = None

    def clear_faults(self) -> None:
        """Clear what lasts; what happened to the pad has its own end."""
        self.camera.show(None)
        self.camera.print_scale = 1.0
        if self.autopilot is not None:
            self.autopilot.clear_faults()
        if self.computer is not None:
            self.computer.clear_faults()
        if self.station is not None:
            self.station.clear_faults()

    def check(self, kinds: set[str]) -> None:
        """Raise ConfigError when a kind has nothing here that it could act on."""
        if self.computer is None and (beyond := kinds & COMPUTER_KINDS):
            raise ConfigError(
                f"faults: {min(beyond)} is the companion computer's, which make bench-faults simulates"
            )
        if self.autopilot is None and (beyond := kinds & AUTOPILOT_KINDS):
            raise ConfigError(f"faults: {min(beyond)} needs the bundled autopilot, not a firmware")

    @property
    def bundled(self) -> SimulatedAutopilot:
        """The autopilot of a schedule that has been checked."""
        assert self.autopilot is not None
        return self.autopilot

    @property
    def host(self) -> ComputerFaults:
        """The computer of a schedule that has been checked."""
        assert self.computer is not None
        return self.computer


# ---------------------------------------------------------------- what lasts


def cover_pad(_fault: non_sensor_faults.PadCovered, targets: NonSensorTargets) -> None:
    """A tarpaulin over the markers."""
    targets.camera.show(covered_texture(targets.pad))


def change_ids(_fault: non_sensor_faults.PadWrongIds, targets: NonSensorTargets) -> None:
    """Other markers."""
    targets.camera.show(other_ids_texture(targets.pad))


def refuse(fault: non_sensor_faults.AutopilotRefuses, targets: NonSensorTargets) -> None:
    """One more request that is denied."""
    targets.bundled.refused |= {fault.what}


def lose_position(_fault: non_sensor_faults.AutopilotPositionLost, targets: NonSensorTargets) -> None:
    """No position to send."""
    targets.bundled.position_lost = True


def drain_battery(fault: non_sensor_faults.BatteryCharge, targets: NonSensorTargets) -> None:
    """Less charge."""
    targets.bundled.battery.false_share = 0.01 * fault.remaining_percent


def follow_operator(fault: non_sensor_faults.FollowMe, targets: NonSensorTargets) -> None:
    """Another place, unasked."""
    if targets.station is not None:
        targets.station.follow((fault.north_m, fault.east_m, 0.0), fault.rate_hz)


def send_more_setpoints(fault: non_sensor_faults.SecondCompanion, targets: NonSensorTargets) -> None:
    """Setpoints of somebody else."""
    if targets.station is not None:
        targets.station.intruders["setpoints"] = Companion(fault.component_id, 1.0 / fault.rate_hz)


def forge_frames(fault: non_sensor_faults.ForgedFrames, targets: NonSensorTargets) -> None:
    """Frames of somebody without the key."""
    if targets.station is not None:
        targets.station.intruders["forged"] = Forger(1.0 / fault.rate_hz)


def break_samples(_fault: non_sensor_faults.ImuNan, targets: NonSensorTargets) -> None:
    """No numbers from the IMU."""
    targets.host.imu_nan = True


def find_no_solution(_fault: non_sensor_faults.SolverInfeasible, targets: NonSensorTargets) -> None:
    """No solution."""
    targets.host.solver = "infeasible"


def delay_solver(_fault: non_sensor_faults.SolverLate, targets: NonSensorTargets) -> None:
    """No solution in time."""
    targets.host.solver = "late"


def break_solution(_fault: non_sensor_faults.SolverNan, targets: NonSensorTargets) -> None:
    """A solution that is none."""
    targets.host.solver = "nan"


def fill_disk(_fault: non_sensor_faults.DiskFull, targets: NonSensorTargets) -> None:
    """No space left."""
    targets.host.disk_full = True


def slow_disk(fault: non_sensor_faults.DiskSlow, targets: NonSensorTargets) -> None:
    """Writes that take long."""
    targets.host.disk_write_s = fault.write_s


def resize_print(fault: non_sensor_faults.PadResized, targets: NonSensorTargets) -> None:
    """Another size of print."""
    targets.camera.print_scale = fault.scale


# ---------------------------------------------------------------- what happens once


def place_twin(fault: non_sensor_faults.PadTwin, targets: NonSensorTargets, now_s: float) -> None:
    """A second pad in view."""
    north, east, _ = targets.motion.beacon_at(now_s).position_ned_m
    left = (north + fault.north_m, east + fault.east_m, -TWIN_HEIGHT_M)

    def beside(pad_ned_m: Vector3) -> Vector3:
        return (pad_ned_m[0] + fault.north_m, pad_ned_m[1] + fault.east_m, pad_ned_m[2])

    targets.camera.twin_ned_m = beside if fault.moves else lambda _pad_ned_m: left


def remove_twin(_fault: non_sensor_faults.PadTwin, targets: NonSensorTargets, _now_s: float) -> None:
    """One pad again."""
    targets.camera.twin_ned_m = None


def stop_pad(_fault: non_sensor_faults.PadStops, targets: NonSensorTargets, now_s: float) -> None:
    """To a standstill at once."""
    targets.motion.drive(now_s, 0.0, AT_ONCE_M_S2)


def brake_pad(fault: non_sensor_faults.PadBrakes, targets: NonSensorTargets, now_s: float) -> None:
    """To a standstill."""
    targets.motion.drive(now_s, 0.0, fault.deceleration_m_s2)


def turn_pad_back(fault: non_sensor_faults.PadTurnsBack, targets: NonSensorTargets, now_s: float) -> None:
    """Back the way it came."""
    targets.motion.turn_back(now_s, fault.acceleration_m_s2)


def send_pad_away(fault: non_sensor_faults.PadLeaves, targets: NonSensorTargets, now_s: float) -> None:
    """Fast, straight on."""
    targets.motion.drive(now_s, fault.speed_m_s, fault.acceleration_m_s2)


def resume_pad(_fault: non_sensor_faults.NonSensorFault, targets: NonSensorTargets, now_s: float) -> None:
    """As fast as before, straight on."""
    targets.motion.drive(now_s, targets.motion.usual_m_s, RESUMES_M_S2)


def take_pad_away(_fault: non_sensor_faults.PadVanishes, targets: NonSensorTargets, now_s: float) -> None:
    """No pad."""
    targets.motion.vanish(now_s)


def bring_pad_back(_fault: non_sensor_faults.PadVanishes, targets: NonSensorTargets, _now_s: float) -> None:
    """The pad again."""
    targets.motion.appear()


def tilt_pad(fault: non_sensor_faults.PadTilts, targets: NonSensorTargets, now_s: float) -> None:
    """Tilt."""
    targets.motion.tilt(now_s, math.radians(fault.roll_deg), math.radians(fault.rate_deg_s))


def level_pad(fault: non_sensor_faults.PadTilts, targets: NonSensorTargets, now_s: float) -> None:
    """Level again."""
    targets.motion.tilt(now_s, 0.0, math.radians(fault.rate_deg_s))


def change_mode(fault: non_sensor_faults.PilotMode, targets: NonSensorTargets, _now_s: float) -> None:
    """The pilot's switch."""
    targets.bundled.set_mode_named(chosen_mode(targets.bundled.profile, fault.mode))


def chosen_mode(profile: AutopilotProfile, mode: str) -> str:
    """What an autopilot calls the mode that `PilotMode` names."""
    position = "POSCTL" if profile.name == "px4" else "LOITER"
    modes = {"position": position, "hold": profile.hold_mode, "return": profile.return_mode}
    return modes.get(mode, profile.land_mode)


def stop_motors(_fault: non_sensor_faults.AutopilotDisarms, targets: NonSensorTargets, _now_s: float) -> None:
    """Disarm, also in the air."""
    targets.bundled.terminate()


def reboot(_fault: non_sensor_faults.AutopilotReboots, targets: NonSensorTargets, now_s: float) -> None:
    """A reset."""
    targets.bundled.recover(now_s)
    targets.restart_streams()


OneShotInjection = Callable[[Any, NonSensorTargets, float], None]
BEGIN: Final[dict[str, OneShotInjection]] = {
    "pad_twin": place_twin,
    "pad_stops": stop_pad,
    "pad_brakes": brake_pad,
    "pad_turns_back": turn_pad_back,
    "pad_leaves": send_pad_away,
    "pad_vanishes": take_pad_away,
    "pad_tilts": tilt_pad,
    "pilot_mode": change_mode,
    "autopilot_reboots": reboot,
    "autopilot_disarms": stop_motors,
}
END: Final[dict[str, OneShotInjection]] = {
    "pad_twin": remove_twin,
    **dict.fromkeys(("pad_stops", "pad_brakes", "pad_turns_back", "pad_leaves"), resume_pad),
    "pad_vanishes": bring_pad_back,
    "pad_tilts": level_pad,
}
_LASTING: Final[dict[str, Callable[[Any, NonSensorTargets], None]]] = {
    "pad_covered": cover_pad,
    "pad_wrong_ids": change_ids,
    "pad_resized": resize_print,
    "autopilot_refuses": refuse,
    "autopilot_position_lost": lose_position,
    "battery": drain_battery,
    "follow_me": follow_operator,
    "second_companion": send_more_setpoints,
    "forged_frames": forge_frames,
    "imu_nan": break_samples,
    "solver_infeasible": find_no_solution,
    "solver_late": delay_solver,
    "solver_nan": break_solution,
    "disk_full": fill_disk,
    "disk_slow": slow_disk,
}


def _of_non_sensor(apply: Callable[[Any, NonSensorTargets], None]) -> Callable[[Any, Any], None]:
    return lambda fault, targets: apply(fault, targets.non_sensor)


NON_SENSOR: Final[dict[str, Callable[[Any, Any], None]]] = {
    kind: _of_non_sensor(apply) for kind, apply in _LASTING.items()
}
