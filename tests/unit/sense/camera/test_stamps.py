"""Mid-exposure by a stamp at each of the three moments, and which clock a driver stamps by."""

import pytest

from companion.sense.camera.health import ENOUGH_UNSTAMPED, StampPoint, StampReader, mid_exposure_s

EXPOSURE_S, READOUT_S = 0.004, 0.012


@pytest.mark.parametrize(
    ("point", "after_s"),
    # the first row is exposed from 0 to 4 ms, the last from 12 to 16: the middle row's middle is at 8
    [("start_of_exposure", 0.0), ("start_of_readout", 0.004), ("end_of_readout", 0.016)],
)
def test_each_moment_of_the_same_frame_gives_the_same_mid_exposure(point: StampPoint, after_s: float) -> None:
    assert mid_exposure_s(100.0 + after_s, point, EXPOSURE_S, READOUT_S) == pytest.approx(100.008)


@pytest.mark.parametrize("point", ["start_of_exposure", "start_of_readout", "end_of_readout"])
def test_a_global_shutter_of_no_exposure_is_exposed_at_its_stamp(point: StampPoint) -> None:
    assert mid_exposure_s(100.0, point, 0.0, 0.0) == 100.0


def test_a_stamp_of_our_clock_counts() -> None:
    assert StampReader().read(99.95, received_s=100.0) == 99.95


def test_a_stamp_of_the_clock_that_counts_suspension_is_brought_to_ours() -> None:
    assert StampReader(3600.0).read(3699.95, received_s=100.0) == pytest.approx(99.95)


@pytest.mark.parametrize("stamp_s", [0.0, 99.0, 100.5, 1.7e9])
def test_a_driver_without_stamps_leaves_the_arrival_which_the_last_row_s_readout_precedes(
    stamp_s: float,
) -> None:
    reader = StampReader()
    found = reader.exposed_s(stamp_s, 100.0, "start_of_readout", EXPOSURE_S, READOUT_S)
    assert found == pytest.approx(100.0 - 0.5 * EXPOSURE_S - 0.5 * READOUT_S)


def test_a_driver_without_stamps_is_reported_once() -> None:
    reader, told = StampReader(), list[int]()
    for number in range(5 * ENOUGH_UNSTAMPED):
        reader.read(0.0, 100.0 + number)
        if reader.complaint is not None:
            told.append(number)
    assert told == [ENOUGH_UNSTAMPED - 1]


def test_a_first_frame_without_a_stamp_does_not_spoil_those_after_it() -> None:
    reader = StampReader()
    assert reader.read(0.0, 100.0) is None
    assert reader.read(100.0, 100.03) == 100.0
    assert reader.complaint is None


def test_once_trusted_a_stamp_that_cannot_be_right_is_handed_on_for_the_watch_to_see() -> None:
    reader = StampReader()
    reader.read(100.0, 100.03)
    assert reader.read(90.0, 100.06) == 90.0
