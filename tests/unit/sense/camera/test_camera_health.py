"""What is held to be wrong with a camera, frame by frame, with the clock handed in."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.messages import Frame
from companion.config import CameraConfig
from companion.sense.camera.health import CameraHealth, patience_with
from tests.unit.sense.camera.camera_frames import AGE_S, noisy_frame

PERIOD_S = 1 / 30
Spoil = Callable[[Frame, Frame], Frame]  # the frame, and the one before it


def images(change: Callable[[NDArray[np.uint8], NDArray[np.uint8]], NDArray[np.uint8]]) -> Spoil:
    """Frames of other images."""
    return lambda frame, before: replace(frame, image=change(frame.image, before.image))


def flat(grey: int) -> Spoil:
    """Frames of one grey."""
    return images(lambda image, _: np.full_like(image, grey))


def with_lower_part(of: Callable[[NDArray[np.uint8]], NDArray[np.uint8] | int], share: float = 0.4) -> Spoil:
    """Frames whose lower part is something else, made of the image before."""

    def change(image: NDArray[np.uint8], before: NDArray[np.uint8]) -> NDArray[np.uint8]:
        rows = round(share * len(image))
        torn, filling = image.copy(), of(before)
        torn[-rows:] = filling if isinstance(filling, int) else filling[-rows:]
        return torn

    return images(change)


class Fed:
    """A camera that has given good frames for a second, and then others."""

    def __init__(self, camera: CameraConfig) -> None:
        self.health = CameraHealth(patience_with(camera, "device"), opened_s=99.9)
        self.now_s, self.number, self.used = 100.0, 0, 0
        self.before = noisy_frame(-1, 99.9)
        self.feed(1.0, lambda frame, _: frame)
        assert self.health.trouble(self.now_s) is None
        self.spoilt_s = self.now_s

    def feed(self, lasting_s: float, spoil: Spoil) -> str | None:
        """Frames for so long; the first trouble."""
        self.used = 0
        for _ in range(round(lasting_s / PERIOD_S)):
            self.now_s += PERIOD_S
            self.number += 1
            frame = noisy_frame(self.number, self.now_s - AGE_S)
            self.before = spoil(frame, self.before)
            self.used += self.health.take(self.before, self.now_s)
            if (trouble := self.health.trouble(self.now_s)) is not None:
                return trouble
        return None


@pytest.fixture
def fed(camera: CameraConfig) -> Fed:
    return Fed(camera)


FROZEN = noisy_frame(0, 0.0).image


@pytest.mark.parametrize(
    ("spoil", "told", "used"),
    [
        (flat(0), "one grey (0 of 255)", False),
        (flat(128), "one grey (128 of 255)", False),
        (flat(255), "one grey (255 of 255)", False),
        (with_lower_part(lambda _: 0), "lower part empty", True),
        (with_lower_part(lambda _: 128, share=0.15), "lower part empty", True),
        (with_lower_part(lambda before: before), "lower part of the previous one", False),
        (images(lambda *_: FROZEN), "the same image repeated", False),
        (lambda frame, _: replace(frame, time_s=101.0 - AGE_S), "frame stamps do not advance", False),
        (lambda frame, _: replace(frame, time_s=frame.time_s - 0.4), "frame stamps jump back", False),
        (lambda frame, _: replace(frame, time_s=frame.time_s - 7.0), "7.0 s before arrival", False),
        (lambda frame, _: replace(frame, time_s=frame.time_s + 2.0), "2.0 s after arrival", False),
    ],
)
def test_garbage_is_named_within_a_third_of_a_second(fed: Fed, spoil: Spoil, told: str, used: bool) -> None:
    trouble = fed.feed(2.0, spoil)
    assert trouble is not None
    assert told in trouble
    assert fed.now_s - fed.spoilt_s <= 0.3
    assert (fed.used > 5) if used else (fed.used <= 1)  # the first frozen one may be new


def test_what_lasts_makes_the_camera_lost(fed: Fed) -> None:
    fed.feed(2.0, flat(0))
    assert fed.health.lost(fed.now_s) is None
    while fed.now_s < fed.spoilt_s + 1.1:
        fed.feed(PERIOD_S, flat(0))
    assert fed.health.lost(fed.now_s) == "content"


def test_a_camera_that_still_shows_something_is_reported_and_kept(fed: Fed) -> None:
    torn = with_lower_part(lambda _: 0)  # a hood, a leg or a marker's black in the dark looks the same
    while fed.now_s < fed.spoilt_s + 40.0:
        fed.feed(PERIOD_S, torn)
        assert fed.health.lost(fed.now_s) is None
    assert "lower part empty" in (fed.health.trouble(fed.now_s) or "")


@pytest.mark.parametrize(
    "spoil",
    [
        with_lower_part(lambda _: 255),  # glare, or a bright floor
        with_lower_part(lambda _: 0, share=0.05),  # the rim of a hood
        images(lambda image, _: image // 10),  # dusk: a few greys, with noise
        images(lambda image, _: np.where(np.arange(480)[:, None] < 200, 255, image).astype(np.uint8)),
    ],
)
def test_light_is_no_fault(fed: Fed, spoil: Spoil) -> None:
    assert fed.feed(2.0, spoil) is None
    assert fed.used == 60


def test_single_bad_frames_are_passed_over_in_silence(fed: Fed) -> None:
    every_third: Spoil = lambda frame, before: frame if fed.number % 3 else flat(0)(frame, before)  # noqa: E731
    assert fed.feed(2.0, every_third) is None
    assert fed.used == 40


@pytest.mark.parametrize("rate_hz", [5.0, 30.0, 120.0])
def test_silence_is_trouble_within_a_third_of_a_second_at_any_rate(
    camera: CameraConfig, rate_hz: float
) -> None:
    slow = camera.model_copy(update={"rate_hz": rate_hz})
    health = CameraHealth(patience_with(slow, "device"), opened_s=99.0)
    health.take(noisy_frame(0, 100.0), 100.0)
    assert health.trouble(100.0 + 1.05 / rate_hz) is None
    assert "no frame" in (health.trouble(100.28) or "")
    assert health.lost(100.9) is None
    assert health.lost(101.1) == "silent"


def test_a_camera_that_never_begins_is_reported_and_lost(camera: CameraConfig) -> None:
    health = CameraHealth(patience_with(camera, "device"), opened_s=100.0)
    assert health.trouble(101.9) is None
    assert "since it was opened" in (health.trouble(102.1) or "")
    assert (health.lost(102.9), health.lost(103.1)) == (None, "silent")


def test_a_server_that_has_not_begun_yet_is_waited_for(camera: CameraConfig) -> None:
    health = CameraHealth(patience_with(camera, "socket"), opened_s=100.0)
    assert health.trouble(102.1) is not None
    assert health.lost(1000.0) is None


def test_the_good_run_begins_after_the_trouble(fed: Fed) -> None:
    assert fed.health.good_since_s is not None
    assert fed.health.good_since_s < 100.1
    fed.now_s += 0.4
    back_s = fed.now_s + PERIOD_S
    fed.feed(0.2, lambda frame, _: frame)
    assert fed.health.good_since_s == pytest.approx(back_s)
