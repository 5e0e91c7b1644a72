"""The judge of `bench_faults` on climbs: which count, where one begins, and what announces it."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from benchmarks.faults.climbs import unannounced_climbs
from benchmarks.faults.fault_flight import with_belief
from benchmarks.faults.witness import SAMPLE_S, Commanded, TruthSample
from companion.base.geometry import ZERO3
from sitl.faults.schedule import AppText
from tests.unit.control.controller_inputs import vehicle_state


def flown(speed_up_m_s: Callable[[float], float], until_s: float = 20.0) -> list[TruthSample]:
    """Samples of a flight whose climb speed is given over time."""
    samples, up_m = [], 5.0
    for k in range(round(until_s / SAMPLE_S)):
        time_s = k * SAMPLE_S
        speed = speed_up_m_s(time_s)
        up_m += speed * SAMPLE_S
        place = (0.0, 0.0, -up_m)
        samples.append(TruthSample(time_s, place, (0.0, 0.0, -speed), up_m, False, True, "OFFBOARD"))
    return samples


def found(samples: list[TruthSample], *said: tuple[float, str]) -> list[str]:
    return list(unannounced_climbs(samples, [AppText(t, 4, text) for t, text in said]))


def one_climb(time_s: float) -> float:
    """Down at 0.5 m/s until 8 s, level at 0.05 m/s up until 10 s, then up at 1 m/s for 4 s."""
    return -0.5 if time_s < 8.0 else 0.05 if time_s < 10.0 else 1.0 if time_s < 14.0 else 0.0


@pytest.mark.parametrize("said_s", [7.1, 9.0, 10.9])
def test_a_text_from_3_s_before_to_1_s_after_the_beginning_announces_a_climb(said_s: float) -> None:
    assert found(flown(one_climb), (said_s, "climbing 4.0 m to look for the pad")) == []


@pytest.mark.parametrize("said_s", [6.9, 11.1])
def test_any_other_time_is_too_early_or_too_late(said_s: float) -> None:
    wrong = found(flown(one_climb), (said_s, "climbing 4.0 m to look for the pad"))
    assert wrong == ["climbed from 10.0 s, unannounced"]


@pytest.mark.parametrize(
    ("text", "announces"),
    [
        ("climbing 3.9 m to look for the pad", True),
        ("climbing 1.0 m: ground near", True),
        ("back to 0.9 m over the pad to try again", True),
        ("misaligned: waiting again over the pad", True),
        ("take off: armed: motors on", True),
        ("search: pad lost: unseen", False),
        ("approach: pad seen: lateral offset 0.3 m", False),
        ("approach: misaligned: lateral offset 0.3 m", False),
        ("hold: misaligned: too often", False),
        ("abort: timeout: 60 s", False),
        ("touchdown: low: 42 cm over the pad", False),
        ("reference error 0.9 m: replanned", False),
    ],
)
def test_only_words_of_climbing_announce_it(text: str, announces: bool) -> None:
    assert (found(flown(one_climb), (9.5, text)) == []) == announces


def test_one_announcement_covers_the_whole_climb_and_no_second_one() -> None:
    def twice(pause_s: float) -> list[TruthSample]:
        def speed(time_s: float) -> float:
            up = 5.0 <= time_s < 9.0 or 9.0 + pause_s <= time_s < 13.0
            return 1.0 if up else 0.0

        return flown(speed)

    said = (5.0, "climbing 8.0 m to look for the pad")
    assert found(twice(0.4), said) == []
    assert found(twice(1.0), said) == ["climbed from 10.0 s, unannounced"]


def test_a_slow_rise_that_shakes_is_one_climb() -> None:
    def shaking(time_s: float) -> float:
        return 0.0 if time_s < 5.0 else 0.05 if time_s % 1.0 < 0.1 else 0.15

    samples = flown(shaking)
    assert found(samples, (4.5, "climbing 2.0 m to look for the pad")) == []
    assert len(found(samples)) == 1


def test_a_creeping_rise_has_to_be_announced_as_well() -> None:
    assert len(found(flown(lambda _: 0.08))) == 1


def test_a_height_that_wanders_with_the_receiver_s_is_no_climb_until_it_leads_far_up() -> None:
    assert found(flown(lambda _: 0.06, until_s=45.0)) == []
    assert len(found(flown(lambda _: 0.06, until_s=55.0))) == 1


@pytest.mark.parametrize(
    ("behind_m_s", "receiver_m_s", "counts"),
    [
        (0.06, 0.06, False),  # it follows the receiver, and of 1 m it knows of 0.4
        (0.02, 0.06, True),  # of 0.8 m it knows
        (0.06, 0.0, True),  # its own mistake, which no receiver explains
        (-0.06, -0.06, True),
    ],
)
def test_no_climb_is_what_the_receiver_misleads_the_app_to(
    behind_m_s: float, receiver_m_s: float, counts: bool
) -> None:
    samples = [
        s._replace(believed_low_m=behind_m_s * s.time_s, receiver_low_m=receiver_m_s * s.time_s)
        for s in flown(lambda _: 0.1)
    ]
    assert (len(found(samples)) == 1) is counts


def test_the_belief_of_a_sample_is_the_newest_before_it() -> None:
    samples = [TruthSample(t, (0.0, 0.0, -5.0), ZERO3, 5.0, False, True, "OFFBOARD") for t in (0.0, 1.0, 2.0)]
    believed = [replace(vehicle_state(t), position_ned_m=(0.0, 0.0, -4.0 - t)) for t in (0.5, 0.9, 2.0)]
    assert [s.believed_low_m for s in with_belief(samples, believed)] == pytest.approx([0.0, 0.1, -1.0])


def test_what_the_autopilot_flew_meanwhile_is_not_the_apps() -> None:
    samples = flown(one_climb)
    own = [sample for sample in samples if not 9.9 <= sample.time_s < 14.0]
    assert found(own) == []
    assert len(found([sample for sample in samples if not 9.9 <= sample.time_s < 11.0])) == 1


def test_a_rise_that_the_app_commands_is_a_climb_however_slow() -> None:
    samples = flown(lambda _: 0.06)
    rising = [Commanded(s.time_s, "local", s.position_ned_m[2]) for s in samples]
    level = [place._replace(down_m=-5.0) for place in rising]
    sinking = [place._replace(down_m=0.1 * place.time_s) for place in rising]
    assert len(list(unannounced_climbs(samples, [], rising))) == 1
    assert list(unannounced_climbs(samples, [], level)) == []
    assert list(unannounced_climbs(samples, [], sinking)) == []
    # commanded and not flown: the receiver wandered the other way
    assert list(unannounced_climbs(flown(lambda _: 0.0), [], rising)) == []


def test_another_frame_of_the_reference_is_no_climb() -> None:
    samples = flown(lambda _: 0.06)
    frames = [
        Commanded(s.time_s, "local" if s.time_s < 5.0 else "pad", -5.0 if s.time_s < 5.0 else -9.0)
        for s in samples
    ]
    assert list(unannounced_climbs(samples, [], frames)) == []


def test_a_commanded_climb_that_was_announced_covers_itself_alone() -> None:
    samples = flown(one_climb)
    commanded = [Commanded(s.time_s, "local", s.position_ned_m[2]) for s in samples]
    said = [AppText(9.9, 4, "climbing 4.0 m to look for the pad")]
    assert list(unannounced_climbs(samples, said, commanded)) == []
    assert list(unannounced_climbs(samples, [], commanded)) == ["climbed from 10.0 s, unannounced"]
