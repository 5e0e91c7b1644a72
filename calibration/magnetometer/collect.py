"""Collecting live samples until the sphere is covered, and showing how far that is."""

from __future__ import annotations

import math
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text
from scipy.spatial.transform import Rotation

from calibration.magnetometer.ellipsoid import (
    CELLS,
    CENTRES,
    BoolArray,
    Ellipsoid,
    NoEllipsoidError,
    algebraic_fit,
    cells_of,
    covered_cells,
)
from calibration.magnetometer.live import LiveCompass
from calibration.magnetometer.recording import MagnetometerRecording, paired
from companion.base.clock import Clock
from companion.base.files import write_atomically
from companion.base.formats.mjpeg import serving
from companion.base.geometry import FloatArray
from companion.config import ConfigError

ENOUGH: Final = 0.88  # of the sphere: then it stops by itself
LEAST_SAMPLES: Final = 500
_LOOK_S: Final = 0.5
_RECENT: Final = 200  # inertial samples: guidance needs the newest alone
_LINE_S: Final = 3.0


async def collect(
    source: LiveCompass,
    console: Console,
    limit_s: float,
    picture: Path | None = None,
    port: int | None = None,
) -> MagnetometerRecording:
    """Collect until the sphere is covered or the time is up; `port` is the browser's (None: none)."""
    clock = Clock()
    start_s = looked_s = clock.now_s()
    reported_s = start_s - _LINE_S
    now = CoverageProgress(0, np.zeros(CELLS, dtype=bool), None, "")
    # a map that is drawn over and over; for what is no terminal a line now and then
    terminal = Live(console=console, auto_refresh=False) if console.is_terminal else nullcontext()
    async with serving(port, console.print) as browser:
        with terminal as screen:
            while clock.now_s() - start_s < limit_s:
                mags, imus = await source.more()
                if clock.now_s() - looked_s < _LOOK_S:
                    continue
                looked_s = clock.now_s()
                now = progress(*paired(mags, imus[-_RECENT:]), source.body_from_sensor)
                enough = now.share >= ENOUGH
                if screen is not None:
                    screen.update(drawn(now, looked_s - start_s), refresh=True)
                elif looked_s - reported_s >= _LINE_S or enough:
                    reported_s = looked_s
                    line = f"{_progress(now, looked_s - start_s)}; next: {now.hint}"
                    console.print(line, highlight=False, markup=False)
                if browser.viewer_count:
                    browser.show(drawn_map(now))
                if enough and now.samples >= LEAST_SAMPLES:
                    break
    if picture is not None and now.samples:
        # samples that took minutes are not given up for a picture
        line = f"coverage in {picture}"
        try:
            write_atomically(picture, cv2.imencode(".png", drawn_map(now))[1].tobytes())
        except ConfigError as error:
            line = str(error)
        console.print(line, highlight=False, markup=False)
    return source.recording()


def drawn(now: CoverageProgress, elapsed_s: float) -> Group:
    """The map, how far it is, and what to do next on lines of its own: it is the instruction."""
    if not now.samples:
        return Group(Text("no samples yet"))
    lines = [*text_map(now.covered), _progress(now, elapsed_s)]
    return Group(*(Text(line) for line in lines), Text(f"next: {now.hint}", style="bold", overflow="fold"))


def _progress(now: CoverageProgress, elapsed_s: float) -> str:
    return f"{elapsed_s:5.0f} s  {now.share:4.0%} covered, {now.samples} samples"


# ---------------------------------------------------------------- guidance
# While the vehicle is turned about: how much of the sphere is covered, what is missing, how to turn there.
#
# Directions are the field's in body axes (FRD), raw fields in µT. A rotation of the vehicle about its own
# axes is given as a person does it: roll, nose up or down, turn.

_MOST_SAMPLES: Final = 3000
_LEAST_SAMPLES: Final = 30
_HOLE_COSINE: Final = math.cos(math.radians(40.0))
_WORTH_TELLING_DEG: Final = 15.0
_WORST_RATIO: Final = 3.0
# a smaller ellipsoid is not the Earth's field turned about, but a sensor's noise where it is held still
_LEAST_FIELD_UT: Final = 15.0
_TURNS: Final = (("roll right", "roll left"), ("nose up", "nose down"), ("turn right", "turn left"))
_FACES: Final = (("nose", "tail"), ("right side", "left side"), ("belly", "top"))


@dataclass(frozen=True, slots=True)
class CoverageProgress:
    """How far it is: `covered` (CELLS,) by cell, the field's direction now (3,), and what to do next."""

    samples: int
    covered: BoolArray
    direction: FloatArray | None
    hint: str

    @property
    def share(self) -> float:
        """Of the sphere, 0 to 1."""
        return float(np.mean(self.covered))


def progress(raw: FloatArray, force: FloatArray | None, body_from_sensor: FloatArray) -> CoverageProgress:
    """Of raw fields (n, 3) and specific forces (n, 3) in the sensor's axes, the newest last."""
    if len(raw) < _LEAST_SAMPLES:
        return CoverageProgress(len(raw), np.zeros(CELLS, dtype=bool), None, "begin to turn it about")
    step = math.ceil(len(raw) / _MOST_SAMPLES)
    sphere = rough_ellipsoid(raw[::step]).apply(np.vstack([raw[::step], raw[-1:]]))
    length = np.linalg.norm(sphere, axis=1)
    # what lies far from the sphere is no direction that was held
    near = np.abs(length - 1.0) < 0.5
    near[-1] = True
    directions = (sphere / np.maximum(length, 1e-9)[:, None]) @ body_from_sensor.T
    covered = covered_cells(directions[near])
    now, down = directions[-1], None
    if force is not None and np.isfinite(force[-1]).all() and np.linalg.norm(force[-1]) > 0.0:
        down = -body_from_sensor @ force[-1] / np.linalg.norm(force[-1])
    return CoverageProgress(len(raw), covered, now, hint(covered, now, down))


def rough_ellipsoid(raw: FloatArray) -> Ellipsoid:
    """An ellipsoid for readings (n, 3) that may be too few for one: then the sphere that they lie in."""
    try:
        ellipsoid = algebraic_fit(raw)
        lengths = np.linalg.eigvalsh(ellipsoid.matrix)
        low, high = raw.min(axis=0), raw.max(axis=0)
        inside = bool(np.all((ellipsoid.centre > low) & (ellipsoid.centre < high)))
        large = 1.0 / lengths[2] >= _LEAST_FIELD_UT
        if inside and large and lengths[2] / lengths[0] < _WORST_RATIO:
            return ellipsoid
    except NoEllipsoidError:
        pass
    low, high = np.percentile(raw, [1.0, 99.0], axis=0)
    radius = max(0.5 * float(np.max(high - low)), _LEAST_FIELD_UT)
    return Ellipsoid(np.eye(3) / radius, 0.5 * (low + high))


def hint(covered: BoolArray, now: FloatArray, down: FloatArray | None) -> str:
    """How to turn the vehicle so that the field comes to where the largest hole is.

    Args:
        covered: mask (CELLS,).
        now: unit vector (3,), the field in body axes.
        down: unit vector (3,), down in body axes; None: not known.
    """
    missing = np.flatnonzero(~covered)
    if not missing.size:
        return "all covered"
    centres = CENTRES[missing]
    holes = np.sum(centres @ centres.T > _HOLE_COSINE, axis=1) + 0.5 * (centres @ now)
    wanted = centres[int(np.argmax(holes))]
    turn = _turn(wanted, now)
    words = [
        f"{_TURNS[axis][0 if angle > 0.0 else 1]} {10 * round(abs(angle) / 10):.0f}°"
        for axis, angle in sorted(enumerate(np.degrees(turn).tolist()), key=lambda each: -abs(each[1]))
        if abs(angle) >= _WORTH_TELLING_DEG
    ]
    if not words:
        return "go on turning about here"
    return ", ".join(words) + ("" if down is None else f", until its {_lowest(turn, down)} is lowest")


def _turn(wanted: FloatArray, now: FloatArray) -> FloatArray:
    """The vehicle's rotation vector (3,), rad, body axes, that takes the field from `now` to `wanted`."""
    axis = np.cross(wanted, now)
    sine, cosine = float(np.linalg.norm(axis)), float(wanted @ now)
    if sine < 1e-6:
        # the other way about: any axis across will do
        axis = np.cross(now, np.eye(3)[int(np.argmin(np.abs(now)))])
    return math.atan2(sine, cosine) * axis / max(float(np.linalg.norm(axis)), 1e-12)


def _lowest(turn: FloatArray, down: FloatArray) -> str:
    """Which face of the vehicle is lowest after the turn."""
    after = Rotation.from_rotvec(turn).apply(down, inverse=True)  # the vehicle turns, down stays
    face = int(np.argmax(np.abs(after)))
    return _FACES[face][0 if after[face] > 0.0 else 1]


# ---------------------------------------------------------------- coverage map
# The covered sphere as a map: characters for a terminal, an image for a file or a browser.
#
# Two discs, equal areas (Lambert's azimuthal projection): left the half of the field's directions that point
# to the vehicle's belly, right those to its top, nose up in both, both as seen from above.

_DISC_PX: Final = 300
_MARGIN_PX: Final = 30
_TEXT_PX: Final = 70
_BACK, _COVERED, _MISSING = (34, 34, 34), (90, 170, 60), (60, 60, 150)
_INK, _NOW = (230, 230, 230), (0, 220, 255)
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_ROWS: Final = 11


def _cells_by_pixel(width: int, height: int, sign: float) -> NDArray[np.int64]:
    """The cell under each place of a disc (height, width), -1 outside; z of the field is of this sign."""
    right = (np.arange(width) + 0.5) / width * 2.0 - 1.0
    forward = 1.0 - (np.arange(height) + 0.5) / height * 2.0
    y, x = np.meshgrid(right, forward)
    square = x * x + y * y
    stretch = np.sqrt(np.maximum(2.0 - square, 0.0))
    directions = np.stack([x * stretch, y * stretch, sign * (1.0 - square)], axis=-1)
    cells: NDArray[np.int64] = cells_of(directions.reshape(-1, 3)).reshape(height, width)
    cells[square > 1.0] = -1
    return cells


def text_map(covered: BoolArray) -> list[str]:
    """Lines of characters: # covered, . missing."""
    discs = [_cells_by_pixel(2 * _ROWS, _ROWS, sign) for sign in (1.0, -1.0)]
    lines = [f"{'to the belly':^{2 * _ROWS}}   {'to the top':^{2 * _ROWS}}"]
    lines += [
        "   ".join(
            "".join(" " if cell < 0 else "#" if covered[cell] else "." for cell in row) for row in rows
        )
        for rows in zip(*discs, strict=True)
    ]
    return lines


def drawn_map(now: CoverageProgress) -> NDArray[np.uint8]:
    """The map as an image, blue, green, red."""
    side = _DISC_PX + 2 * _MARGIN_PX
    image: Any = np.full((side + _TEXT_PX, 2 * side, 3), _BACK, dtype=np.uint8)
    for k, (sign, title) in enumerate(((1.0, "field to the belly"), (-1.0, "field to the top"))):
        cells = _cells_by_pixel(_DISC_PX, _DISC_PX, sign)
        disc = image[_MARGIN_PX : _MARGIN_PX + _DISC_PX, k * side + _MARGIN_PX :][:, :_DISC_PX]
        disc[cells >= 0] = np.where(now.covered[cells[cells >= 0], None], _COVERED, _MISSING)
        _write(image, title, k * side + _MARGIN_PX, 20)
        _write(image, "nose", k * side + side // 2 - 18, _MARGIN_PX + 16)
        if now.direction is not None and sign * now.direction[2] >= 0.0:
            cv2.circle(image, _place(now.direction, k * side), 8, _NOW, 2, cv2.LINE_AA)
    _write(image, f"{now.share:.0%} covered, {now.samples} samples", _MARGIN_PX, side + 15)
    _write(image, now.hint.replace("°", " deg"), _MARGIN_PX, side + 45)
    return np.asarray(image, dtype=np.uint8)


def _place(direction: FloatArray, left: int) -> tuple[int, int]:
    """The pixel of a unit vector on its disc."""
    x, y, z = direction.tolist()
    radius = math.sqrt(max(1.0 - abs(z), 0.0))
    across = max(math.hypot(x, y), 1e-9)
    middle = _MARGIN_PX + 0.5 * _DISC_PX
    half = 0.5 * _DISC_PX * radius / across
    return round(left + middle + half * y), round(middle - half * x)


def _write(image: Any, text: str, x: int, y: int) -> None:
    cv2.putText(image, text, (x, y), _FONT, 0.5, _INK, 1, cv2.LINE_AA)
