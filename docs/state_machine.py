"""Writes docs/reference/state-machine.md, the diagram and the tables of the mission, from its table.

python -m docs.state_machine
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

from companion.base.messages import Action, Phase
from companion.plan.mission.states import Branch, Guard, MissionEvent, State
from companion.plan.mission.table import ANYWHERE, FINAL, IN_AIR, LIVE, ROWS, TABLE

PAGE: Final = Path(__file__).resolve().parent / "reference" / "state-machine.md"
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
mission goes. At most one event acts in a control cycle. Of the events that have a row in the present state
it is the most serious failsafe, else a request that was refused too often, else what the state itself
detects.

Control of the vehicle is *none* until the autopilot grants it and says that it obeys setpoints, then *ours*,
and *released* once it went back to the autopilot or a pilot took it. After that the app requests nothing
more in this mission.
"""
# a search in vain returns control and does nothing else; rows that end in the same branches name it
RETURN_CONTROL: Final = TABLE[State.SEARCH, MissionEvent.TIMEOUT]
RETURN: Final = "return control"
IMPOSSIBLE: Final = """\
An event that stands in neither table for a state cannot occur there. If it occurs all the same, the app
reports it, asks the autopilot to hold its position (to land, if the vehicle stands) and releases control.
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
            "*in the air* is every state from take off to the last hold. The last table says where a",
            "failsafe is ignored.",
            "",
            "## Transitions",
            "",
            f"*{RETURN}* stands for these branches, of which the first that fits is taken:",
            "",
            *return_table(),
            "",
            "All transitions:",
            "",
            *rows_table(),
            "",
            "## Events that are ignored",
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
    yield f"    [*] --> {State.STANDBY.value}"
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


def return_table() -> Iterator[str]:
    """The branches by which control returns to the autopilot."""
    yield "| if | then | asked of the autopilot | control | besides |"
    yield "|---|---|---|---|---|"
    for branch in RETURN_CONTROL:
        yield f"| {' | '.join((_condition(RETURN_CONTROL, branch), *_cells(branch)))} |"


def rows_table() -> Iterator[str]:
    """Every row and branch of the table; a return of control is one line."""
    yield "| event | in | if | then | asked of the autopilot | control | besides |"
    yield "|---|---|---|---|---|---|---|"
    for row in ROWS:
        where = (_words(row.event), _states(row.states))
        returns = row.branches[-len(RETURN_CONTROL) :] == RETURN_CONTROL
        own = row.branches[: -len(RETURN_CONTROL)] if returns else row.branches
        for branch in own:
            yield f"| {' | '.join((*where, _condition(row.branches, branch), *_cells(branch)))} |"
        if returns:
            yield f"| {' | '.join((*where, 'else' if own else '', f'*{RETURN}*', '', '', ''))} |"


def _cells(branch: Branch) -> Iterator[str]:
    yield "stays" if branch.to is None else _name(branch.to)
    yield ", ".join(_request(action) for action in branch.actions)
    yield "" if branch.authority is None else branch.authority.value
    yield ", ".join(effect.value for effect in branch.effects)


def _condition(branches: Sequence[Branch], branch: Branch) -> str:
    if branch.guard is not Guard.ALWAYS:
        return branch.guard.value
    return "else" if len(branches) > 1 else ""


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
    higher = f" {action.height_m:g} m higher" if action.height_m else ""
    return _words(action.kind) + higher + (" by force" if action.force else "")


def _name(state: State) -> str:
    return _words(state)


def _words(name: str) -> str:
    return str(name).replace("_", " ")


if __name__ == "__main__":
    main()
