"""The table of second sources: how it judges, and that its page is its own."""

import pytest

from companion.base.messages import Quantity, SourceComparison
from companion.base.second_sources import (
    ROWS,
    SIGMA_THRESHOLD,
    TABLE,
    Reaction,
    SourceRow,
    SourceState,
    announced,
    judged,
    refused,
)
from docs import second_sources


def compared(quantity: Quantity, difference: float, std: float) -> SourceComparison:
    return SourceComparison(1.0, quantity, "12 of it", "0 of it", difference, std)


def test_every_quantity_is_listed_at_most_once() -> None:
    assert len(TABLE) == len(ROWS)


@pytest.mark.parametrize("row", [row for row in ROWS if row.bound is not None], ids=lambda row: row.quantity)
@pytest.mark.parametrize("std", [0.0, 2.0])
def test_a_difference_counts_when_it_is_surely_beyond(row: SourceRow, std: float) -> None:
    for limit, judges in ((row.notice, announced), (row.bound, refused)):
        assert limit is not None
        for more, counts in ((-0.01, False), (0.01, True)):
            given = compared(row.quantity, limit + SIGMA_THRESHOLD * std + more, std)
            found = dict(judges([given]))
            assert (row.quantity in found) is counts
            if counts:
                assert f"{row.first} 12 of it, {row.second} 0 of it" in found[row.quantity]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.quantity)
def test_what_is_refused_was_announced_before(row: SourceRow) -> None:
    assert row.bound is None or (row.notice is not None and row.notice < row.bound)
    assert row.reaction is not Reaction.NOTICE or row.bound is None


def test_each_row_is_judged_with_its_newest_comparison() -> None:
    older = compared(Quantity.ATTITUDE, 20.0, 0.5)
    given = [older, compared(Quantity.ATTITUDE, 1.0, 0.5), compared(Quantity.HEADING, 15.0, 1.0)]
    found = {row.quantity: state for row, state, _ in judged(given)}
    assert set(found) == set(TABLE)
    assert found[Quantity.ATTITUDE] is SourceState.AGREES
    assert found[Quantity.HEADING] is SourceState.DIFFERS
    assert found[Quantity.PAD_SCALE] is SourceState.NOT_MEASURED
    assert [s for r, s, _ in judged([older]) if r.quantity is Quantity.ATTITUDE] == [SourceState.REFUSED]


def test_the_page_is_the_table() -> None:
    page = second_sources.PAGE.read_text(encoding="utf-8")
    assert page == second_sources.page_text(), "run: python -m docs.second_sources"
