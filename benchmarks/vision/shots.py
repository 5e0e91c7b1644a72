"""Frames of a pad under a hovering vehicle, with what is true in them and what the app would know.

The camera is over the pad at a height over its surface; where, which heading, which moment of the hover and
which attitude error is drawn anew for every shot, so that shots are independent. The app is told what it
would know and nothing else: gravity by an attitude that is wrong by `ATTITUDE_STD_RAD` about each level axis,
how it turns by a gyroscope, and the pad's last estimate, wrong by as much as it says.

Where corners truly are in the image is worked out here with OpenCV's projection, apart from the app's lens:
each at the moment at which its row is exposed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final

import cv2
import numpy as np

from companion.base.geometry import (
    FloatArray,
    Quaternion,
    Vector3,
    add,
    matrix_from_quat,
    norm,
    quat_conjugate,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_multiply,
    quat_normalise,
    quat_rotate,
    quat_rotate_inverse,
    rotation_vector_from_quat,
    scale,
    subtract,
    vector3,
)
from companion.base.messages import Frame, MarkerGroup, PadPrior
from companion.config import CameraConfig, VehicleConfig, find_file, load_model
from companion.estimate.estimator import READOUT_S
from companion.pad import Marker, Pad, load_pad
from sitl.autopilot.control.estimator import ESTIMATORS
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings
from sitl.camera.textures import Texture
from sitl.run.simulation import PHYSICS_STEP_S
from sitl.scenario.scenario import Scenario, load_scenario
from sitl.sensors.inertial import ImuErrors
from sitl.world.wind import WindSettings
from sitl.world.world import World

SHIPPED_PAD: Final = "moving_1300"
CAMERAS: Final = {"1280x720": "hd_1280x720", "640x480": "sitl_640x480"}
VEHICLE: Final = "x500"
# 0.7 degrees about each level axis, 1 degree in all
ATTITUDE_STD_RAD: Final = math.radians(0.7)
HEADING_STD_RAD: Final = math.radians(1.0)
# what is left of the gyroscope's bias
RATE_STD_RAD_S: Final = 0.005
SURFACE_M: Final = 0.05
# the camera's place over the pad: so far, and so much more a metre of height
AIM_STD_M: Final = 0.02
AIM_STD_PER_M: Final = 0.03
# what the pad filter says of itself while it tracks
PRIOR_STD_M: Final = 0.02
PRIOR_STD_PER_M: Final = 0.01
INSTANTS: Final = 17
WHITE_SHARE: Final = 0.4
TRIES: Final = 200


@lru_cache(maxsize=8)
def camera_named(size: str) -> CameraConfig:
    """The camera of a resolution."""
    return load_model(CameraConfig, find_file("cameras", CAMERAS[size]))


@lru_cache(maxsize=1)
def vehicle() -> VehicleConfig:
    """The airframe that carries it."""
    return load_model(VehicleConfig, find_file("vehicles", VEHICLE))


@lru_cache(maxsize=8)
def pad_of(side_cm: float) -> Pad:
    """A pad of one marker of that side; 0: the shipped one.

    As section 2.2 has it, large ones carry a simpler code: the shipped pad's dictionaries.
    """
    if side_cm == 0.0:
        return load_pad(SHIPPED_PAD)
    side_m = 0.01 * side_cm
    group: MarkerGroup = "F" if side_m > 0.15 else "M" if side_m > 0.07 else "C"
    code = Marker(
        dictionary="4x4_50" if group == "F" else "5x5_50",
        id=3,
        side_m=side_m,
        position_pad_m=(0.0, 0.0),
        group=group,
    )
    board_m = side_m * (1.0 + 2.0 * WHITE_SHARE)
    return Pad(name=f"single_{side_cm:g}", width_m=board_m, length_m=board_m, markers=(code,))


@dataclass(frozen=True)
class HoverScene:
    """A pad that lies still under a vehicle that hovers."""

    moment: HoverMoment
    tilt: Quaternion
    start_ned_m: Vector3
    pad_heading_rad: float

    def pose(self, time_s: float) -> ScenePose:
        """What is where."""
        away, attitude = self.moment.at(time_s)
        attitude = quat_multiply(self.tilt, attitude)
        place = add(self.start_ned_m, quat_rotate(self.tilt, away))
        return ScenePose(place, attitude, (0.0, 0.0, -SURFACE_M), self.pad_heading_rad)

    def rate_body_rad_s(self, time_s: float) -> Vector3:
        """Mean rate of turn, body axes, while a picture is read out."""
        before, after = (self.pose(time_s + sign * 0.5 * READOUT_S).vehicle_attitude for sign in (-1.0, 1.0))
        return scale(rotation_vector_from_quat(quat_multiply(quat_conjugate(before), after)), 1.0 / READOUT_S)

    def pad_in_body(self, time_s: float) -> tuple[Vector3, Quaternion]:
        """The pad's place in body axes (m), and body-from-pad."""
        pose = self.pose(time_s)
        away = subtract(pose.pad_position_ned_m, pose.vehicle_position_ned_m)
        level_pad = quat_from_euler(0.0, 0.0, self.pad_heading_rad)
        to_body = quat_conjugate(pose.vehicle_attitude)
        return quat_rotate(to_body, away), quat_multiply(to_body, level_pad)


@dataclass(frozen=True)
class BenchShot:
    """One frame, its truth, and what the app would expect of it."""

    frame: Frame
    scene: HoverScene
    prior: PadPrior


class PadBeforeCamera:
    """One pad (or another print) before one camera."""

    def __init__(
        self,
        camera: CameraConfig,
        pad: Pad,
        rng: np.random.Generator,
        board: Texture | None = None,
        *,
        finer: int = 1,
        instants: int = INSTANTS,
    ) -> None:
        """`finer`: each pixel is the mean of so many by so many places, for corners to a hundredth of one.

        `instants`: at so many times within a frame the scene is looked at.
        """
        self.camera, self.pad = camera, pad
        self._single = len(self.pad.markers) == 1
        self._rng = rng
        settings = ImagingSettings()
        noise = rng.spawn(1)[0]
        self._model = CameraModel(
            self.camera, vehicle(), self.pad, settings, noise, board=board, instants=instants, finer=finer
        )
        self.body_from_camera = self._model.body_from_camera
        self._sequence = 0

    def shoot(self, height_m: float, tilt_rad: float | None = None) -> BenchShot:
        """A frame from a height (m) over the surface; a single marker is whole in it.

        `tilt_rad`: how far the vehicle tilts, in any direction; else as the hover goes.
        """
        scene = self.scene(height_m, tilt_rad)
        return BenchShot(self.frame(scene, 0.0), scene, self.expectation(scene, 0.0, height_m))

    def scene(self, height_m: float, tilt_rad: float | None = None, follows_s: float = 0.0) -> HoverScene:
        """Draw one.

        Raises:
            RuntimeError: the marker does not fit in the picture.
        """
        for _ in range(TRIES):
            scene = self._draw(height_m, tilt_rad, follows_s)
            if not self._single or self._whole(scene):
                return scene
        raise RuntimeError(f"{self.pad.name} at {height_m:g} m: never whole in {self.camera.name}")

    def frame(self, scene: HoverScene, time_s: float) -> Frame:
        """Take one picture."""
        self._sequence += 1
        image = self._model.render(time_s, scene.pose)
        return Frame(time_s, time_s + 0.03, self._sequence, image)

    def expectation(self, scene: HoverScene, time_s: float, height_m: float) -> PadPrior:
        """What the app expects: the truth, wrong by as much as its estimates are."""
        rng, place = self._rng, scene.pad_in_body(time_s)[0]
        std_m = PRIOR_STD_M + PRIOR_STD_PER_M * height_m
        east_north = rng.normal(0.0, ATTITUDE_STD_RAD, 2).tolist()
        wrong = quat_from_rotation_vector((*east_north, float(rng.normal(0.0, HEADING_STD_RAD))))
        pose = scene.pose(time_s)
        down = quat_rotate_inverse(quat_multiply(wrong, pose.vehicle_attitude), (0.0, 0.0, 1.0))
        level_pad = quat_from_euler(0.0, 0.0, scene.pad_heading_rad)
        to_body = quat_conjugate(quat_multiply(wrong, pose.vehicle_attitude))
        missed = vector3(rng.normal(0.0, std_m, 3).tolist())
        rate = add(scene.rate_body_rad_s(time_s), vector3(rng.normal(0.0, RATE_STD_RAD_S, 3).tolist()))
        return PadPrior(
            time_s,
            down,
            add(place, missed),
            quat_multiply(to_body, level_pad),
            std_m,
            rate_body_rad_s=rate,
        )

    # ------------------------------------------------------------ the truth

    def pixels(
        self, scene: HoverScene, points_pad_m: FloatArray, time_s: float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Where points (n, 3) of the pad are in the frame (n, 2), and when their rows are exposed (n,), s.

        The picture of each row is of its own moment: the point is followed through the frame until its row is
        the one that is being exposed.
        """
        half = 0.5 * self.camera.readout_s
        times = np.linspace(-half, half, INSTANTS)
        tracks = np.array([self._pixels_at(scene, points_pad_m, time_s + float(t)) for t in times])
        row_times = (tracks[..., 1] + 0.5) / self.camera.height_px * 2.0 * half - half
        # the row's time less the track's falls steadily: where it is zero
        ahead = row_times - times[:, None]
        first = np.clip((ahead > 0.0).sum(axis=0) - 1, 0, INSTANTS - 2)
        k = np.arange(len(points_pad_m))
        a, b = ahead[first, k], ahead[first + 1, k]
        share = np.clip(a / np.where(a == b, 1.0, a - b), -1.0, 2.0)
        pixels = tracks[first, k] + share[:, None] * (tracks[first + 1, k] - tracks[first, k])
        return pixels, times[first] + share * (times[1] - times[0]) + time_s

    def in_camera(self, scene: HoverScene, points_pad_m: FloatArray, time_s: float) -> FloatArray:
        """Points (n, 3) of the pad in camera axes (m)."""
        rotation, position = self.pose_in_camera(scene, time_s)
        return points_pad_m @ rotation.T + position

    def pose_in_camera(self, scene: HoverScene, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Camera-from-pad (3, 3), and the pad's place (3,) in camera axes."""
        place, body_from_pad = scene.pad_in_body(time_s)
        mount = np.array(self._model.position_body_m)
        rotation = self.body_from_camera.T @ matrix_from_quat(body_from_pad)
        return rotation, self.body_from_camera.T @ (np.array(place) - mount)

    def _pixels_at(self, scene: HoverScene, points_pad_m: FloatArray, time_s: float) -> FloatArray:
        camera, points = self.camera, self.in_camera(scene, points_pad_m, time_s)
        matrix = np.array(
            [[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]]
        )
        pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(camera.distortion))
        return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)

    # ------------------------------------------------------------ drawing

    def _draw(self, height_m: float, tilt_rad: float | None, follows_s: float) -> HoverScene:
        rng = self._rng
        moment = HoverMoment.draw(rng, vehicle(), follows_s)
        attitude = moment.at(0.0)[1]
        yaw = quat_from_euler(0.0, 0.0, float(rng.uniform(-math.pi, math.pi)))
        tilt, aim = yaw, rng.normal(0.0, AIM_STD_M + AIM_STD_PER_M * height_m, 2).tolist()
        if tilt_rad is not None:
            tilt = quat_multiply(_turn_to(quat_multiply(yaw, attitude), tilt_rad, rng), yaw)
            # the camera looks at the pad all the same
            north, east, down = quat_rotate(quat_multiply(tilt, attitude), (0.0, 0.0, 1.0))
            aim = [aim[0] - height_m * north / down, aim[1] - height_m * east / down]
        lever = quat_rotate(quat_multiply(tilt, attitude), self._model.position_body_m)
        camera = (aim[0], aim[1], -SURFACE_M - height_m)
        heading = float(rng.uniform(-math.pi, math.pi))
        return HoverScene(moment, tilt, subtract(camera, lever), heading)

    def _whole(self, scene: HoverScene) -> bool:
        """Whether every marker is in the picture with a cell's breadth of white around it."""
        pixels = self._pixels_at(scene, 1.25 * self._corners, 0.0)
        size = (self.camera.width_px - 1, self.camera.height_px - 1)
        return bool((pixels > 0.0).all() and (pixels < size).all())

    @cached_property
    def _corners(self) -> FloatArray:
        return np.concatenate([marker.corners_pad_m() for marker in self.pad.markers])


def _turn_to(attitude: Quaternion, tilt_rad: float, rng: np.random.Generator) -> Quaternion:
    """The turn, applied after it, by which an attitude comes to tilt so far in any direction."""
    towards = float(rng.uniform(-math.pi, math.pi))
    flat = math.sin(tilt_rad)
    wished: Vector3 = (flat * math.cos(towards), flat * math.sin(towards), math.cos(tilt_rad))
    x, y, z = quat_rotate(attitude, (0.0, 0.0, 1.0))
    u, v, w = wished
    axis: Vector3 = (y * w - z * v, z * u - x * w, x * v - y * u)
    sine = norm(axis)
    angle = math.atan2(sine, x * u + y * v + z * w)
    return quat_from_rotation_vector(scale(axis, angle / sine if sine > 1e-9 else 1.0))


# ---------------------------------------------------------------- hover
# How a hovering vehicle moves while a frame is exposed: flown by the simulator, the rotors' vibration on
# top.
#
# The flight: the simulated autopilot holds its place at 6 m in MIL-F-8785C moderate turbulence on a mean wind
# of 5 m/s. It tilts by 3.4 degrees, turns at 3.2 deg/s and drifts at 0.19 m/s (rms); an ArduPilot hover that
# was recorded in the open (log171.bin of dronekit-la-testdata, 195 to 210 s) turned at 4.3, 2.5 and 1.2 deg/s
# rms.
#
# The vibration: what the simulated gyroscope and accelerometer feel of the rotors (`sitl.sensors.inertial`),
# integrated to the motion that the camera makes: at half throttle 92 Hz, 0.05 px at a focal length of 1065
# px.
#
# World NED and FRD, SI. Places count from where the vehicle was at the moment asked for.

WIND: Final = WindSettings(mean_m_s=5.0, turbulence="moderate")
HEIGHT_M: Final = 6.0
ASKED_S: Final = 6.0
STEADY_S: Final = 25.0
FLOWN_S: Final = 40.0
# around a moment, for frames that follow one another
MARGIN_S: Final = 0.1
FLIGHTS: Final = 3


@dataclass(frozen=True)
class HoverFlight:
    """A hover, every physics step of it: places (n, 3) and attitudes (n, 4)."""

    positions_ned_m: FloatArray
    attitudes: FloatArray

    @property
    def length_s(self) -> float:
        """From the first sample to the last."""
        return (len(self.attitudes) - 1) * PHYSICS_STEP_S

    def at(self, time_s: float) -> tuple[Vector3, Quaternion]:
        """Place and attitude since its first sample, straight between samples."""
        steps = time_s / PHYSICS_STEP_S
        k = min(max(int(steps), 0), len(self.attitudes) - 2)
        share = steps - k
        here = (1.0 - share) * self.positions_ned_m[k] + share * self.positions_ned_m[k + 1]
        w, x, y, z = ((1.0 - share) * self.attitudes[k] + share * self.attitudes[k + 1]).tolist()
        return vector3(here.tolist()), quat_normalise((w, x, y, z))

    @property
    def speed_std_m_s(self) -> float:
        """Of each axis."""
        return float(np.std(np.diff(self.positions_ned_m, axis=0) / PHYSICS_STEP_S))

    @property
    def rate_std_rad_s(self) -> float:
        """Of roll and pitch."""
        return float(np.std(2.0 * np.diff(self.attitudes[:, 1:3], axis=0) / PHYSICS_STEP_S))


@lru_cache(maxsize=FLIGHTS)
def flight(seed: int) -> HoverFlight:
    """Fly one.

    Raises:
        RuntimeError: the simulated vehicle does not hover.
    """
    scenario: Scenario = load_scenario("static").model_copy(update={"wind": WIND, "start_heading_deg": 0.0})
    world = World(scenario, seed)
    rng = np.random.default_rng((seed, 1))
    autopilot = SimulatedAutopilot(
        "px4", world.airframe.body, rng, scenario.place, ESTIMATORS["typical"], world.airframe.rates
    )
    asked, samples = False, []
    while world.time_s < STEADY_S + FLOWN_S:
        if world.time_s >= ASKED_S and not asked:
            autopilot.arm()
            autopilot.take_off(scenario.place[2] + HEIGHT_M)
            asked = True
        world.step(autopilot.step(world.state, PHYSICS_STEP_S, world.time_s), PHYSICS_STEP_S)
        if world.time_s >= STEADY_S:
            samples.append((*world.state.position_ned_m, *world.state.attitude))
    table = np.array(samples)
    if abs(table[:, 2].mean() + HEIGHT_M) > 1.0:
        raise RuntimeError(f"the vehicle hovers at {-table[:, 2].mean():.1f} m; expected {HEIGHT_M:g} m")
    signs = np.where(table[:, 3:4] < 0.0, -1.0, 1.0)
    return HoverFlight(table[:, :3], table[:, 3:] * signs)


@dataclass(frozen=True)
class HoverMoment:
    """A moment of a hover, and what comes before and after it."""

    flight: HoverFlight
    time_s: float
    rotor_phase_rad: float
    throttle: float

    @classmethod
    def draw(cls, rng: np.random.Generator, vehicle: VehicleConfig, follows_s: float = 0.0) -> HoverMoment:
        """Any moment of any of the flights that goes on for so long."""
        chosen = flight(int(rng.integers(FLIGHTS)))
        time_s = rng.uniform(MARGIN_S, chosen.length_s - MARGIN_S - follows_s)
        return cls(chosen, float(time_s), float(rng.uniform(0.0, math.tau)), vehicle.hover_thrust)

    @property
    def rotor_rate_rad_s(self) -> float:
        """How fast the rotors turn, which is how fast they shake."""
        return math.tau * ImuErrors().full_rotor_hz * math.sqrt(self.throttle)

    @property
    def shaken_rad(self) -> float:
        """How far to either hand they turn the vehicle about roll and pitch."""
        return math.sqrt(2.0) * self.throttle * ImuErrors().vibration_rad_s / self.rotor_rate_rad_s

    def at(self, since_s: float) -> tuple[Vector3, Quaternion]:
        """How far the vehicle is from where it was, and its attitude."""
        here, attitude = self.flight.at(self.time_s + since_s)
        start, _ = self.flight.at(self.time_s)
        shaken, turned = self._vibration(since_s)
        attitude = quat_multiply(attitude, quat_from_rotation_vector(turned))
        x, y, z = (a - b for a, b in zip(here, start, strict=True))
        return add((x, y, z), quat_rotate(attitude, shaken)), attitude

    def _vibration(self, since_s: float) -> tuple[Vector3, Vector3]:
        """Displacement (m) and small turn (rad), body axes, by integrals of `sitl.sensors.inertial`."""
        turn_rate, turn = self.rotor_rate_rad_s, self.shaken_rad
        phase = self.rotor_phase_rad + turn_rate * since_s
        s, c, s2, c2 = math.sin(phase), math.cos(phase), math.sin(2.0 * phase), math.cos(2.0 * phase)
        far = -math.sqrt(2.0) * self.throttle * ImuErrors().vibration_m_s2 / turn_rate**2
        displaced = (far * s, far * c, far * (0.5 * s + 0.1875 * s2))
        return displaced, (turn * s, -turn * c, -0.25 * turn * c2)
