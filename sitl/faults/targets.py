"""What faults act on, and the companion computer as far as they change it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from companion.base.geometry import ZERO3
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.camera.camera import CameraModel
from sitl.devices.rack import SensorRack
from sitl.faults.lines import FrameLine, LinkChannel
from sitl.mavlink.ground_station import GroundStation
from sitl.pad.motion import IncidentMotion
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.vehicle.quadrotor import Motors

SolverFault = Literal["none", "infeasible", "late", "nan"]


class ComputerFaults:
    """What goes wrong with the companion computer at present; a harness applies it to the app."""

    def __init__(self) -> None:
        self.clear_faults()

    def clear_faults(self) -> None:
        self.solver: SolverFault = "none"
        self.imu_nan = False
        self.disk_full = False
        self.disk_write_s = 0.0


@dataclass(slots=True)
class FaultTargets:
    """The devices and all else; without a harness of the app nobody has a `computer`.

    `autopilot_sensors`: faults of the environment act on them too. `restart_streams`: the autopilot's links
    begin with their default streams again.
    """

    rack: SensorRack
    autopilot_sensors: SimulatedAutopilotSensors
    frames: FrameLine
    motors: Motors
    to_app: LinkChannel
    to_vehicle: LinkChannel
    camera: CameraModel
    motion: IncidentMotion
    station: GroundStation
    autopilot: SimulatedAutopilot | None = None
    restart_streams: Callable[[], None] = field(default=lambda: None)
    computer: ComputerFaults | None = None

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

    def ways(self, direction: Literal["both", "to_app", "to_vehicle"]) -> tuple[LinkChannel, ...]:
        """The directions of the line that a fault is in."""
        both = {"to_app": self.to_app, "to_vehicle": self.to_vehicle}
        return tuple(both.values()) if direction == "both" else (both[direction],)

    def clear_faults(self) -> None:
        """Clear what lasts; what happened to the pad has its own end."""
        rack, sensors = self.rack, self.autopilot_sensors
        rack.clear_faults()
        sensors.inertial.vibration_factor = 1.0
        sensors.has_sky, sensors.stray_field_ut = True, ZERO3
        for part in (self.frames, self.motors, self.to_app, self.to_vehicle, self.station, self.camera):
            part.clear_faults()
        for own in (self.autopilot, self.computer):
            if own is not None:
                own.clear_faults()
