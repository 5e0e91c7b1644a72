"""The check over the pad, step by step: what the person is asked to do, and what is made of it. Pure.

The steps are data. A step begins at rest, waits until the vehicle rests elsewhere, judges the move between
the two rests and has the vehicle brought back:

    START ── rest ──► OUT ── rest elsewhere: judged ──► BACK ── rest elsewhere ──► OUT of the next step
                       └── other move than asked: once more, from BACK

Every wait ends by time. `Wizard.step` is called some ten times a second with all samples so far.
"""

import math
from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Literal

from companion.base.geometry import Vector3, add, norm, scale
from companion.tools.pad_check.causes import Evidence, Mounting, likely_cause
from companion.tools.pad_check.judge import (
    CheckAnswer,
    Part,
    judge_compass,
    judge_compass_turn,
    judge_height,
    judge_level,
    judge_pad_level,
    judge_shift,
    judge_tilt,
    judge_turn,
)
from companion.tools.pad_check.moves import (
    LEAST_IMU_SAMPLES,
    REST_S,
    Move,
    RecentSamples,
    StandstillMeans,
    camera_move,
    find_rest,
    imu_move,
    longest_gap_s,
    within,
)

Kind = Literal["lift", "shift", "turn"]
SayKind = Literal["order", "good", "bad", "note"]


@dataclass(frozen=True, slots=True)
class RequestedMove:
    """A move that is asked for: along (or about, for a turn) `axis`, in the vehicle's own axes, FRD."""

    name: str
    kind: Kind
    axis: Vector3
    order: str


STEPS: Final = (
    RequestedMove(
        "up is up", "lift", (0.0, 0.0, -1.0), "Raise it straight up by half a metre and hold it still"
    ),
    RequestedMove(
        "right is right", "shift", (0.0, 1.0, 0.0), "Move it to its right by 20 cm and hold it still"
    ),
    RequestedMove(
        "forward is forward", "shift", (1.0, 0.0, 0.0), "Move it forward by 20 cm and hold it still"
    ),
    RequestedMove(
        "turn right", "turn", (0.0, 0.0, 1.0), "Turn its nose to the right by 45° and hold it still"
    ),
    RequestedMove("roll right", "turn", (1.0, 0.0, 0.0), "Roll it to the right by 15° and hold it still"),
    RequestedMove("nose up", "turn", (0.0, 1.0, 0.0), "Raise its nose by 15° and hold it still"),
)
START_ORDER: Final = "Hold it level and still, half a metre over the middle of the pad"
BACK_ORDER: Final = "Bring it back, level over the middle of the pad, and hold it still"


@dataclass(frozen=True, slots=True)
class Say:
    """Something for the person: an order, a good or a bad answer, or a note."""

    text: str
    kind: SayKind = "note"


# ---------------------------------------------------------------- the wizard

STEP_TIMEOUT_S: Final = 60.0
REMINDER_S: Final = 15.0
UNSEEN_S: Final = 3.0
LEAST_LIFT_M: Final = 0.15
LEAST_SHIFT_M: Final = 0.10
LEAST_TURN_RAD: Final = math.radians(8.0)
BACK_SHARE: Final = 0.5
MOST_REPEATS: Final = 1
# what a step is asked for again for: another move than asked, a move that the IMU has not seen all of
REPEATED: Final[tuple[tuple[Part, ...], ...]] = (("hand",), ("loss",))
# whose answer says nothing of the gyroscope, which the others are held against
UNUSABLE: Final[frozenset[Part]] = frozenset({"imu", "hand", "loss"})
LONGEST_GAP_S: Final = 0.1
# beginning and end of a move pass for rest; so long apart from it nothing of it is left in a mean
SETTLED_S: Final = 0.6
FIRST_REST_S: Final = 2.0 * REST_S


class CheckStage(StrEnum):
    """Where the check is."""

    START = "start"
    OUT = "out"
    BACK = "back"
    END = "end"


@dataclass(frozen=True, slots=True)
class Report:
    """The end: all findings in order, and the likely cause of each that is bad, by its name."""

    findings: tuple[CheckAnswer, ...]
    causes: dict[str, str]  # by the finding's name

    @property
    def passed(self) -> bool:
        return all(finding.passed for finding in self.findings)


class Wizard:
    """One check. `order` is what the person is asked to do now."""

    def __init__(self, mounting: Mounting, now_s: float) -> None:
        self.stage = CheckStage.START
        self.order = START_ORDER
        self.axis: tuple[Kind, Vector3] | None = None
        self._mounting = mounting
        self._evidence = Evidence()
        self._findings: list[CheckAnswer] = []
        self._said: list[Say] = []
        self._number = self._upcoming = self._repeats = 0
        self._base: StandstillMeans | None = None  # the last rest that counted
        self._departing: deque[StandstillMeans] = deque(
            maxlen=50
        )  # rests that are still there, the newest last
        self._arrived_s = math.inf
        self._imu_is_level = True
        self._away_from: StandstillMeans | None = None
        self._rests: list[StandstillMeans] = []  # apart from one another, for the gyroscope's zero
        self._started_s = self._missing_reported_s = self._asked_s = self._reminded_s = now_s
        self._ask(START_ORDER, now_s)

    @property
    def finished(self) -> bool:
        return self.stage is CheckStage.END

    def report(self) -> Report:
        bad = [finding for finding in self._findings if not finding.passed]
        causes = {
            finding.name: "; ".join(likely_cause(p, self._evidence, self._mounting) for p in finding.blamed)
            for finding in bad
        }
        return Report(tuple(self._findings), causes)

    def step(self, samples: RecentSamples, now_s: float, *, mirrored: bool = False) -> list[Say]:
        """Look at the samples and go on; returns what is to be said.

        `mirrored`: the pad has been seen in the mirror image of the frames, and not in the frames.
        """
        if mirrored and not self.finished:
            self._end_blind("only in the mirror image of the frames", "mirror")
        elif not self.finished:
            rest = find_rest(samples, now_s)
            if rest is not None:
                if not self._rests or rest.start_s >= self._rests[-1].end_s:
                    self._rests.append(rest)
                self._take_rest(rest, samples, now_s)
            self._watch(samples, now_s)
        said, self._said = self._said, []
        return said

    # ------------------------------------------------------------ rests

    def _take_rest(self, rest: StandstillMeans, samples: RecentSamples, now_s: float) -> None:
        match self.stage:
            case CheckStage.START:
                if now_s - self._started_s >= FIRST_REST_S:
                    self._start_from(rest, now_s)
            case CheckStage.OUT:
                assert self._base is not None
                if not self._is_elsewhere(self._base, rest, BACK_SHARE):
                    self._departing.append(rest)
                    self._arrived_s = math.inf
                elif self._is_elsewhere(self._base, rest, 1.0):
                    self._arrived_s = min(self._arrived_s, now_s)
                    if now_s - self._arrived_s >= SETTLED_S:
                        self._judge(self._departure(), rest, samples, now_s)
            case CheckStage.BACK:
                assert self._away_from is not None
                if self._is_elsewhere(self._away_from, rest, BACK_SHARE):
                    self._base = rest
                    self._go_out(self._upcoming, now_s)

    def _start_from(self, rest: StandstillMeans, now_s: float) -> None:
        mounting = self._mounting
        self._evidence.low = self._base = rest
        level = judge_level(rest)
        self._imu_is_level = level.passed
        self._found(level)
        self._found(judge_pad_level(rest, imu_is_level=level.passed))
        self._found(judge_compass(rest, mounting.field_ned_ut))
        self._found(judge_height(rest, mounting.range_position_body_m, "low"))
        self._go_out(0, now_s)

    def _is_elsewhere(self, before: StandstillMeans, after: StandstillMeans, share: float) -> bool:
        """Whether a rest is another one than before, by a share of what the step's move has at least."""
        move, kind = camera_move(before, after), STEPS[self._number].kind
        if kind == "turn":
            return norm(move.rotation_rad) >= share * LEAST_TURN_RAD
        return norm(move.displacement_m) >= share * (LEAST_LIFT_M if kind == "lift" else LEAST_SHIFT_M)

    def _departure(self) -> StandstillMeans:
        """The newest rest before the move (the less is integrated) that the move's beginning is not in."""
        assert self._base is not None
        newest_s = self._departing[-1].end_s if self._departing else -math.inf
        settled = (rest for rest in reversed(self._departing) if rest.end_s <= newest_s - SETTLED_S)
        return next(settled, self._base)

    def _rate_bias(self) -> Vector3:
        """The gyroscope's zero: what it says on the mean of all rests, whose sway has no direction."""
        total: Vector3 = (0.0, 0.0, 0.0)
        for rest in self._rests:
            total = add(total, rest.rate_rad_s)
        return scale(total, 1.0 / max(1, len(self._rests)))

    # ------------------------------------------------------------ a step

    def _judge(
        self, before: StandstillMeans, after: StandstillMeans, samples: RecentSamples, now_s: float
    ) -> None:
        step = STEPS[self._number]
        imu = within(samples.imu, before.start_s, after.end_s)
        moves = camera_move(before, after), imu_move(before, after, imu, self._rate_bias())
        finding = self._finding(step, moves, longest_gap_s(imu, before.end_s, after.start_s))
        if finding.blamed in REPEATED and self._repeats < MOST_REPEATS:
            self._repeats += 1
            self._say(f"{step.name}: {finding.detail}; once more", "bad")
            self._bring_back(after, self._number, now_s)
            return
        self._repeats = 0
        self._found(finding)
        if finding.blamed not in REPEATED:
            self._keep(step, before, after, moves)
        if step.kind == "turn" and UNUSABLE.isdisjoint(finding.blamed):
            self._compare(step, before, after, moves[1])
        if step.kind == "lift":
            # the other steps are made up here
            self._base = after
            self._go_out(self._number + 1, now_s)
        else:
            self._bring_back(after, self._number + 1, now_s)

    def _keep(
        self, step: RequestedMove, before: StandstillMeans, after: StandstillMeans, moves: tuple[Move, Move]
    ) -> None:
        """A step's moves as evidence, and the answers that come with it."""
        match step.kind:
            case "lift":
                self._evidence.high, self._evidence.lift = after, moves
                self._found(judge_height(after, self._mounting.range_position_body_m, "high"))
            case "shift":
                self._evidence.shifts.append((step.axis, *moves))
            case "turn":
                self._evidence.turns.append((step.axis, *moves))

    def _compare(
        self, step: RequestedMove, before: StandstillMeans, after: StandstillMeans, imu: Move
    ) -> None:
        """A turn that the gyroscope has right, by the compass and the accelerometer."""
        if step.axis[2] != 0.0:
            self._found(judge_compass_turn(before, after, imu))
        else:
            good = not any("compass" in finding.blamed for finding in self._findings)
            for finding in judge_tilt(step.name, before, after, imu, compass_is_good=good):
                self._found(finding)

    def _finding(self, step: RequestedMove, moves: tuple[Move, Move], gap_s: float) -> CheckAnswer:
        """The answer to a step, moved so by camera and IMU, the IMU with a gap of so long."""
        if gap_s > LONGEST_GAP_S:
            return CheckAnswer(step.name, f"samples of the IMU are missing for {gap_s:.2f} s", ("loss",))
        judge = judge_turn if step.kind == "turn" else judge_shift
        return judge(step.name, step.axis, *moves, imu_is_level=self._imu_is_level)

    def _go_out(self, number: int, now_s: float) -> None:
        """Ask for a step, or end where there is none left."""
        self._number = number
        if number == len(STEPS):
            self._end()
            return
        self.stage, self._arrived_s = CheckStage.OUT, math.inf
        self._departing.clear()
        self.axis = (STEPS[number].kind, STEPS[number].axis)
        self._ask(STEPS[number].order, now_s)

    def _bring_back(self, away: StandstillMeans, upcoming: int, now_s: float) -> None:
        """Ask for the way back; nothing is judged on it."""
        self._away_from, self._upcoming = away, upcoming
        if upcoming == len(STEPS):
            self._end()
            return
        self.stage, self.axis = CheckStage.BACK, None
        self._ask(BACK_ORDER, now_s)

    # ------------------------------------------------------------ time

    def _watch(self, samples: RecentSamples, now_s: float) -> None:
        """Remind, show what is missing, and go on when it takes too long."""
        if self.finished:
            return
        missing = missing_part(samples, now_s)
        if missing is not None and now_s - max(self._missing_reported_s, self._started_s) >= UNSEEN_S:
            self._missing_reported_s = now_s
            self._say(missing, "note")
        if now_s - self._asked_s >= STEP_TIMEOUT_S:
            self._give_up(missing or "no such move was seen", now_s)
        elif missing is None and now_s - self._reminded_s >= REMINDER_S:
            self._reminded_s = now_s
            self._say(self.order, "order")

    def _give_up(self, why: str, now_s: float) -> None:
        """Go on without the step; without the first rest there is nothing to go on with."""
        detail = f"not done within {STEP_TIMEOUT_S:g} s: {why}"
        if self.stage is CheckStage.START:
            self._end_blind(detail, "sight")
        elif self.stage is CheckStage.OUT:
            self._found(CheckAnswer(STEPS[self._number].name, detail, ("sight",)))
            self._go_out(self._number + 1, now_s)
        else:
            self._base = self._away_from
            self._go_out(self._upcoming, now_s)

    def _end_blind(self, detail: str, part: Part) -> None:
        self._found(CheckAnswer("the pad is seen", detail, (part,)))
        self._end()

    def _end(self) -> None:
        self.stage, self.order, self.axis = CheckStage.END, "", None

    # ------------------------------------------------------------ words

    def _ask(self, order: str, now_s: float) -> None:
        self.order = order
        self._asked_s = self._reminded_s = now_s
        self._say(order, "order")

    def _found(self, finding: CheckAnswer) -> None:
        self._findings.append(finding)
        self._say(f"{finding.name}: {finding.detail}", "good" if finding.passed else "bad")

    def _say(self, text: str, kind: SayKind) -> None:
        self._said.append(Say(text, kind))


def missing_part(samples: RecentSamples, now_s: float) -> str | None:
    """What keeps a rest from being found, in words; None when the sensors are there."""
    if not within(samples.sightings, now_s - UNSEEN_S, now_s):
        return "the pad is not seen: hold the camera over it, further up or down, and look at the light"
    if len(within(samples.imu, now_s - REST_S, now_s)) < LEAST_IMU_SAMPLES:
        return "the IMU does not answer: sense.imu.bus, sense.source"
    return None
