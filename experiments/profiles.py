"""Descent profiles: the fuzzy speed controller against a fixed speed and a log polynomial of the distance.

Whole flights (app, rendering, estimators, simulated autopilot), the same scenarios and seeds for each law;
what differs is `plan.speed_law` alone. The laws feed eq. 37 in all phases that fly to something, so what is
compared is from the moment the pad is taken up, about 7 m over it, to the contact; the last third of a metre
is the touchdown's own in all three.

Speed, acceleration and jerk are the vehicle's own, relative to the pad, by truth: its velocity smoothed and
differentiated by a Savitzky-Golay filter. SI units.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from rich.table import Table
from scipy.signal import savgol_filter

from companion.base.geometry import FloatArray
from companion.base.messages import Conditions, Outcome, Phase, PlanStep, Reference
from companion.config import GuidanceConfig, PlanConfig
from companion.flightlog.errors import TruthTrack
from companion.plan.speed.laws import load_speed_controller
from companion.plan.trajectory.min_jerk import trajectory_time_s
from experiments.flown import EndedFlight, fly_scenario

DESCENTS: Final = frozenset({Phase.APPROACH, Phase.DESCEND})
SAME_SHARE: Final = 0.01  # of T


@dataclass(frozen=True, slots=True)
class RuleAuthority:
    """Cycles of a descent that planned a way to the pad, and those whose time T was the law's own, by eq. 37.

    T = |Δ| / V + T_min is lengthened where the way would exceed the plan's limits, and most of the last
    plan's time is kept. The log holds T, V and the reference over the horizon, not Δ. That follows from them:
    the way is the quintic of eqs. 20 to 30 that ends at rest in the pad's frame, so its start and one point
    of it give its end.
    """

    cycles: int = 0
    decided: int = 0


def authority(plans: Sequence[PlanStep], minimum_time_s: float) -> RuleAuthority:
    """Count them over a flight's plan, by its T_min (s)."""
    decided = [
        abs(law_s - plan.time_to_go_s) <= SAME_SHARE * plan.time_to_go_s
        for plan in plans
        if (law_s := _law_s(plan, minimum_time_s)) is not None
    ]
    return RuleAuthority(len(decided), sum(decided))


def _law_s(plan: PlanStep, minimum_time_s: float) -> float | None:
    """Eq. 37's own time for the way of a cycle (s); None in a cycle without one."""
    reference, planned = plan.reference, plan.speed_m_s > 0.0 and plan.time_to_go_s > 0.0
    if reference is None or reference.origin != "pad" or plan.phase not in DESCENTS or not planned:
        return None
    return trajectory_time_s(way_to_go_m(reference, plan.time_to_go_s), plan.speed_m_s, minimum_time_s)


def way_to_go_m(reference: Reference, time_to_go_s: float) -> float:
    """|Δ| (m) of the quintic that a reference shows the beginning of, by eqs. 29 and 30."""
    row = len(reference.position_m) // 2
    tau = min(1.0, row * reference.step_s / time_to_go_s)
    start = reference.position_m[0]
    velocity = time_to_go_s * reference.velocity_m_s[0]
    acceleration = time_to_go_s**2 * reference.acceleration_m_s2[0]
    moved = (
        velocity * (tau - 6.0 * tau**3 + 8.0 * tau**4 - 3.0 * tau**5)
        + acceleration * (0.5 * tau**2 - 1.5 * tau**3 + 1.5 * tau**4 - 0.5 * tau**5)
    )  # fmt: skip
    share = 10.0 * tau**3 - 15.0 * tau**4 + 6.0 * tau**5
    return float(np.linalg.norm((reference.position_m[row] - start - moved) / share))


mpl.use("Agg")

LAWS: Final = ("fuzzy", "fixed", "log_polynomial", "fuzzy_pace")
PACED: Final = "fuzzy_pace"  # the fuzzy rules at the pace of the conditions
COLOURS: Final = {"fuzzy": "#c0392b", "fixed": "#2471a3", "log_polynomial": "#27ae60", PACED: "#8e44ad"}
TRUTH_PERIOD_S: Final = 0.04
SMOOTHED_OVER: Final = 13  # records of truth: half a second
CENTRED_M: Final = 0.15
WAITING_HEIGHT_M: Final = 0.6
# set before the flights: the fuzzy speed controller lands always, sets down as softly as the touchdown is
# made for, and pays for no more jerk than the others with no more time (medians over the flights)
SOFT_M_S: Final = 0.3
AS_GOOD: Final = 1.05


@dataclass(frozen=True, slots=True)
class Descent:
    """One flight from taking the pad up; numbers are NaN where there was nothing to measure.

    `course` (3, n) is for the plot: time since the pad was taken up, height over it, distance aside.
    """

    law: str
    scenario: str
    seed: int
    landed: bool
    seconds: float = np.nan
    down_s: float = np.nan  # to just over the pad, without the wait for a gentle moment
    speed_m_s: float = np.nan
    acceleration_m_s2: float = np.nan
    jerk_m_s3: float = np.nan
    overshoot_m: float = np.nan
    contact_m_s: float = np.nan
    lateral_contact_m: float = np.nan
    authority: RuleAuthority = field(default_factory=RuleAuthority)
    conditions: tuple[Conditions, ...] = ()
    course: FloatArray = field(default_factory=lambda: np.zeros((3, 0)))


def fly(case: tuple[str, str, int, float]) -> Descent:
    """Fly one law over one scenario and seed, with the speed (m/s) of the fixed law, and measure it.

    Raises:
        ConfigError: no such scenario or law.
    """
    law, scenario, seed, fixed_m_s = case
    settings = {"plan": law_settings(law) | {"fixed_speed_m_s": fixed_m_s}}
    return measure(fly_scenario(scenario, seed, settings), law)


def law_settings(law: str) -> dict[str, Any]:
    """What `plan` says for a law."""
    return {"speed_law": "fuzzy", "pace": True} if law == PACED else {"speed_law": law}


def measure(flown: EndedFlight, law: str) -> Descent:
    """What the descent of a flight was like."""
    result = flown.result
    landed = result.outcome is Outcome.LANDED
    began_s = flown.first_s(Phase.APPROACH)
    ended_s = None if began_s is None else flown.contact_s(began_s)
    if began_s is None or ended_s is None or ended_s - began_s < 1.0:
        return Descent(law, result.scenario, result.seed, landed)
    truth = TruthTrack(flown.truth)
    times = np.arange(began_s, ended_s, TRUTH_PERIOD_S)
    offset = truth.at("position", times) - truth.at("pad_position", times)
    velocity = truth.at("velocity", times) - truth.at("pad_velocity", times)
    smooth = [_derivative(velocity, order) for order in range(3)]
    speed, acceleration, jerk = (float(np.linalg.norm(rows, axis=1).max()) for rows in smooth)
    lateral, height = np.hypot(offset[:, 0], offset[:, 1]), -offset[:, 2]
    touchdown = result.touchdown
    return Descent(
        law,
        result.scenario,
        result.seed,
        landed,
        seconds=ended_s - began_s,
        down_s=_first(times, height < WAITING_HEIGHT_M) - began_s,
        speed_m_s=speed,
        acceleration_m_s2=acceleration,
        jerk_m_s3=jerk,
        overshoot_m=_overshoot(times, lateral),
        contact_m_s=np.nan if touchdown is None else touchdown.vertical_speed_m_s,
        lateral_contact_m=np.nan if touchdown is None else touchdown.lateral_error_m,
        authority=authority(flown.kept["plan"], GuidanceConfig().minimum_time_s),
        conditions=tuple(p.conditions for p in flown.kept["plan"] if p.conditions is not None),
        course=np.stack([times - began_s, height, lateral]),
    )


def _derivative(velocity_m_s: FloatArray, order: int) -> FloatArray:
    rows: FloatArray = savgol_filter(
        velocity_m_s, SMOOTHED_OVER, 3, deriv=order, delta=TRUTH_PERIOD_S, axis=0
    )
    return rows


def _first(times_s: FloatArray, mask: Any) -> float:
    return float(times_s[mask][0]) if mask.any() else np.nan


def _overshoot(times_s: FloatArray, lateral_m: FloatArray) -> float:
    """How far (m) it went aside again after it had been over the middle."""
    centred_s = _first(times_s, lateral_m < CENTRED_M)
    return np.nan if np.isnan(centred_s) else float(lateral_m[times_s >= centred_s].max())


def fly_all(scenarios: Sequence[str], seeds: Sequence[int], jobs: int, fixed_m_s: float) -> Iterator[Descent]:
    """All laws over all scenarios and seeds, as they end, in a fixed order.

    Raises:
        ConfigError: no such scenario.
    """
    cases = [(law, scenario, seed, fixed_m_s) for scenario in scenarios for seed in seeds for law in LAWS]
    if jobs == 1:
        yield from map(fly, cases)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(fly, cases)


# ---------------------------------------------------------------- what came of it

FIGURES: Final[tuple[tuple[str, str, Callable[[Descent], float]], ...]] = (
    ("to contact (s)", "{:.1f}", lambda d: d.seconds),
    (f"to {WAITING_HEIGHT_M:g} m (s)", "{:.1f}", lambda d: d.down_s),
    ("speed (m/s)", "{:.2f}", lambda d: d.speed_m_s),
    ("acceleration (m/s²)", "{:.2f}", lambda d: d.acceleration_m_s2),
    ("jerk (m/s³)", "{:.1f}", lambda d: d.jerk_m_s3),
    ("overshoot (m)", "{:.2f}", lambda d: d.overshoot_m),
    ("contact (m/s)", "{:.2f}", lambda d: d.contact_m_s),
    ("beside (cm)", "{:.1f}", lambda d: 100.0 * d.lateral_contact_m),
)


def of_law(descents: Sequence[Descent], law: str) -> list[Descent]:
    """The flights of one law."""
    return [descent for descent in descents if descent.law == law]


def median(descents: Sequence[Descent], figure: Callable[[Descent], float]) -> float:
    """Of one figure, over the flights that have it."""
    values = np.array([figure(descent) for descent in descents])
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else np.nan


def table(descents: Sequence[Descent]) -> Table:
    """Medians and greatest values, a column a law."""
    made = Table(title="from taking the pad up: median (greatest)", title_justify="left")
    made.add_column("")
    for law in LAWS:
        made.add_column(law, justify="right")
    groups = [of_law(descents, law) for law in LAWS]
    made.add_row("landed", *(f"{sum(d.landed for d in own)} of {len(own)}" for own in groups))
    made.add_row("cycles decided", *map(_decided, groups))
    for name, form, figure in FIGURES:
        made.add_row(name, *(_median_and_greatest(own, form, figure) for own in groups))
    return made


def _decided(descents: Sequence[Descent]) -> str:
    decided, cycles = (sum(getattr(d.authority, name) for d in descents) for name in ("decided", "cycles"))
    return f"{decided} of {cycles}"


def _median_and_greatest(descents: Sequence[Descent], form: str, figure: Callable[[Descent], float]) -> str:
    values = [figure(d) for d in descents if np.isfinite(figure(d))]
    return f"{form.format(median(descents, figure))} ({form.format(max(values))})" if values else "-"


CONDITIONS: Final[tuple[tuple[str, str, Callable[[Conditions], float]], ...]] = (
    ("sight (mrad)", "{:.0f}", lambda c: 1e3 * c.sight_rad),
    ("relative speed (m/s)", "{:.2f}", lambda c: c.relative_speed_m_s),
    ("gust (m/s²)", "{:.2f}", lambda c: c.gust_m_s2),
    ("pace", "{:.2f}", lambda c: c.pace),
)


def conditions_table(descents: Sequence[Descent]) -> Table:
    """What the fuzzy speed controller met on each scenario, and the pace it made of that."""
    made = Table(
        title="fuzzy: conditions and pace on the way down: median (10 to 90 %)", title_justify="left"
    )
    made.add_column("scenario")
    for name, _, _ in CONDITIONS:
        made.add_column(name, justify="right")
    made.add_column(f"to {WAITING_HEIGHT_M:g} m (s)", justify="right")
    own = of_law(descents, PACED)
    for scenario in dict.fromkeys(d.scenario for d in own):
        flights = [d for d in own if d.scenario == scenario]
        met = [c for d in flights for c in d.conditions]
        cells = []
        for _, form, figure in CONDITIONS:
            low, mid, high = np.percentile([figure(c) for c in met], (10, 50, 90)) if met else [np.nan] * 3
            cells.append(f"{form.format(mid)} ({form.format(low)} to {form.format(high)})")
        made.add_row(scenario, *cells, f"{median(flights, _down):.1f}")
    return made


def bars(descents: Sequence[Descent]) -> dict[str, bool]:
    """Which of the bars of the fuzzy speed controller hold."""
    own = of_law(descents, "fuzzy")
    held = {
        "lands always": all(d.landed for d in own),
        f"contact <= {SOFT_M_S:g} m/s": all(d.contact_m_s <= SOFT_M_S for d in own),
    }
    for law in ("fixed", "log_polynomial"):
        others = of_law(descents, law)
        for name, figure in (("time", _down), ("jerk", _jerk)):
            words = f"{name} <= {AS_GOOD:g} x {law.replace('_', ' ')}"
            held[words] = median(own, figure) <= AS_GOOD * median(others, figure)
    return held


def _down(descent: Descent) -> float:
    return descent.down_s


def _jerk(descent: Descent) -> float:
    return descent.jerk_m_s3


def draw(descents: Sequence[Descent], path: Path) -> None:
    """The laws themselves, and every descent: height and distance aside over time.

    Raises:
        OSError: it cannot be written.
    """
    figure = Figure(figsize=(14.0, 5.0), dpi=110, layout="constrained")
    laws, height, lateral = figure.subplots(1, 3)
    distance = np.linspace(0.0, 10.0, 200)
    for name in LAWS[:-1]:  # at pace 1 the rules are the rules
        law = load_speed_controller(PlanConfig.model_validate(law_settings(name))).law
        laws.plot(distance, [law(d, 0.0, 0.0) for d in distance.tolist()], color=COLOURS[name], label=name)
    laws.plot([], [], color=COLOURS[PACED], label=f"{PACED}: fuzzy x 0.5 to 1.25")
    laws.set_xlabel("distance (m)")
    laws.set_ylabel("average speed V at rest (m/s)")
    laws.legend()
    for descent in descents:
        style = {"color": COLOURS[descent.law], "linewidth": 0.9, "alpha": 0.8}
        times, up, aside = descent.course
        height.plot(times, up, **style)
        lateral.semilogy(times, np.maximum(aside, 1e-3), **style)
    for axes, label in ((height, "height over the pad (m)"), (lateral, "distance aside (m)")):
        axes.set_xlabel("time since the pad was taken up (s)")
        axes.set_ylabel(label)
        axes.grid(visible=True, alpha=0.25)
    figure.savefig(path)
