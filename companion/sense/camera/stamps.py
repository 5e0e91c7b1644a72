"""From a camera driver's time stamp to mid-exposure of the image's middle row. Pure.

A row of a rolling shutter is exposed for `exposure_s` and read out at the end of that; the last row's turn
comes `readout_s` after the first one's (0: global shutter). With t_k the end of row k's exposure:

    start of exposure   t_first - exposure      what the UVC standard means by a presentation time
    start of readout    t_first                 when the first byte leaves the sensor
    end of readout      t_last = t_first + readout
    mid-exposure        t_first + readout / 2 - exposure / 2

Times are of the loop's clock (CLOCK_MONOTONIC), in s.
"""

from typing import Final, Literal

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
