"""Landings on a ship that rolls by 15° and pitches by 8° (significant), beside their bars.

    python -m benchmarks deck --seeds 10 --jobs 2        (or: make bench-deck)

Flies the scenario under many seeds in virtual time with rendering. A frame counts from when the pad is
approached to the first contact; the tilt at contact is between the vehicle and the deck. Ends in one line
that says which bars hold; the exit status is 0 when all do.
"""

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Final

from rich.table import Table

from benchmarks.report import BenchReport, watched
from benchmarks.state.streams import Stream, fly_stream
from companion.base.messages import Outcome, PadSighting, Phase
from companion.sim.trial import Trial

SMOKE: Final = ("--seeds", "1", "--jobs", "1")
SCENARIO: Final = "rolling_deck"
LEAST_SEEN: Final = 0.99  # of the frames
LEAST_LANDED: Final = 0.95
LARGEST_TILT_DEG: Final = 12.0


@dataclass(frozen=True)
class DeckLanding:
    """One flight; the tilt (deg) is at contact, None where there was none."""

    seed: int
    outcome: str
    seen: int
    frames: int
    tilt_deg: float | None


def landing_of(stream: Stream) -> DeckLanding:
    """What a flight's stream shows."""
    sightings = [event.message for event in stream.events if event.topic == "sighting"]
    seen, frames = _seen(sightings, _approached_s(stream), stream.airborne_s[1])
    tilt_deg = None if stream.touchdown is None else stream.touchdown["tilt_deg"]
    return DeckLanding(stream.seed, stream.outcome, seen, frames, tilt_deg)


def _approached_s(stream: Stream) -> float:
    """When the first approach begins; without one, the end."""
    begun = (time_s for time_s, phase in stream.phases if phase == Phase.APPROACH.value)
    return next(begun, stream.airborne_s[1])


def _seen(sightings: Sequence[PadSighting], start_s: float, end_s: float) -> tuple[int, int]:
    """Frames that show the pad, and all there were: they are numbered, whether they show it or not."""
    within = [s for s in sightings if start_s <= s.time_s <= end_s]
    if len(within) < 2:
        return len(within), 0
    first, last = within[0], within[-1]
    period_s = (last.time_s - first.time_s) / (last.sequence - first.sequence)
    unseen = (first.time_s - start_s + end_s - last.time_s) / period_s
    return len(within), last.sequence - first.sequence + 1 + int(unseen)


def flown(seed: int) -> DeckLanding:
    """One flight, measured."""
    return landing_of(fly_stream(Trial.load(SCENARIO, seed)))


def bars(landings: Sequence[DeckLanding]) -> dict[str, tuple[float, bool]]:
    """Each bar's figure, and whether it holds."""
    seen = sum(each.seen for each in landings) / max(sum(each.frames for each in landings), 1)
    landed = sum(each.outcome == Outcome.LANDED.value for each in landings) / len(landings)
    tilt = max((each.tilt_deg for each in landings if each.tilt_deg is not None), default=0.0)
    return {
        f"frames that show the pad, expected {LEAST_SEEN:.0%}": (seen, seen >= LEAST_SEEN),
        f"landed, expected {LEAST_LANDED:.0%}": (landed, landed >= LEAST_LANDED),
        f"tilt at contact, expected {LARGEST_TILT_DEG:g}° or less": (tilt, tilt <= LARGEST_TILT_DEG),
    }


def table(landings: Sequence[DeckLanding]) -> Table:
    """A line a flight."""
    shown = Table("seed", "outcome", "frames", "show the pad", "tilt at contact")
    for each in landings:
        share = f"{each.seen / each.frames:.1%}" if each.frames else "-"
        tilt = "-" if each.tilt_deg is None else f"{each.tilt_deg:.1f}°"
        shown.add_row(str(each.seed), each.outcome, str(each.frames), share, tilt)
    return shown


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=2)
    chosen, report = parser.parse_args(arguments), BenchReport()
    with ProcessPoolExecutor(chosen.jobs) as pool:
        landings = list(watched(pool.map(flown, range(chosen.seeds)), "flights", chosen.seeds))
    held = bars(landings)
    report.show(table(landings))
    return report.judge({f"{name}: {value:.3g}": ok for name, (value, ok) in held.items()})
