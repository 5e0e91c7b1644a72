"""The faulty line: what it loses, when things arrive and in which order."""

from itertools import pairwise

import numpy as np
import pytest

from sitl.faults.faulty_link import LinkChannel, LinkSettings

SENT = [0.02 * k for k in range(5000)]


def arrivals(seed: int = 1, **settings: float) -> list[float | None]:
    way = LinkChannel(LinkSettings.model_validate(settings), np.random.default_rng(seed))
    return [way.arrival_s(sent) for sent in SENT]


def delays(**settings: float) -> list[float]:
    """Of what arrives."""
    pairs = zip(SENT, arrivals(1, **settings), strict=True)
    return [arrival - sent for sent, arrival in pairs if arrival is not None]


def test_a_perfect_line_carries_all_at_once() -> None:
    assert arrivals() == SENT


def test_a_share_is_lost() -> None:
    assert len(delays(loss_share=0.2)) / len(SENT) == pytest.approx(0.8, abs=0.02)
    assert delays(loss_share=1.0) == []


def test_the_delay_is_the_settings_and_varies_by_the_jitter() -> None:
    late = delays(delay_s=0.1, jitter_s=0.015)
    assert min(late) == pytest.approx(0.1, abs=0.001)
    assert max(late) == pytest.approx(0.115, abs=0.001)
    assert np.mean(late) == pytest.approx(0.1075, abs=0.001)


def test_jitter_alone_keeps_the_order_even_when_it_is_longer_than_the_pauses() -> None:
    when = [arrival for arrival in arrivals(jitter_s=0.2) if arrival is not None]
    assert all(a < b for a, b in pairwise(when))


def test_reordered_ones_are_overtaken() -> None:
    when = [arrival for arrival in arrivals(reorder_share=0.1, reorder_hold_s=0.05) if arrival is not None]
    overtaken = sum(a > b for a, b in pairwise(when))
    assert overtaken / len(when) == pytest.approx(0.1, abs=0.02)


def test_a_blackout_lets_nothing_through_and_then_everything() -> None:
    way = LinkChannel(LinkSettings(), np.random.default_rng(0))
    way.cut = True
    assert way.arrival_s(1.0) is None
    way.cut = False
    assert way.arrival_s(2.0) == 2.0


def test_a_seed_gives_one_line() -> None:
    bad = {"loss_share": 0.3, "jitter_s": 0.1, "reorder_share": 0.1}
    assert arrivals(4, **bad) == arrivals(4, **bad)
    assert arrivals(4, **bad) != arrivals(5, **bad)
