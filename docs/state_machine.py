"""Writes docs/state-machine.md, the diagram and the tables of the mission's state machine, from its table.

python -m docs.state_machine
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from companion.base.messages import Action, Phase
from companion.plan.mission.states import Branch, Guard, MissionEvent, State, TableRow
from companion.plan.mission.table import ANYWHERE, FINAL, IN_AIR, LIVE, ROWS

PAGE: Final = Path(__file__).resolve().parent / "state-machine.md"
# these may come in any state: drawn once, not from each
FAILSAFES: Final = frozenset(ANYWHERE) - {MissionEvent.TIMEOUT, MissionEvent.LINK_UP}
PARTS: Final = {
    phase: tuple(state for state in State if state.phase is phase)
    for phase in Phase
    if sum(state.phase is phase for state in State) > 1
}
INTRODUCTION: Final = """\
# The state machine

Written by `python -m docs.state_machine` from `companion/plan/mission/table.py`, which alone decides where a
mission goes. At most one event moves it in a cycle: of those that mean something in the present state the
gravest failsafe, else a request that was refused too often, else what the state itself detects.

Control of the vehicle is *none* until the autopilot grants it and says that it obeys setpoints, then *ours*,
and *released* once it went back to the autopilot or a pilot took it. Released is for good: nothing is asked
any more.
"""
IMPOSSIBLE: Final = """\
What stands in neither table cannot happen. Should it all the same, the app says so and holds: it asks the
autopilot to hold its position (to land, if it stands) and releases control.
"""


def main() -> None:
    """Write the page."""
    PAGE.write_text(page_text(), encoding="utf-8")


def page_text() -> str:
    """The whole page."""
    return "\n".join(
        (
            INTRODUCTION,
            "```mermaid",
            *diagram(),
            "```",
            "",
            "*in the air* is every state from take off to the last hold; what a failsafe omits stands below.",
            "",
            "## What follows",
            "",
            *rows_table(),
            "",
            "## What means nothing",
            "",
            *exceptions_table(),
            "",
            IMPOSSIBLE,
        )
    )


# ---------------------------------------------------------------- the diagram


def diagram() -> Iterator[str]:
    """Lines of a mermaid state diagram."""
    yield "stateDiagram-v2"
    yield '    state "in the air" as in_the_air'
    for state in State:
        if _name(state) != state.value and state.phase not in PARTS:
            yield f'    state "{_name(state)}" as {state.value}'
    for phase, parts in PARTS.items():
        group = f"{phase.value}_phase"
        yield f'    state "{phase.value}" as {group} {{'
        yield from (f'        state "{_name(part)}" as {part.value}' for part in parts)
        yield "    }"
    yield f"    [*] --> {State.CONNECT.value}"
    for (source, target), labels in _edges().items():
        yield f"    {source} --> {target}: {', '.join(labels)}"
    for state in sorted(FINAL):
        yield f"    {state.value} --> [*]"


def _edges() -> dict[tuple[str, str], list[str]]:
    edges: dict[tuple[str, str], list[str]] = {}
    for row in ROWS:
        many = row.event in FAILSAFES and len(row.states) > len(IN_AIR) // 2
        sources = ["in_the_air"] if many else [s.value for s in State if s in row.states]
        for branch in row.branches:
            for source in sources:
                target = source if branch.to is None else branch.to.value
                label = _words(row.event)
                if branch.guard in {Guard.TRIES_LEFT, Guard.CONTROL_OURS}:
                    label += f" ({branch.guard.value})"
                listed = edges.setdefault((source, target), [])
                if label not in listed:
                    listed.append(label)
    return edges


# ---------------------------------------------------------------- the tables


def rows_table() -> Iterator[str]:
    """Every row and branch of the table."""
    yield "| event | in | if | then | asked of the autopilot | control | besides |"
    yield "|---|---|---|---|---|---|---|"
    for row in ROWS:
        for branch in row.branches:
            yield f"| {' | '.join(_cells(row, branch))} |"


def _cells(row: TableRow, branch: Branch) -> Iterator[str]:
    yield _words(row.event)
    yield _states(row.states)
    yield _condition(row, branch)
    yield "stays" if branch.to is None else _name(branch.to)
    yield ", ".join(_request(action) for action in branch.actions)
    yield "" if branch.authority is None else branch.authority.value
    yield ", ".join(effect.value for effect in branch.effects)


def _condition(row: TableRow, branch: Branch) -> str:
    if branch.guard is not Guard.ALWAYS:
        return branch.guard.value
    return "else" if len(row.branches) > 1 else ""


def exceptions_table() -> Iterator[str]:
    """Where an event may arise and is passed over."""
    yield "| event | in | because |"
    yield "|---|---|---|"
    for row in ROWS:
        for reason in dict.fromkeys(row.except_.values()):
            states = frozenset(s for s, r in row.except_.items() if r == reason)
            yield f"| {_words(row.event)} | {_states(states)} | {reason} |"


def _states(states: frozenset[State]) -> str:
    """Names in the order of a flight; those that are missing where they are fewer."""
    for whole, name in ((LIVE, "all"), (IN_AIR, "all in the air")):
        missing = whole - states
        if states <= whole and len(missing) < len(whole) // 2:
            return name if not missing else f"{name} but {_list(missing)}"
    return _list(states)


def _list(states: Iterable[State]) -> str:
    listed = frozenset(states)
    return ", ".join(_name(state) for state in State if state in listed)


def _request(action: Action) -> str:
    return _words(action.kind) + (" by force" if action.force else "")


def _name(state: State) -> str:
    return _words(state)


def _words(name: str) -> str:
    return str(name).replace("_", " ")


if __name__ == "__main__":
    main()
