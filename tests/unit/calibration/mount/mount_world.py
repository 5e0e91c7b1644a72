"""The hand-held world for `calibrate-mount`, in virtual time: its boards for the program, and the truth."""

from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.mount.model import GYRO_MATRIX, exp, log, nearest_rotation
from calibration.mount.record_motion import MountSensors, SensorOpener, record
from calibration.mount.solver import MountSolution
from companion.base.clock import run_in_virtual_time
from companion.base.geometry import GRAVITY_M_S2, FloatArray
from companion.config import CompanionConfig, InertialCalibration, find_file, merge, validate
from sitl.run.in_process import InProcess, carried
from sitl.scenario.scenario import Scenario, load_scenario
from sitl.vehicle import HandMotion


@dataclass
class HandHeld:
    """A vehicle carried by hand, and the process's own handle on it once it runs."""

    scenario: Scenario
    seed: int
    motion: HandMotion
    vehicle: InProcess | None = None

    def boards(self, config: CompanionConfig, camera: bool) -> AbstractAsyncContextManager[MountSensors]:
        """What the program opens instead of a vehicle's ports."""
        return self._boards(camera=camera)

    @asynccontextmanager
    async def _boards(self, *, camera: bool) -> AsyncIterator[MountSensors]:
        async with carried(self.scenario, self.seed, self.motion, camera=camera) as vehicle:
            self.vehicle = vehicle
            yield MountSensors(vehicle.imu_bus, vehicle.frames)

    @property
    def body_from_camera(self) -> FloatArray:
        """The true rotation (3, 3)."""
        assert self.vehicle is not None
        return self.vehicle.simulation.sensor_truth.camera.body_from_camera

    @property
    def gyro_axes(self) -> FloatArray:
        """The rotation (3, 3) by which the gyroscope, as it is, sees the body turned; its skew left out."""
        assert self.vehicle is not None
        board = self.vehicle.simulation.sensor_truth.boards
        return nearest_rotation(board.sensor_from_body.T @ board.gyroscope.matrix @ board.sensor_from_body)

    def felt_level(self, calibrated: InertialCalibration | None) -> FloatArray:
        """The tilt (3, 3) by which the accelerometer, calibrated so, takes the level body to be turned."""
        assert self.vehicle is not None
        board = self.vehicle.simulation.sensor_truth.boards
        at_rest = board.sensor_from_body @ np.array([0.0, 0.0, -GRAVITY_M_S2])
        force = board.accelerometer.matrix @ at_rest + board.accelerometer.offset
        if calibrated is not None and (known := calibrated.accelerometer) is not None:
            force = np.array(known.matrix) @ (force - known.offset_m_s2)
        down = -(board.sensor_from_body.T @ force) / np.linalg.norm(force)
        return exp(np.cross([0.0, 0.0, 1.0], down))

    def rotation_errors(self, solution: MountSolution) -> tuple[FloatArray, FloatArray]:
        """Errors (3,) rad of a solution's rotations: against the airframe, and against the gyroscope."""
        to_gyro = self.gyro_axes @ self.body_from_camera
        to_body = solution.unknowns.body_from_camera @ self.body_from_camera.T
        felt = nearest_rotation(np.eye(3) + solution.unknowns.values[GYRO_MATRIX].reshape(3, 3))
        return log(to_body), log(felt @ solution.unknowns.body_from_camera @ to_gyro.T)


def scenario_of(changes: dict[str, Any], base: str = "static") -> Scenario:
    """A shipped scenario with changes."""
    shipped = load_scenario(find_file("scenarios", base)).model_dump()
    return validate(Scenario, merge(shipped, changes), base)


def mount_errors(seed: int, largest_deg: float = 4.0) -> tuple[list[float], float]:
    """A mount's error (roll, pitch, yaw; deg) and a stamp's (s), by a seed of their own."""
    rng = np.random.default_rng((seed, 77))
    return rng.uniform(-largest_deg, largest_deg, 3).round(3).tolist(), float(rng.uniform(-0.03, 0.03))


def record_sway(held: HandHeld, config: CompanionConfig, folder: Path, seconds: float) -> None:
    """Record a held vehicle into a folder, as the program does it."""
    boards_of: SensorOpener = held.boards
    run_in_virtual_time(record(config, folder, seconds, None, boards_of, virtual=True))
