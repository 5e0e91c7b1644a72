"""The PNG plots: names that do not overprint, one title, equal axes where it is a map."""

from dataclasses import replace
from itertools import combinations, pairwise
from typing import Any

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from companion.base.messages import Phase, PlanStep
from companion.flightlog.errors import TruthTrack
from companion.flightlog.report.phases import PHASE_COLOURS, phase_spans, spread_out
from companion.flightlog.report.plots import SIZE_IN, draw_height, draw_path
from tests.unit.flightlog.test_result import made_up_flight


def test_a_phase_lasts_until_the_next_begins() -> None:
    plans = [PlanStep(t, phase) for t, phase in ((0.0, Phase.ARM), (1.0, Phase.ARM), (2.5, Phase.SEARCH))]
    spans = phase_spans([*plans, PlanStep(4.0, Phase.SEARCH)])
    assert [(s.name, s.start_s, s.end_s) for s in spans] == [("arm", 0.0, 2.5), ("search", 2.5, 4.0)]
    assert phase_spans([]) == []


def test_every_phase_has_a_colour_of_its_own() -> None:
    assert len({PHASE_COLOURS[phase] for phase in Phase}) == len(Phase)


def test_places_are_spread_as_far_as_needed_and_stay_within() -> None:
    assert spread_out([1.0, 5.0, 9.0], 1.0, 0.0, 10.0) == [1.0, 5.0, 9.0]
    crowded = spread_out([9.9, 9.8, 9.95, 2.0], 1.0, 0.0, 10.0)
    assert crowded == pytest.approx([2.0, 8.0, 9.0, 10.0])
    with pytest.raises(ValueError, match="no room"):
        spread_out([1.0, 1.0, 1.0], 6.0, 0.0, 10.0)


def drawn(plans: list[PlanStep]) -> tuple[Figure, Any]:
    kept, truth = made_up_flight()
    figure = Figure(figsize=SIZE_IN, dpi=110, layout="constrained")
    figure.suptitle("made up")
    draw_height(figure, TruthTrack(truth), {**kept, "plan": plans})
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    return figure, canvas.get_renderer()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize(
    "short_s",
    [
        pytest.param(1.0, id="all long"),
        pytest.param(0.02, id="crowded at the end"),
    ],
)
def test_the_phases_names_do_not_overprint(short_s: float) -> None:
    """GIVEN phases of which many are short and near one another, THEN no two names share a pixel."""
    starts = [0.0, 2.0, *(9.0 - 8 * short_s + short_s * k for k in range(9))]
    phases = [phase for phase in Phase if phase is not Phase.STANDBY][: len(starts)]
    plans = [PlanStep(start, phase) for start, phase in zip(starts, phases, strict=True)]
    figure, renderer = drawn([*plans, PlanStep(10.0, phases[-1])])
    texts = [text for text in figure.axes[0].texts if text.get_text()]
    assert len(texts) == len(phases)
    boxes = [text.get_window_extent(renderer) for text in texts]
    assert [(a, b) for a, b in combinations(boxes, 2) if a.overlaps(b)] == []
    title = figure._suptitle.get_window_extent(renderer)  # type: ignore[attr-defined]
    assert not any(box.overlaps(title) for box in boxes)


def test_a_flight_that_wavers_between_phases_names_as_many_as_there_is_room_for() -> None:
    plans = [PlanStep(0.02 * k, (Phase.SEARCH, Phase.APPROACH)[k % 2]) for k in range(500)]
    figure, renderer = drawn(plans)
    boxes = [text.get_window_extent(renderer) for text in figure.axes[0].texts]
    assert 20 < len(boxes) < 500
    assert not any(a.overlaps(b) for a, b in pairwise(boxes))


def test_a_map_has_equal_axes() -> None:
    _, truth = made_up_flight()
    figure = Figure()
    draw_path(figure, TruthTrack(truth))
    assert figure.axes[1].get_aspect() == 1.0


def test_a_straight_path_to_a_pad_that_stands_shows_the_pad_and_few_ticks_across() -> None:
    _, truth = made_up_flight()
    zero = (0.0, 0.0, 0.0)
    straight = [
        replace(t, vehicle_position_ned_m=(10.0 * k / len(truth), 0.0, -1.0), pad_position_ned_m=zero)
        for k, t in enumerate(truth)
    ]
    straight[-1] = replace(straight[-1], vehicle_position_ned_m=(10.0, 1.5, -1.0))
    figure = Figure(dpi=110, layout="constrained")
    draw_path(figure, TruthTrack(straight))
    space: Any = figure.axes[0]
    assert space.lines[0].get_marker() == "s"
    few, many = len(space.get_xticks()), len(space.get_yticks())
    assert 1 <= few <= 4 < many
