"""A camera of the kernel's (V4L2) through OpenCV: USB cameras, and whatever else has a /dev/videoN.

Its time stamps. OpenCV's CAP_PROP_POS_MSEC is the buffer's time stamp, of CLOCK_MONOTONIC with every driver
in use (V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC). Which moment it is, is the driver's: by the V4L2 manual the end of
the frame unless the buffer's flags say start of exposure, and these flags OpenCV keeps to itself. Only one
driver in use sets that one, uvcvideo; but the time it takes is that of the frame's first USB packet, and that
leaves when the first row has been exposed and is read out. So for uvcvideo: start of readout; for others: end
of readout; `stamped_at` in the camera's file overrules. A USB camera holds a frame back while it compresses
it, by some ms that no stamp knows: `calibrate-mount camera` measures them (`camera_time_offset_s`).
Sources: the kernel's documentation of struct v4l2_buffer and of its flags; its uvc_video.c,
uvc_video_decode_start; OpenCV's cap_v4l.cpp, getProperty.
"""

import os
import re
from collections import deque
from pathlib import Path
from typing import Any, Final, Protocol

import cv2

from companion.base.clock import Clock
from companion.base.errors import DeviceMissing
from companion.config import CaptureConfig
from companion.sense.camera.health import StampPoint, StampReader
from companion.sense.camera.reader import ReadBack, Shot, check_size, grey

MANUAL_EXPOSURE: Final = 1  # V4L2_EXPOSURE_MANUAL
EXPOSURE_UNIT_S: Final = 1e-4  # of V4L2_CID_EXPOSURE_ABSOLUTE
UNSUPPORTED: Final = -1.0  # what OpenCV answers for a control that a driver has not got
SETTLED: Final = 0.1  # a driver may round what it is set to by this share
# so many frames in a row that cannot be had: one may be a damaged JPEG
MOST_FAILURES: Final = 3
DEVICE: Final = re.compile(r"/dev/video(?P<number>\d{1,4})")
DRIVERS: Final = Path("/sys/class/video4linux")
# how long OpenCV waits for a frame, in whole seconds; so long a stalled camera stays taken: by itself 10 s
WAIT_VARIABLE: Final = "OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT"
WAIT_S: Final = "1"
# a read that fails after so long has waited in vain: another would hold the camera longer
STALLED_S: Final = 0.9


class Capture(Protocol):
    """What is used of cv2.VideoCapture."""

    def isOpened(self) -> bool: ...  # noqa: N802 - OpenCV's name
    def read(self) -> tuple[bool, Any]: ...
    def get(self, propId: int) -> float: ...
    def set(self, propId: int, value: float) -> bool: ...
    def release(self) -> None: ...


class V4l2Device:
    """A `reader.Device`: short fixed exposure, so that light changes gain and never blur."""

    def __init__(self, number: int, camera: CaptureConfig, clock: Clock) -> None:
        """Open /dev/videoN and set it up.

        Raises:
            ConfigError: no such camera, or it cannot make images of the size asked for.
        """
        self._camera, self._clock = camera, clock
        os.environ.setdefault(WAIT_VARIABLE, WAIT_S)
        self._capture: Capture = cv2.VideoCapture(number, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise DeviceMissing(
                f"sense.vision.source: v4l2:{number}: no camera at /dev/video{number}; "
                "expected one that is connected and free"
            )
        self.notes: deque[str] = deque()
        self._stamps = StampReader()
        self._point = stamp_point(camera, driver_name(number))
        try:
            self._choose_format()
            self.read_back = self._choose_exposure()
        except BaseException:
            self._capture.release()
            raise

    def read(self) -> Shot:
        image = self._grab()
        received_s = self._clock.now_s()
        check_size(image.shape[1], image.shape[0], self._camera)  # a driver may promise one and send another
        time_s = self._stamps.exposed_s(
            self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3,
            received_s,
            self._point,
            self.read_back.exposure_s or self._camera.exposure_s,
            self._camera.readout_s,
        )
        if (complaint := self._stamps.complaint) is not None:
            self.notes.append(complaint)
        return Shot(time_s, received_s, grey(image))

    def close(self) -> None:
        self._capture.release()

    def _grab(self) -> Any:
        until_s = self._clock.now_s() + STALLED_S
        for _ in range(MOST_FAILURES):
            good, image = self._capture.read()
            if good and image is not None:
                return image
            if self._clock.now_s() > until_s:
                break
        raise OSError("the driver gives no frames any more: unplugged, or it hangs")

    # ------------------------------------------------------------ setting up

    def _choose_format(self) -> None:
        capture, camera = self._capture, self._camera
        if camera.pixel_format is not None:
            # before the size: which sizes there are depends on it
            wanted = cv2.VideoWriter.fourcc(*camera.pixel_format)
            capture.set(cv2.CAP_PROP_FOURCC, wanted)
            if round(capture.get(cv2.CAP_PROP_FOURCC)) != wanted:
                self.notes.append(f"the driver did not take pixel_format {camera.pixel_format}")
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, camera.width_px)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, camera.height_px)
        capture.set(cv2.CAP_PROP_FPS, camera.rate_hz)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 2)
        width = round(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = round(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        check_size(width, height, camera)
        rate_hz = capture.get(cv2.CAP_PROP_FPS)
        if rate_hz > 0.0 and _differs(rate_hz, camera.rate_hz):
            self.notes.append(f"{camera.rate_hz:g} frames/s asked for, the driver says {rate_hz:.3g}")

    def _choose_exposure(self) -> ReadBack:
        """Fix exposure, white balance, focus and, where wanted, gain; what was not taken is noted."""
        camera = self._camera
        if self._set(cv2.CAP_PROP_AUTO_EXPOSURE, MANUAL_EXPOSURE) != MANUAL_EXPOSURE:
            self.notes.append("the driver did not switch its automatic exposure off: images may blur")
        units = max(1, round(camera.exposure_s / EXPOSURE_UNIT_S))
        got = self._set(cv2.CAP_PROP_EXPOSURE, units)
        exposure_s = None if got <= 0.0 else got * EXPOSURE_UNIT_S
        if exposure_s is None:
            self.notes.append("the driver does not say its exposure: it may be another than exposure_s")
        elif _differs(exposure_s, units * EXPOSURE_UNIT_S):
            self.notes.append(
                f"exposure of {1e3 * camera.exposure_s:.1f} ms asked for, the driver says "
                f"{1e3 * exposure_s:.1f} ms"
            )
        if self._set(cv2.CAP_PROP_AUTO_WB, 0) > 0.0:
            self.notes.append("the driver did not switch its automatic white balance off")
        gain = self._fix("gain", cv2.CAP_PROP_GAIN, camera.gain)
        self._set(cv2.CAP_PROP_AUTOFOCUS, 0)
        self._fix("focus", cv2.CAP_PROP_FOCUS, camera.focus)
        return ReadBack(exposure_s, gain)

    def _fix(self, name: str, control: int, wanted: float | None) -> float | None:
        """Set a control where a value is wanted; what it is then, None when the driver has not got it."""
        got = self._capture.get(control) if wanted is None else self._set(control, wanted)
        if wanted is not None and (got == UNSUPPORTED or _differs(got, wanted)):
            says = "has none" if got == UNSUPPORTED else f"says {got:g}"
            self.notes.append(f"{name} {wanted:g} asked for, the driver {says}")
        return None if got == UNSUPPORTED else got

    def _set(self, control: int, value: float) -> float:
        """Set a control; what the driver says it is then, `UNSUPPORTED` where it has none."""
        self._capture.set(control, value)
        return self._capture.get(control)


def stamp_point(camera: CaptureConfig, driver: str) -> StampPoint:
    """The moment that a driver stamps, unless the camera's file says otherwise (see above)."""
    if camera.stamped_at != "auto":
        return camera.stamped_at
    return "start_of_readout" if driver == "uvcvideo" else "end_of_readout"


def device_number(name: str) -> int:
    """N of /dev/videoN, by number or by a path: udev's links in /dev/v4l/by-id stay when N changes.

    Raises:
        DeviceMissing: no video device is there.
    """
    if name.isdecimal():
        return int(name)
    form = DEVICE.fullmatch(os.path.realpath(name))
    if form is None:
        raise DeviceMissing(
            f"sense.vision.source: v4l2:{name}: no camera there; expected one that is connected, "
            "by a path as ls /dev/v4l/by-id shows"
        )
    return int(form["number"])


def driver_name(number: int) -> str:
    """The kernel's driver of /dev/videoN; empty when it does not say."""
    return (DRIVERS / f"video{number}" / "device" / "driver").resolve().name


def _differs(got: float, wanted: float) -> bool:
    return abs(got - wanted) > SETTLED * max(abs(wanted), 1.0e-9)
