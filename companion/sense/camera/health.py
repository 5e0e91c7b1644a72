"""Whether what a camera gives is of use: frames that come, that are new, whole and stamped rightly. Pure.

Times in s of the loop's clock, handed in. A frame is good when it is newer than the last one by its stamp,
is not older than it can be, is not the last image over again, is not of one grey, and is not torn. Without a
good one for `Patience.trouble_s` the camera is in trouble, and why is reported; trouble that lasts makes it
lost, and it is to be opened anew.

Judgements of images rest on noise: no sensor gives the same number for thousands of pixels twice. A decoder
does: what did not change is not sent again, so in decoded video rows that are the last image's are no tear. A
lower part that is all white is none that is empty: glare is just that.
"""

from dataclasses import dataclass, replace
from math import inf
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from companion.base.messages import Frame
from companion.config import CaptureConfig

STRIDE: Final = 8  # every 8th pixel of every 8th row is looked at
FLAT_GREY: Final = 2  # spread of an image that shows nothing
FUTURE_S: Final = 0.05
LEAST_TORN: Final = 0.1  # share of the rows at the lower edge
WHITE: Final = 255
FIRST_REPORT_S: Final = 2.0  # without a first frame, though more may be waited for

Kind = Literal["silent", "content", "stamp"]


@dataclass(frozen=True, slots=True)
class Patience:
    """How long what may last: see `patience_with`."""

    trouble_s: float  # without a good frame: reported
    silent_s: float  # without any frame: opened anew
    content_s: float  # with frames of no use: opened anew
    first_s: float  # for the first frame, instead of the first two
    oldest_s: float  # a frame's age on arrival
    decoded: bool = False  # rows of the last image may come again


def patience_with(
    camera: CaptureConfig, source: Literal["device", "stream", "socket", "recording"]
) -> Patience:
    """What a camera of that rate may be allowed.

    Trouble is reported within 0.3 s at any rate. A connection that is silent is not mended by parting, so a
    socket's may be so for longer, and before its first frame for ever: its server may still be starting. A
    recording is what it is, and opening it anew would play it from its beginning.
    """
    trouble_s = max(0.25, 1.3 / camera.rate_hz)
    match source:
        case "device":
            return Patience(trouble_s, silent_s=1.0, content_s=1.0, first_s=3.0, oldest_s=0.5)
        case "stream":
            return replace(patience_with(camera, "device"), decoded=True)
        case "socket":
            return Patience(trouble_s, silent_s=5.0, content_s=5.0, first_s=inf, oldest_s=inf)
        case "recording":
            return Patience(inf, silent_s=inf, content_s=inf, first_s=inf, oldest_s=inf, decoded=True)


@dataclass(frozen=True, slots=True)
class FrameFault:
    """What is wrong with a frame; not `usable`: it must not be looked at."""

    kind: Kind
    text: str
    usable: bool = False


class FrameJudge:
    """Holds each frame of one camera against the one before."""

    def __init__(self, oldest_s: float, *, decoded: bool = False) -> None:
        """`oldest_s`: how old a frame may be on arrival; `decoded`: it is of a compressed video."""
        self._oldest_s, self._decoded = oldest_s, decoded
        self._last: Frame | None = None
        self._last_sample: NDArray[np.uint8] | None = None

    def fault(self, frame: Frame) -> FrameFault | None:
        """What is wrong with it, None when it is good."""
        found = self._stamp_fault(frame)
        if found is not None:
            return found
        sample = frame.image[::STRIDE, ::STRIDE].copy()  # in one piece: it is gone through several times
        found = self._content_fault(frame, sample)
        self._last, self._last_sample = frame, sample
        return found

    def _stamp_fault(self, frame: Frame) -> FrameFault | None:
        age_s = frame.received_s - frame.time_s
        if age_s > self._oldest_s:
            return FrameFault("stamp", f"frame stamps {age_s:.1f} s before arrival")
        if age_s < -FUTURE_S:
            return FrameFault("stamp", f"frame stamps {-age_s:.1f} s after arrival")
        if self._last is None:
            return None
        step_s = frame.time_s - self._last.time_s
        if step_s == 0.0:
            return FrameFault("stamp", "frame stamps do not advance")
        if step_s < 0.0:
            return FrameFault("stamp", f"frame stamps jump back by {-step_s:.3f} s")
        return None

    def _content_fault(self, frame: Frame, sample: NDArray[np.uint8]) -> FrameFault | None:
        low, high = int(sample.min()), int(sample.max())
        if high - low <= FLAT_GREY:
            return FrameFault("content", f"images of one grey ({low} of 255)")
        if _filled_share(sample) >= LEAST_TORN:
            # the rest is what was seen
            return FrameFault("content", "torn images: lower part empty", usable=True)
        last, last_sample = self._last, self._last_sample
        if last is None or last_sample is None or _lowest_is_new(sample, last_sample):
            return None
        same = (sample == last_sample).all(axis=1)
        if same.all():
            again = np.array_equal(frame.image, last.image)
            return FrameFault("content", "the same image repeated") if again else None
        # a row of one grey (clipped, white or black) is the same without being old
        old = same & (sample != sample[:, :1]).any(axis=1)
        if not self._decoded and _old_share(old) >= LEAST_TORN:
            return FrameFault("content", "torn images: lower part of the previous one")
        return None


def _lowest_is_new(sample: NDArray[np.uint8], last: NDArray[np.uint8]) -> bool:
    """Whether the image is, by its lowest row, neither the same nor from below that of the one before."""
    return bool(sample.shape != last.shape or (sample[-1] != last[-1]).any())


def _filled_share(sample: NDArray[np.uint8]) -> float:
    """Share of the rows, from the lower edge up, that hold nothing but one and the same grey."""
    grey = sample[-1, 0]
    if grey == WHITE or (sample[-1] != grey).any():
        return 0.0
    return _run_from_below((sample == grey).all(axis=1))


def _old_share(same: NDArray[np.bool_]) -> float:
    """Share of the rows, from the lower edge up, that are the last image's where all above are new."""
    share = _run_from_below(same)
    return share if same.mean() == share else 0.0


def _run_from_below(rows: NDArray[np.bool_]) -> float:
    """Share of the rows that hold, counted from the last one up to the first that does not."""
    breaks = np.flatnonzero(~rows)
    return (len(rows) - 1 - int(breaks[-1])) / len(rows) if len(breaks) else 1.0


class CameraHealth:
    """One camera from its opening to its loss."""

    def __init__(self, patience: Patience, opened_s: float) -> None:
        """A camera that has been opened at that time."""
        self._patience = patience
        self._judge = FrameJudge(patience.oldest_s, decoded=patience.decoded)
        self._opened_s = opened_s
        self._frame_s: float | None = None
        self._good_s: float | None = None  # the last good frame
        self._run_s: float | None = None  # the first good one after the last trouble
        self._fault: FrameFault | None = None

    def take(self, frame: Frame, now_s: float) -> bool:
        """Note a frame that has come; whether it may be looked at."""
        self._frame_s = now_s
        self._fault = self._judge.fault(frame)
        if self._fault is None:
            if self._run_s is None or self.trouble(now_s) is not None:
                self._run_s = now_s
            self._good_s = now_s
        return self._fault is None or self._fault.usable

    def excuse(self, held_up_s: float) -> None:
        """Whoever looks was held up for so long, and not the camera: what came meanwhile is not taken yet."""
        self._opened_s += held_up_s
        self._frame_s = None if self._frame_s is None else self._frame_s + held_up_s
        self._good_s = None if self._good_s is None else self._good_s + held_up_s

    @property
    def good_since_s(self) -> float | None:
        """Since when no good frame was long in coming; None before the first."""
        return self._run_s

    def trouble(self, now_s: float) -> str | None:
        """What is wrong, once it has lasted."""
        if self._frame_s is None:
            waited_s = now_s - self._opened_s
            late = waited_s > max(FIRST_REPORT_S, self._patience.trouble_s)
            return f"no frame in {waited_s:.0f} s since it was opened" if late else None
        good_s = self._opened_s if self._good_s is None else self._good_s
        if now_s - good_s <= self._patience.trouble_s:
            return None
        if now_s - self._frame_s > self._patience.trouble_s or self._fault is None:
            return f"no frame for {self._patience.trouble_s:.2f} s"
        return self._fault.text

    def lost(self, now_s: float) -> Kind | None:
        """Why it is to be opened anew, None while it is not."""
        patience = self._patience
        if self._frame_s is None:
            return "silent" if now_s - self._opened_s > patience.first_s else None
        if now_s - self._frame_s > patience.silent_s:
            return "silent"
        good_s = self._opened_s if self._good_s is None else self._good_s
        fault = self._fault
        # one whose frames are of use is not kept from vision: in the dark, black is what empty looks like
        if fault is not None and not fault.usable and now_s - good_s > patience.content_s:
            return fault.kind
        return None


# ---------------------------------------------------------------- stamps
# From a driver's time stamp to mid-exposure of the image's middle row. A row of a rolling shutter is exposed
# for `exposure_s` and read out at the end of that; the last row's turn comes `readout_s` after the first
# one's (0: global shutter). With t_k the end of row k's exposure:
#
#     start of exposure   t_first - exposure      what the UVC standard means by a presentation time
#     start of readout    t_first                 when the first byte leaves the sensor
#     end of readout      t_last = t_first + readout
#     mid-exposure        t_first + readout / 2 - exposure / 2

StampPoint = Literal["start_of_exposure", "start_of_readout", "end_of_readout"]

# a stamp is of our clock when it says that the frame is no older than this on arrival, and not of the future
OLDEST_STAMP_S: Final = 0.5
EARLIEST_STAMP_S: Final = 0.001
# so many frames in a row without a stamp that can be right: there are none
ENOUGH_UNSTAMPED: Final = 10


def mid_exposure_s(stamp_s: float, point: StampPoint, exposure_s: float, readout_s: float) -> float:
    """When the middle row was at the middle of its exposure, by a stamp taken at `point`."""
    match point:
        case "start_of_exposure":
            return stamp_s + 0.5 * exposure_s + 0.5 * readout_s
        case "start_of_readout":
            return stamp_s - 0.5 * exposure_s + 0.5 * readout_s
        case "end_of_readout":
            return stamp_s - 0.5 * exposure_s - 0.5 * readout_s


class StampReader:
    """Finds out whether a driver stamps by our clock; from the first stamp that can be right on, all count.

    A later one that cannot be right is handed on as it is: `health` has to see it, where a silent change to
    the time of arrival would shift the pad by the latency.
    """

    def __init__(self, other_clock_ahead_s: float = 0.0) -> None:
        """`other_clock_ahead_s`: how far the other clock that may be meant (CLOCK_BOOTTIME) is ahead."""
        self._offsets_s = (0.0, other_clock_ahead_s)
        self._ahead_s: float | None = None
        self._unstamped = 0

    @property
    def complaint(self) -> str | None:
        """At the frame at which it is certain that there are no usable stamps, what to say of it."""
        if self._unstamped != ENOUGH_UNSTAMPED:
            return None
        return "its driver gives no usable time stamps: frames count from their arrival"

    def read(self, stamp_s: float, received_s: float) -> float | None:
        """The stamp by our clock; None while none could be right: the time of arrival is all there is."""
        if self._ahead_s is None:
            ages = ((received_s - stamp_s + ahead_s, ahead_s) for ahead_s in self._offsets_s)
            fitting = (ahead for age_s, ahead in ages if -EARLIEST_STAMP_S <= age_s <= OLDEST_STAMP_S)
            self._ahead_s = next(fitting, None)
        if self._ahead_s is None:
            self._unstamped += 1
            return None
        self._unstamped = 0
        return stamp_s - self._ahead_s

    def exposed_s(
        self, stamp_s: float, received_s: float, point: StampPoint, exposure_s: float, readout_s: float
    ) -> float:
        """Mid-exposure of a frame that was stamped at `point`; by its arrival while there are no stamps.

        It has come, so its last row has been read out: what else has passed since then nobody says.
        """
        believed_s = self.read(stamp_s, received_s)
        if believed_s is None:
            return mid_exposure_s(received_s, "end_of_readout", exposure_s, readout_s)
        return mid_exposure_s(believed_s, point, exposure_s, readout_s)
