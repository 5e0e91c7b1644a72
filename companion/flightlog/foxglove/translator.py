"""From each of our messages what Foxglove knows by itself, in the order of writing."""

import math
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from typing import Any, Final

from pydantic import BaseModel

from companion.base.geometry import ZERO3, Vector3, add, quat_from_euler
from companion.base.messages import (
    ControlReport,
    Frame,
    FrameReport,
    GpsFix,
    Notice,
    PadSighting,
    PadState,
    PlanStep,
    VehicleState,
)
from companion.config import CameraConfig, CompanionConfig, Shape, VehicleConfig
from companion.flightlog.foxglove import camera
from companion.flightlog.foxglove.parts import (
    CAMERA,
    ENU_FROM_NED,
    LOCAL,
    MAP,
    PAD,
    VEHICLE,
    WellKnown,
    pose_in,
    stamp,
    transform,
)
from companion.flightlog.foxglove.scene import obstacle_entity, pad_entity, path_entity, touchdown_entity
from companion.pad import Pad
from companion.sense.vision.pipeline import body_from_camera

# what stands still, and the scene, are said again this often: a reader that jumps in time finds them
STILL_PERIOD_S: Final = 1.0
SCENE_PERIOD_S: Final = 0.2
# frames whose markers may still come
OPEN_FRAMES: Final = 16
LEVELS: Final = {"info": 2, "warning": 3, "error": 4}


class Translator:
    """Keeps what later messages need: the settings, the newest states, the exposures of logged frames."""

    def __init__(self) -> None:
        self._camera: CameraConfig | None = None
        self._vehicle: VehicleConfig | None = None
        self._pad: Pad | None = None
        self._obstacles: tuple[Shape, ...] = ()
        self._overlay: camera.CameraAnnotations | None = None
        self._place: Vector3 = ZERO3
        self._pad_place: Vector3 | None = None
        self._pad_state: PadState | None = None
        self._plan: PlanStep | None = None
        self._exposures_ns: OrderedDict[int, int] = OrderedDict()
        self._still_s = self._scene_s = -math.inf

    def know(self, settings: Mapping[str, BaseModel]) -> None:
        """Take the settings that the flight is flown with; what is not among them is not drawn."""
        for model in settings.values():
            if isinstance(model, CameraConfig):
                self._camera = model
            elif isinstance(model, VehicleConfig):
                self._vehicle = model
            elif isinstance(model, Pad):
                self._pad = model
            elif isinstance(model, CompanionConfig):
                self._obstacles = model.plan.obstacles
        if self._camera is not None and self._vehicle is not None and self._pad is not None:
            self._overlay = camera.CameraAnnotations(self._camera, self._vehicle, self._pad)

    def frame(self, frame: Frame, exposure_unix_ns: int) -> Iterator[WellKnown]:
        self._exposures_ns[frame.sequence] = exposure_unix_ns
        while len(self._exposures_ns) > OPEN_FRAMES:
            self._exposures_ns.popitem(last=False)
        yield camera.image(frame, exposure_unix_ns)

    def message(self, message: Any, unix_ns: int) -> Iterator[WellKnown]:
        """What one of our messages, written at a time, says to Foxglove; mostly nothing."""
        if isinstance(message, VehicleState):
            yield from self._vehicle_state(message, unix_ns)
        elif isinstance(message, PadState):
            yield from self._pad_moved(message, unix_ns)
        elif isinstance(message, PlanStep):
            self._plan = message
        elif isinstance(message, ControlReport):
            yield from self._scene(message, unix_ns)
        elif isinstance(message, PadSighting | FrameReport):
            yield from self._annotations(message)
        elif isinstance(message, GpsFix):
            yield _location(message, unix_ns)
        elif isinstance(message, Notice):
            yield _log(message, unix_ns)

    def _vehicle_state(self, state: VehicleState, unix_ns: int) -> Iterator[WellKnown]:
        self._place = state.position_ned_m
        if _due(self._still_s, unix_ns, STILL_PERIOD_S):
            self._still_s = 1e-9 * unix_ns
            yield from self._what_stands_still(unix_ns)
        yield transform(unix_ns, LOCAL, VEHICLE, state.position_ned_m, state.attitude)
        yield pose_in(unix_ns, "vehicle/pose", LOCAL, state.position_ned_m, state.attitude)

    def _what_stands_still(self, unix_ns: int) -> Iterator[WellKnown]:
        yield transform(unix_ns, MAP, LOCAL, ZERO3, ENU_FROM_NED)
        if self._vehicle is not None:
            mount = self._vehicle.camera_position_body_m
            yield transform(unix_ns, VEHICLE, CAMERA, mount, body_from_camera(self._vehicle))
        if self._camera is not None:
            yield camera.calibration(unix_ns, self._camera)

    def _pad_moved(self, state: PadState, unix_ns: int) -> Iterator[WellKnown]:
        self._pad_state = state
        self._pad_place = add(self._place, state.relative_position_ned_m)
        turn = quat_from_euler(0.0, 0.0, state.heading_rad)
        yield transform(unix_ns, LOCAL, PAD, self._pad_place, turn)
        yield pose_in(unix_ns, "pad/pose", LOCAL, self._pad_place, turn)

    def _scene(self, report: ControlReport, unix_ns: int) -> Iterator[WellKnown]:
        if not _due(self._scene_s, unix_ns, SCENE_PERIOD_S):
            return
        self._scene_s = 1e-9 * unix_ns
        entities = [obstacle_entity(unix_ns, k, shape) for k, shape in enumerate(self._obstacles)]
        origin: Vector3 | None = ZERO3
        if self._plan is not None and self._plan.reference is not None:
            origin = self._pad_place if self._plan.reference.origin == "pad" else ZERO3
        if origin is not None and len(report.predicted_position_m):
            entities.append(path_entity(unix_ns, report, origin))
        if self._pad_place is not None and self._pad_state is not None:
            if self._pad is not None:
                entities.append(pad_entity(unix_ns, self._pad))
            if self._plan is not None:
                touchdown = touchdown_entity(unix_ns, self._pad_place, self._pad_state, self._plan)
                entities += [] if touchdown is None else [touchdown]
        yield WellKnown("scene", "foxglove.SceneUpdate", {"entities": entities})

    def _annotations(self, message: PadSighting | FrameReport) -> Iterator[WellKnown]:
        """For a frame that is logged: its markers, or that there are none."""
        if message.sequence not in self._exposures_ns:
            return
        exposure_ns = self._exposures_ns[message.sequence]
        if isinstance(message, FrameReport):
            if not message.seen:
                yield camera.nothing_seen(exposure_ns)
        elif self._overlay is not None:
            yield self._overlay.annotations(message, exposure_ns)


def _location(fix: GpsFix, unix_ns: int) -> WellKnown:
    """A fix; the accuracies are taken for standard deviations, the horizontal one of the distance."""
    sideways, upward = 0.5 * fix.horizontal_accuracy_m**2, fix.vertical_accuracy_m**2
    message = {
        "timestamp": stamp(unix_ns),
        "frame_id": VEHICLE,
        "latitude": fix.latitude_deg,
        "longitude": fix.longitude_deg,
        "altitude": fix.altitude_m,
        "position_covariance": [sideways, 0.0, 0.0, 0.0, sideways, 0.0, 0.0, 0.0, upward],
        "position_covariance_type": 1,
    }
    return WellKnown("location", "foxglove.LocationFix", message)


def _due(last_s: float, unix_ns: int, period_s: float) -> bool:
    """Whether a period is over: to a millisecond, since a period is a whole number of control cycles."""
    return 1e-9 * unix_ns - last_s >= period_s - 1e-3


def _log(notice: Notice, unix_ns: int) -> WellKnown:
    message = {
        "timestamp": stamp(unix_ns),
        "level": LEVELS[notice.severity],
        "message": notice.text,
        "name": notice.kind,
        "file": "",
        "line": 0,
    }
    return WellKnown("log", "foxglove.Log", message)
