"""A recorded landing as a moving picture: what the camera saw, beside the view from the side, in real time.

Drawn from a flight's log alone: `/camera` with `/camera/annotations` (five a second), `/truth` and `/plan`.
NED, metres; the side view looks north, so east is to the right.
"""

from __future__ import annotations

import base64
import json
import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from mcap.reader import make_reader
from numpy.typing import NDArray
from PIL import Image

from companion.base.geometry import quat_rotate
from companion.config import ConfigError

TOPICS: Final = ("/camera", "/camera/annotations", "/truth", "/plan")
SHOWN_PHASES: Final = ("approach", "descend", "touchdown", "landed")
FRAME_S: Final = 0.1
AFTER_CONTACT_S: Final = 1.5
CAMERA_PX: Final = (320, 240)
SIDE_PX: Final = (440, 240)
WORDS_PX: Final = 24
SUPERSAMPLED: Final = 2  # drawn larger, then reduced: even lines
GREY_STEP: Final = 16  # fewer greys, a smaller file
SHADES: Final = 4  # of each colour towards the paper, for even lines
GROUND_UP_PX: Final = 26
ROOM_M: Final = 0.8  # above and beside all that moves
PAD_HALF_M: Final = 0.65
ARM_M: Final = 0.4  # larger than it is, to be seen
FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
PHASE_COLOURS_BGR: Final = {
    "approach": (196, 113, 36),
    "descend": (152, 60, 125),
    "touchdown": (43, 57, 192),
    "landed": (43, 57, 192),
}
PAD_BGR: Final = (96, 174, 39)
DARK_BGR: Final = (60, 50, 44)
FAINT_BGR: Final = (220, 216, 213)
MARKER_BGR: Final = (0, 140, 255)

Colour = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class CameraShot:
    """A camera image in colour, with the used markers outlined, and when (s, UTC) it was exposed."""

    time_s: float
    picture: Colour


@dataclass(frozen=True, slots=True)
class RecordedLanding:
    """What is drawn: `times_s` (n,), tracks in east and up (n, 2), tilt to the east (n,), all by truth."""

    shots: list[CameraShot]
    times_s: NDArray[np.float64]
    vehicle: NDArray[np.float64]
    pad: NDArray[np.float64]
    lateral_m: NDArray[np.float64]
    tilt_rad: NDArray[np.float64]
    contact: NDArray[np.bool_]
    phases: list[str]


def draw_landing_gif(log: Path, picture: Path) -> None:
    """The landing from the approach to the standstill on the pad.

    Raises:
        ConfigError: the log holds no landing with pictures and truth.
    """
    recorded = read_landing(log)
    frames = [draw_frame(recorded, float(t)) for t in np.arange(*_shown_s(recorded), FRAME_S)]
    rgb = [Image.fromarray(frame[:, :, ::-1]) for frame in frames]
    indexed = [image.quantize(palette=_palette(), dither=Image.Dither.NONE) for image in rgb]
    indexed[0].save(
        picture,
        save_all=True,
        append_images=indexed[1:],
        duration=[round(1000 * FRAME_S)] * (len(indexed) - 1) + [2000],
        loop=0,
        optimize=True,
    )


def _palette() -> Image.Image:
    """The camera's greys, and each colour of the drawing in shades towards the paper and the ground."""
    drawn = {*PHASE_COLOURS_BGR.values(), PAD_BGR, DARK_BGR, MARKER_BGR, FAINT_BGR}
    shares = np.linspace(1.0, 1.0 / SHADES, SHADES)[:, None]
    greys = np.repeat(np.arange(0, 256, GREY_STEP), 3).reshape(-1, 3)
    shades = [shares * np.array(colour) + (1.0 - shares) * 255.0 for colour in sorted(drawn)]
    colours_bgr = np.vstack((greys, *shades, [[255, 255, 255]])).astype(np.uint8)
    palette = Image.new("P", (1, 1))
    palette.putpalette(colours_bgr[:, ::-1].tobytes())
    return palette


# ---------------------------------------------------------------- the log


def read_landing(log: Path) -> RecordedLanding:
    """Read the log.

    Raises:
        ConfigError: as of `draw_landing_gif`.
    """
    messages: dict[str, list[dict[str, Any]]] = {topic: [] for topic in TOPICS}
    with log.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(TOPICS):
            messages[channel.topic].append(json.loads(message.data))
            messages[channel.topic][-1]["logged_s"] = 1e-9 * message.log_time
    truth, plan = messages["/truth"], messages["/plan"]
    phases = [step["phase"] for step in plan]
    if not truth or not messages["/camera"] or "landed" not in phases:
        raise ConfigError(f"{log}: holds no landing in the simulator; expected /truth, /camera and a landing")
    starts_s = [step["time_s"] for step in plan]
    times_s = np.array([t["time_s"] for t in truth])
    at = np.maximum(0, np.searchsorted(starts_s, times_s, side="right") - 1)
    away = np.array([np.subtract(t["vehicle_position_ned_m"], t["pad_position_ned_m"])[:2] for t in truth])
    # the app's clock over UTC: a plan is written in the cycle that made it
    offset_s = min(step["logged_s"] - step["time_s"] for step in plan)
    return RecordedLanding(
        shots=_shots(messages["/camera"], messages["/camera/annotations"], offset_s),
        times_s=times_s,
        vehicle=_east_up([t["vehicle_position_ned_m"] for t in truth]),
        pad=_east_up([t["pad_position_ned_m"] for t in truth]),
        lateral_m=np.hypot(away[:, 0], away[:, 1]),
        tilt_rad=np.array([_tilt(t["vehicle_attitude"]) for t in truth]),
        contact=np.array([t["in_contact"] for t in truth]),
        phases=[phases[k] for k in at],
    )


def _east_up(positions_ned_m: list[list[float]]) -> NDArray[np.float64]:
    ned = np.array(positions_ned_m)
    return np.column_stack((ned[:, 1], -ned[:, 2]))


def _tilt(attitude: list[float]) -> float:
    """How far (rad) the vehicle tilts to the right in the side view: its own down against the world's."""
    w, x, y, z = attitude
    _, east, down = quat_rotate((w, x, y, z), (0.0, 0.0, 1.0))
    return math.atan2(-east, down)


def _shots(
    images: list[dict[str, Any]], annotations: list[dict[str, Any]], offset_s: float
) -> list[CameraShot]:
    drawn_in = {_stamp(points): shown for shown in annotations for points in shown["points"][:1]}
    return [
        CameraShot(_stamp(image) - offset_s, _camera_picture(image, drawn_in.get(_stamp(image))))
        for image in images
    ]


def _stamp(message: dict[str, Any]) -> float:
    return float(message["timestamp"]["sec"] + 1e-9 * message["timestamp"]["nsec"])


def _camera_picture(image: dict[str, Any], annotation: dict[str, Any] | None) -> Colour:
    encoded = np.frombuffer(base64.b64decode(image["data"]), np.uint8)
    grey = cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE)
    assert grey is not None
    scale = CAMERA_PX[0] / grey.shape[1]
    small = cv2.resize(grey, CAMERA_PX, interpolation=cv2.INTER_AREA)
    small = (cv2.medianBlur(small, 3) // GREY_STEP * GREY_STEP).astype(np.uint8)
    picture = np.asarray(cv2.cvtColor(small, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    for shape in [] if annotation is None else annotation["points"]:
        corners = np.array([[point["x"], point["y"]] for point in shape["points"]])
        outline = np.round(16 * scale * corners).astype(np.int32)
        cv2.polylines(picture, [outline], True, MARKER_BGR, 2, cv2.LINE_AA, shift=4)
    return picture


def _shown_s(recorded: RecordedLanding) -> tuple[float, float]:
    """From the last approach that came to the ground until a moment after the contact (s)."""
    shown = np.array([phase in SHOWN_PHASES for phase in recorded.phases])
    before = np.flatnonzero(~shown)
    contact = int(np.flatnonzero(recorded.contact & shown)[0])
    first = int(before[before < contact][-1]) + 1
    return float(recorded.times_s[first]), float(recorded.times_s[contact]) + AFTER_CONTACT_S


# ---------------------------------------------------------------- the picture


def draw_frame(recorded: RecordedLanding, time_s: float) -> Colour:
    """The camera's picture, the side view and a line of words under them, at one moment."""
    now = int(np.searchsorted(recorded.times_s, time_s).clip(0, len(recorded.times_s) - 1))
    seen = [shot for shot in recorded.shots if shot.time_s <= time_s] or recorded.shots[:1]
    views = np.hstack((seen[-1].picture, _side_view(recorded, now, _shown_s(recorded)[0])))
    words = np.full((WORDS_PX, views.shape[1], 3), 255, np.uint8)
    over = recorded.vehicle[:, 1] - recorded.pad[:, 1]
    height_m = max(0.0, over[now] - over[-1])  # of the feet: at the end it stands
    text = (
        f"{recorded.phases[now]:10} {height_m:4.1f} m over the pad, "
        f"{100.0 * recorded.lateral_m[now]:3.0f} cm from its centre"
    )
    cv2.putText(words, "camera", (8, 16), FONT, 0.45, DARK_BGR, 1, cv2.LINE_AA)
    cv2.putText(words, text, (CAMERA_PX[0] + 8, 16), FONT, 0.45, DARK_BGR, 1, cv2.LINE_AA)
    return np.asarray(np.vstack((views, words)), dtype=np.uint8)


def _side_view(recorded: RecordedLanding, now: int, since_s: float) -> Colour:
    """Ground, pad, the way so far by phase, and the vehicle with its tilt; looking north."""
    width, height = (SUPERSAMPLED * side for side in SIDE_PX)
    canvas = np.full((height, width, 3), 255, np.uint8)
    ground_y = height - SUPERSAMPLED * GROUND_UP_PX
    first = int(np.searchsorted(recorded.times_s, since_s))
    moved = np.vstack((recorded.vehicle[first:], recorded.pad[first:]))
    west, east = moved[:, 0].min(), moved[:, 0].max()
    scale = min(width / (east - west + 2.0 * ROOM_M), ground_y / (moved[:, 1].max() + ROOM_M))

    def at(point: NDArray[np.float64]) -> NDArray[np.int32]:
        x = 0.5 * width + scale * (point[..., 0] - 0.5 * (west + east))
        y = ground_y - scale * point[..., 1]
        return np.round(np.stack((x, y), axis=-1)).astype(np.int32)

    cv2.rectangle(canvas, (0, ground_y), (width, height), FAINT_BGR, cv2.FILLED)
    way = at(recorded.vehicle[first : now + 1])
    for (a, b), phase in zip(pairwise(way), recorded.phases[first:now], strict=True):
        cv2.line(canvas, a.tolist(), b.tolist(), PHASE_COLOURS_BGR[phase], 4, cv2.LINE_AA)
    pad = recorded.pad[now]
    left, right = (at(pad + np.array([side * PAD_HALF_M, 0.0])) for side in (-1, 1))
    cv2.rectangle(canvas, left.tolist(), [int(right[0]), ground_y + 6], PAD_BGR, cv2.FILLED)
    _draw_vehicle(canvas, at, recorded.vehicle[now], float(recorded.tilt_rad[now]))
    small = cv2.resize(canvas, SIDE_PX, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8)


def _draw_vehicle(canvas: Colour, at: Any, place: NDArray[np.float64], tilt_rad: float) -> None:
    """Arms, two rotors and legs."""
    along = np.array([math.cos(tilt_rad), -math.sin(tilt_rad)])
    up = np.array([math.sin(tilt_rad), math.cos(tilt_rad)])

    def line(a: NDArray[np.float64], b: NDArray[np.float64], thickness: int) -> None:
        cv2.line(canvas, at(a).tolist(), at(b).tolist(), DARK_BGR, thickness, cv2.LINE_AA)

    line(place - ARM_M * along, place + ARM_M * along, 6)
    for side in (-1.0, 1.0):
        hub = place + side * ARM_M * along + 0.1 * up
        line(hub - 0.22 * along, hub + 0.22 * along, 3)
        line(place + 0.5 * side * ARM_M * along, place + 0.7 * side * ARM_M * along - 0.2 * up, 4)
