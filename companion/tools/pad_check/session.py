"""The check's shell: the app's own sensing into the wizard, and the wizard's words out.

    frames ─► vision ──┐
    mpu9250 ───────────┼─► samples ─► wizard ─► words, picture
    ultrasonic ────────┘
    autopilot ─► armed?  (its own IMU, compass and rangefinder where the settings say so)

Nothing is asked of the autopilot but its telemetry, and nothing goes on while it is armed.
"""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial
from statistics import median
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.app.hardware import Hardware
from companion.app.sensing import Sensing
from companion.base.clock import Clock
from companion.base.formats.mjpeg import MjpegServer
from companion.base.geometry import FloatArray, Vector3, matrix_from_quat
from companion.base.messages import Frame, PadPrior, PadSighting
from companion.config import (
    CameraConfig,
    CompanionConfig,
    ConfigError,
    VehicleConfig,
    find_file,
    load_model,
    load_vehicle,
)
from companion.flightlog.record import FlightLog
from companion.link.codec import Severity
from companion.link.session import Session
from companion.pad import Pad, load_pad
from companion.sense.camera.keeper import KeptCamera
from companion.sense.vision.pipeline import Vision, VisionResult
from companion.tools.pad_check.causes import Mounting
from companion.tools.pad_check.moves import RecentSamples
from companion.tools.pad_check.wizard import Report, Say, Wizard

# ---------------------------------------------------------------- the live picture

ARROW_SHARE: Final = 0.2  # of the distance to the pad
# blue, green, red
_FORWARD, _RIGHT, _PAD, _ASKED, _TEXT = (
    (80, 220, 80),
    (60, 60, 255),
    (255, 180, 0),
    (0, 255, 255),
    (255, 255, 255),
)
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
Colour = tuple[int, int, int]


def draw(
    frame: Frame, sighting: PadSighting | None, vision: Vision, pad: Pad, wizard: Wizard
) -> NDArray[np.uint8]:
    """The frame in colour (h, w, 3) with the pad's outline, the body's axes and the order."""
    image = cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR)
    origin: FloatArray = np.array((0.0, 0.0, 1.0))
    if sighting is not None:
        origin = np.array(sighting.pad_position_body_m)
        outline = vision.pixels(origin + pad.corners_pad_m() @ matrix_from_quat(sighting.body_from_pad).T)
        if np.isfinite(outline).all():
            cv2.polylines(image, [np.rint(outline).astype(np.int32)], True, _PAD, 2)
    length_m = ARROW_SHARE * float(origin[2])
    if wizard.axis is not None and wizard.axis[0] == "shift":
        forward, right, down = (2.0 * length_m * share for share in wizard.axis[1])
        _arrow(image, vision, origin, (forward, right, down), _ASKED, "move")
    _arrow(image, vision, origin, (length_m, 0.0, 0.0), _FORWARD, "forward")
    _arrow(image, vision, origin, (0.0, length_m, 0.0), _RIGHT, "right")
    text = wizard.order.replace("°", " deg")
    cv2.rectangle(image, (0, 0), (image.shape[1], 26), (0, 0, 0), cv2.FILLED)
    cv2.putText(image, text, (6, 18), _FONT, 0.45, _TEXT, 1, cv2.LINE_AA)
    return np.asarray(image, dtype=np.uint8)


def _arrow(image: Any, vision: Vision, origin: FloatArray, along: Vector3, colour: Colour, name: str) -> None:
    """An arrow from a point along a vector, both in body axes, where the lens sees them."""
    ends = vision.pixels(np.array((origin, origin + along)))
    if not np.isfinite(ends).all():
        return
    (x0, y0), (x1, y1) = np.rint(ends).astype(int).tolist()
    cv2.arrowedLine(image, (x0, y0), (x1, y1), colour, 2, cv2.LINE_AA, tipLength=0.2)
    cv2.putText(image, name, (x1 + 4, y1 + 4), _FONT, 0.5, colour, 1, cv2.LINE_AA)


# ---------------------------------------------------------------- a mirror image

UNSEEN_FRAMES: Final = 12  # so many in a row without the pad before its mirror image is looked for
# even: with the mirrored look the search's turns then alternate between far and near there, too
EVERY: Final = 4
ENOUGH: Final = 4


class MirrorWatch:
    """Vision as in flight. A printed code is no code in a mirror: only a flipped frame shows it then."""

    def __init__(self, vision: Vision) -> None:
        self._vision = vision
        self._unseen = self._mirrored = 0
        self.last: tuple[Frame, VisionResult] | None = None

    @property
    def mirrored(self) -> bool:
        """Whether the pad has been found in mirrored frames, several times, and in none as it came."""
        return self._mirrored >= ENOUGH

    def step(self, frame: Frame, prior: PadPrior | None) -> VisionResult:
        """Look at a frame; see `Vision.step`."""
        seen = self._vision.step(frame, prior)
        self.last = (frame, seen)
        if seen.sighting is not None:
            self._unseen = self._mirrored = 0
            return seen
        self._unseen += 1
        if self._unseen > UNSEEN_FRAMES and self._unseen % EVERY == 0:
            flipped = replace(frame, image=np.ascontiguousarray(frame.image[:, ::-1]))
            self._mirrored += self._vision.step(flipped, None).sighting is not None
        return seen


# ---------------------------------------------------------------- the check's shell

STEP_PERIOD_S: Final = 0.1
LINK_PERIOD_S: Final = 0.05
LINK_PATIENCE_S: Final = 10.0
PICTURE_PERIOD_S: Final = 0.1
CAMERA_LOOK_S: Final = 2.0  # over which its rate is counted
ARMED: Final = "the autopilot says armed; expected a disarmed vehicle, best with its propellers off"


class PadCheck:
    """One check over the pad. Make it inside the running loop."""

    def __init__(
        self,
        config: CompanionConfig,
        hardware: Hardware,
        say: Callable[[Say], None],
        *,
        page: MjpegServer | None = None,
        linked: bool = True,
        samples: RecentSamples | None = None,
    ) -> None:
        """Wire it.

        `say` and `page` are where the check shows itself. `linked`: an autopilot is there and has to be
        disarmed. `samples`: where they are kept.
        """
        self._config, self._say, self._page, self._linked = config, say, page, linked
        self._clock = Clock()
        vehicle = load_vehicle(config.vehicle, config.mount, config.camera)
        camera = load_model(CameraConfig, find_file("cameras", config.camera))
        self._pad = load_pad(config.pad)
        self._vision = Vision(self._pad, camera, vehicle, config.sense.vision)
        self._mirror = MirrorWatch(self._vision)
        self._samples = RecentSamples() if samples is None else samples
        by_telemetry = config.sense.source == "autopilot"
        self._session = Session(config.link, config.sense if by_telemetry else None, signing=hardware.signing)
        self._transport, self._frames = hardware.transport, hardware.frames
        # where it is on earth is not asked here
        self._sensing = Sensing(
            config,
            replace(hardware, gps_port=None),
            self._mirror,
            self._samples,
            self._session.onboard,
            clock=self._clock,
            log=FlightLog(None, start_unix_s=0.0),
            notify=self._tell,
            frame_time_offset_s=vehicle.camera_time_offset_s,
        )
        self._mounting = _mounting(config, vehicle)
        self._wizard: Wizard | None = None
        self._heard_s = self._clock.now_s()

    async def run(self) -> Report:
        """Check; ends by itself, after at most a minute a step."""
        works = {**self._sensing.tasks(), "camera's figures": self._camera_task}
        if self._page is not None:
            works["picture"] = partial(self._picture_task, self._page)
        if self._linked:
            works |= {"autopilot link": self._receive_task, "heartbeat": self._link_task}
        try:
            async with asyncio.TaskGroup() as group:
                workers = [
                    group.create_task(self._guard(name, work), name=name) for name, work in works.items()
                ]
                report = await group.create_task(self._ask(), name="wizard")
                for worker in workers:
                    worker.cancel()
        except ExceptionGroup as failures:
            mendable, _ = failures.split(ConfigError)
            raise (failures if mendable is None else mendable.exceptions[0]) from None
        return report

    async def _ask(self) -> Report:
        if self._linked:
            await self._await_autopilot()
        self._heard_s = self._clock.now_s()
        wizard = self._wizard = Wizard(self._mounting, self._clock.now_s())
        while not wizard.finished:
            self._refuse_armed()
            for said in wizard.step(self._samples, self._clock.now_s(), mirrored=self._mirror.mirrored):
                self._say(said)
            await asyncio.sleep(STEP_PERIOD_S)
        return wizard.report()

    # ------------------------------------------------------------ the autopilot

    async def _await_autopilot(self) -> None:
        until_s = self._clock.now_s() + LINK_PATIENCE_S
        while not self._session.state.connected:
            if self._clock.now_s() > until_s:
                raise ConfigError(
                    f"link.connection {self._config.link.connection}: no autopilot heard within "
                    f"{LINK_PATIENCE_S:g} s; expected its heartbeat, or --no-link"
                )
            await asyncio.sleep(STEP_PERIOD_S)

    def _refuse_armed(self) -> None:
        """Nobody is led about an armed vehicle, nor about one of which that is not known any more."""
        state, now_s = self._session.state, self._clock.now_s()
        if state.connected and state.armed:
            raise ConfigError(ARMED)
        if state.connected or not self._linked:
            self._heard_s = now_s
        elif now_s - self._heard_s > LINK_PATIENCE_S:
            raise ConfigError(
                f"link.connection {self._config.link.connection}: the autopilot has fallen silent for "
                f"{LINK_PATIENCE_S:g} s; expected its heartbeat, or --no-link"
            )

    async def _receive_task(self) -> None:
        while True:
            data = await self._transport.read()
            self._session.receive(data, self._clock.now_s())
            self._sensing.take_samples(self._session.take_samples())

    async def _link_task(self) -> None:
        """Heartbeats, and requests for the telemetry that the settings want."""
        while True:
            if due := self._session.tick(self._clock.now_s()):
                self._transport.write(due)
            await asyncio.sleep(LINK_PERIOD_S)

    # ------------------------------------------------------------ people

    async def _camera_task(self) -> None:
        """Say once how the camera does: its rate, its frames' age on arrival, what its driver says."""
        while self._sensing.last_frame is None:  # noqa: ASYNC110 - it has no event
            await asyncio.sleep(STEP_PERIOD_S)
        before, ages_s = self._sensing.frame_count, list[float]()
        until_s = self._clock.now_s() + CAMERA_LOOK_S
        while self._clock.now_s() < until_s:
            await asyncio.sleep(STEP_PERIOD_S)
            ages_s.append(self._sensing.last_frame.received_s - self._sensing.last_frame.time_s)
        rate_hz = (self._sensing.frame_count - before) / CAMERA_LOOK_S
        detail = f"camera: {rate_hz:.1f} frames/s looked at, {1e3 * median(ages_s):.0f} ms old on arrival"
        if isinstance(self._frames, KeptCamera):
            detail += f"; the driver says: {self._frames.read_back}"
        self._say(Say(detail))

    async def _picture_task(self, page: MjpegServer) -> None:
        while True:
            await asyncio.sleep(PICTURE_PERIOD_S)
            if page.viewer_count and self._mirror.last is not None and self._wizard is not None:
                frame, seen = self._mirror.last
                page.show(draw(frame, seen.sighting, self._vision, self._pad, self._wizard))

    async def _guard(self, name: str, work: Callable[[], Awaitable[None]]) -> None:
        """A device that is gone is reported; the wizard says what it lacks."""
        try:
            await work()
        except OSError as error:
            self._tell("device_lost", f"{name} lost: {error}", "error")

    def _tell(self, kind: str, text: str, severity: Severity) -> None:
        self._say(Say(text, "note" if severity == "info" else "bad"))


def _mounting(config: CompanionConfig, vehicle: VehicleConfig) -> Mounting:
    boards = config.sense.source == "boards"
    return Mounting(
        vehicle=config.vehicle,
        camera=config.camera,
        pad=config.pad,
        camera_yaw_deg=vehicle.camera_yaw_deg,
        camera_tilt_deg=vehicle.camera_tilt_deg,
        body_from_sensor_deg=config.sense.imu.body_from_sensor_deg if boards else None,
        range_position_body_m=vehicle.range_position_body_m,
        field_ned_ut=config.estimate.magnetic_field_ned_ut,
    )
