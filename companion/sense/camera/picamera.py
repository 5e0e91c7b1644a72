"""The Raspberry Pi's own cameras, through libcamera and picamera2, which are asked for only when chosen.

Its time stamps. The metadata's SensorTimestamp (ns) is, by libcamera's words, when the first row is exposed,
on CLOCK_BOOTTIME. On a Raspberry Pi it is the CSI receiver's interrupt at the start of a frame's transfer:
the first row is read out then, and its exposure has just ended (a maintainer in picamera2's issue 821: later
than the start of the exposure, by the exposure). And the kernel takes it from CLOCK_MONOTONIC (libcamera's
bug 254, by camera_ros' pull request 127); the two clocks differ only by the time for which the machine has
been suspended, and whichever fits the arrival is taken. Mid-exposure of the middle row is then
SensorTimestamp + readout / 2 - ExposureTime / 2, with ExposureTime (µs) from the same frame's metadata.

Exposure and gain are given as values; libcamera leaves its automatic alone then, and AeEnable is not touched
(picamera2's issue 933: switched off together with the values, it holds on to older ones). A gain that is not
given stays automatic while the exposure stays fixed. Fixed ColourGains end the automatic white balance.

A video's colour spaces have black at 16 and white at 235 (limited range), which picamera2 takes for video
unless it is told. Vision decodes grey values of 0 to 255, and tells by them that white is cut off: so
libcamera's sYCC, of full range.
"""

import importlib
from collections import deque
from typing import Any, Final

import numpy as np

from companion.base.clock import Clock, boot_clock_ahead_s
from companion.base.errors import DeviceMissing
from companion.config import CaptureConfig, ConfigError
from companion.sense.camera.health import StampPoint, StampReader
from companion.sense.camera.reader import ReadBack, Shot, check_size

BUFFERS: Final = 4
WAIT_S: Final = 2.0  # for a frame; picamera2 by itself waits for ever, and a stalled camera stays taken
# controls hold a few frames after they were given; then it is looked whether they were taken
SETTLED_FRAMES: Final = 15
TOLERANCE: Final = 0.1  # a sensor's lines and gain steps round by less
MANUAL_FOCUS: Final = 0  # libcamera's AfModeManual
NEUTRAL: Final = (1.0, 1.0)
INSTALL: Final = (
    "expected 'sudo apt install python3-picamera2' and a virtual environment made with "
    "--system-site-packages (docs/how-to/cameras.md)"
)


class Picamera2Device:
    """A `reader.Device`."""

    def __init__(self, number: int, camera: CaptureConfig, clock: Clock) -> None:
        """Open libcamera's camera of that number and start it.

        Raises:
            ConfigError: picamera2 is not installed, or there is no such camera.
        """
        source = f"sense.vision.source: picamera2:{number}"
        make, self._full_range = _picamera2(source)
        self._config, self._clock = camera, clock
        self._stamps = StampReader(boot_clock_ahead_s())
        self._point: StampPoint = "start_of_readout" if camera.stamped_at == "auto" else camera.stamped_at
        self._frames = 0
        self.notes: deque[str] = deque()
        self.read_back = ReadBack()
        try:
            self._camera = make(number)
        except (RuntimeError, IndexError) as error:
            raise DeviceMissing(
                f"{source}: {error}; expected a camera that is free and that "
                "'rpicam-hello --list-cameras' shows"
            ) from error
        try:
            self._start()
        except BaseException:
            self._camera.close()
            raise

    def read(self) -> Shot:
        request = self._request()
        received_s = self._clock.now_s()
        try:
            planes = np.asarray(request.make_array("main"), dtype=np.uint8)
            metadata = request.get_metadata()
        finally:
            request.release()
        width, height = self._config.width_px, self._config.height_px
        # YUV420: the grey plane first, then half as many rows again of colour; rows may be padded
        if planes.ndim != 2 or planes.shape[0] != height * 3 // 2 or planes.shape[1] < width:
            check_size(planes.shape[1], planes.shape[0] * 2 // 3, self._config)
        self._take_metadata(metadata)
        image = np.ascontiguousarray(planes[:height, :width])
        return Shot(self._time_s(metadata, received_s), received_s, image)

    def close(self) -> None:
        try:
            self._camera.stop()
        finally:  # one that is gone may not let itself be stopped, but stays taken until it is closed
            self._camera.close()

    def _request(self) -> Any:
        """The next frame.

        Raises:
            OSError: it stalls; it may be closed then.
        """
        try:
            return self._camera.capture_request(wait=WAIT_S)
        except TimeoutError as error:
            # in picamera2's queue the stop would stand behind what never comes
            self._camera.cancel_all_and_flush()
            raise OSError(f"libcamera gives no frame in {WAIT_S:g} s: a loose cable, or it hangs") from error

    def _start(self) -> None:
        config, mode = self._config, self._config.sensor_mode_px
        size = (config.width_px, config.height_px)
        video = self._camera.create_video_configuration(
            main={"size": size, "format": "YUV420"},
            colour_space=self._full_range,
            controls=self._controls(),
            buffer_count=BUFFERS,
            **({} if mode is None else {"sensor": {"output_size": mode}}),
        )
        self._camera.configure(video)
        made = self._camera.camera_configuration()
        width, height = made["main"]["size"]
        check_size(width, height, config)  # libcamera takes the nearest that it can make
        if mode is not None:
            got = (made.get("sensor") or {}).get("output_size", mode)
            if tuple(got) != mode:
                wanted = f"sensor mode {mode[0]}x{mode[1]}"
                self.notes.append(f"{wanted} asked for, libcamera took {got[0]}x{got[1]}")
        self._camera.start()

    def _controls(self) -> dict[str, Any]:
        """What is fixed; a control that this camera has not got is left out."""
        config, has = self._config, self._camera.camera_controls
        period_us = round(1e6 / config.rate_hz)
        wanted: dict[str, Any] = {
            "FrameDurationLimits": (period_us, period_us),
            "ExposureTime": round(1e6 * config.exposure_s),
        }
        if config.gain is not None:
            wanted["AnalogueGain"] = config.gain
        if "ColourGains" in has:
            wanted["ColourGains"] = NEUTRAL
        if "AfMode" in has:
            wanted["AfMode"] = MANUAL_FOCUS
            if config.focus is not None:
                wanted["LensPosition"] = config.focus
        elif config.focus is not None:
            self.notes.append(f"focus {config.focus:g} asked for, its lens does not move")
        return wanted

    def _time_s(self, metadata: dict[str, Any], received_s: float) -> float:
        """Mid-exposure of the middle row (see above)."""
        time_s = self._stamps.exposed_s(
            1e-9 * metadata.get("SensorTimestamp", 0),
            received_s,
            self._point,
            self.read_back.exposure_s or self._config.exposure_s,
            self._config.readout_s,
        )
        if (complaint := self._stamps.complaint) is not None:
            self.notes.append(complaint)
        return time_s

    def _take_metadata(self, metadata: dict[str, Any]) -> None:
        """What this frame was exposed with; once, whether that is what was asked for."""
        exposure_us, gain = metadata.get("ExposureTime"), metadata.get("AnalogueGain")
        exposure_s = None if not exposure_us else 1e-6 * exposure_us
        self.read_back = ReadBack(exposure_s, None if gain is None else float(gain))
        self._frames += 1
        if self._frames != SETTLED_FRAMES:
            return
        wanted_s, wanted = self._config.exposure_s, self._config.gain
        if exposure_s is not None and abs(exposure_s - wanted_s) > TOLERANCE * wanted_s:
            self.notes.append(
                f"exposure of {1e3 * wanted_s:.1f} ms asked for, libcamera says {1e3 * exposure_s:.1f} ms"
            )
        if wanted is not None and gain is not None and abs(gain - wanted) > TOLERANCE * max(wanted, 1.0):
            self.notes.append(f"gain {wanted:g} asked for, libcamera says {gain:.3g}")


def _picamera2(source: str) -> tuple[Any, Any]:
    """The class of that name, and the colour space of full range.

    Raises:
        ConfigError: it is not installed for this Python, or it does not fit what else is.
    """
    try:
        make = importlib.import_module("picamera2").Picamera2
        return make, importlib.import_module("libcamera").ColorSpace.Sycc()
    except ImportError as error:
        raise ConfigError(f"{source}: {error}; {INSTALL}") from error
    except ValueError as error:
        # the distribution's simplejpeg, made for numpy 1, under the numpy 2 of the virtual environment
        raise ConfigError(
            f"{source}: picamera2 does not load: {error}; expected 'pip install simplejpeg' in the virtual "
            "environment (docs/how-to/cameras.md)"
        ) from error
