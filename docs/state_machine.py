"""Writes docs/reference/state-machine.md, the diagram and the tables of the mission, from its table.

python -m docs.state_machine
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

from companion.base.messages import Action, Phase
from companion.plan.events import MissionEvent
from companion.plan.mission.states import Branch, Guard, State
from companion.plan.mission.table import ANYWHERE, FINAL, IN_AIR, LIVE, ROWS, TABLE

PAGE: Final = Path(__file__).resolve().parent / "reference" / "state-machine.md"
PICTURE: Final = Path(__file__).resolve().parent / "images" / "state-machine.svg"
# column and row of each state in the picture
PLACES: Final[dict[State, tuple[float, float]]] = {
    State.STANDBY: (0, 1),
    State.CONNECT: (0, 0),
    State.ARM: (1, 0),
    State.TAKE_OFF: (2, 0),
    State.WAYPOINT: (3, 0),
    State.ROUTE: (4, 0),
    State.SEARCH: (3, 1),
    State.APPROACH: (4, 1),
    State.DESCEND: (5, 1),
    State.WAIT: (5, 2.1),
    State.RISE: (3.2, 2),
    State.SINK: (4, 3),
    State.SET_DOWN: (2.6, 3),
    State.STAND: (5, 3),
    State.AUTO_LAND: (3.4, 4),
    State.LANDED: (5, 4),
    State.HOLD: (1, 3),
    State.AWAIT_LINK: (1, 2),
    State.ABORT: (1, 4),
}
CELL: Final = (150, 84)
BOX: Final = (108, 36)
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
mission goes. In a control cycle the events act in this order until one changes the state: the failsafes, the
most serious first; then a request that was refused too often; then an event that the state itself detects.
An event acts only if it has a row for the present state. Granted control acts before all others. After a
refused request or a vehicle tipped over no other event of the cycle counts.

Control of the vehicle is *none* until the autopilot grants it and reports that it obeys setpoints. Then it is
*ours*. It is *released* when the app returns it to the autopilot or a pilot takes it. To return it the app
repeats the hold or the LAND until it is granted, up to four times. Meanwhile, in ABORT, it holds by its own
setpoints, unless the row stops them. When a pilot takes the vehicle, what was asked is dropped. Nothing
new is requested in this mission.
"""
# a search in vain returns control and does nothing else; rows that end in the same branches name it
RETURN_CONTROL: Final = TABLE[State.SEARCH, MissionEvent.TIMEOUT]
RETURN: Final = "return control"
IMPOSSIBLE: Final = """\
An event that is in neither table for a state cannot occur there. If it does occur, the app
reports it, asks the autopilot to hold its position (to land, if the vehicle stands) and releases control.
"""


def main() -> None:
    """Write the page."""
    PAGE.write_text(page_text(), encoding="utf-8")
    PICTURE.write_text(picture(), encoding="utf-8")


def page_text() -> str:
    """The whole page."""
    return "\n".join(
        (
            INTRODUCTION,
            "![States and how a flight goes through them](../images/state-machine.svg)",
            "",
            "*Red: states that return control; every state in the air can lead there.*",
            "",
            "<details markdown>",
            "<summary>All transitions as a diagram (Mermaid)</summary>",
            "",
            "```mermaid",
            *diagram(),
            "```",
            "",
            "</details>",
            "",
            "*in the air* is every state from take off to hold and await link. The last table lists",
            "where a failsafe is ignored.",
            "",
            "## Transitions",
            "",
            f"*{RETURN}* stands for these branches; the first whose condition holds is taken:",
            "",
            *return_table(),
            "",
            "All transitions:",
            "",
            *rows_table(),
            "",
            "## Failsafes",
            "",
            "The app checks these in every cycle, the most serious first:",
            ", ".join(_words(event) for event in ANYWHERE) + ".",
            "",
            "If the controller fails and the app ends while it has control, it sends one last request:",
            "LAND if the vehicle is committed to land or stands, otherwise hold.",
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


def picture() -> str:
    """The states and the changes between them as SVG, without those that return control."""
    ends = {State.HOLD, State.AWAIT_LINK, State.ABORT}
    width, height = 6 * CELL[0], 5 * CELL[1]
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif">',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" '
        'orient="auto"><path d="M0 0 8 4 0 8z" fill="#546e7a"/></marker></defs>',
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
    ]
    for source, target in _edges():
        if source not in (target, "in_the_air") and State(target) not in ends:
            parts.append(_arrow(PLACES[State(source)], PLACES[State(target)]))
    for state, place in PLACES.items():
        x, y = _middle(place)
        fill = "#ffcdd2" if state in ends else "#c8e6c9" if state is State.LANDED else "#eceff1"
        parts.append(
            f'<rect x="{x - BOX[0] / 2:g}" y="{y - BOX[1] / 2:g}" width="{BOX[0]}" height="{BOX[1]}" rx="8" '
            f'fill="{fill}" stroke="#546e7a"/>'
            f'<text x="{x:g}" y="{y + 5:g}" font-size="15" text-anchor="middle">{_name(state)}</text>'
        )
    return "\n".join([*parts, "</svg>", ""])


def _middle(place: tuple[float, float]) -> tuple[float, float]:
    return (place[0] + 0.5) * CELL[0], (place[1] + 0.5) * CELL[1]


def _arrow(source: tuple[float, float], target: tuple[float, float]) -> str:
    """A curve from box to box, bent to its right so that two ways do not lie on one another."""
    (x0, y0), (x1, y1) = _middle(source), _middle(target)
    dx, dy = x1 - x0, y1 - y0
    bend = 0.12 * math.hypot(dx, dy)
    length = math.hypot(dx, dy)
    middle = (x0 + x1) / 2 - bend * dy / length, (y0 + y1) / 2 + bend * dx / length
    (ax, ay), (bx, by) = _border((x0, y0), middle), _border((x1, y1), middle)
    return (
        f'<path d="M{ax:.0f} {ay:.0f}Q{middle[0]:.0f} {middle[1]:.0f} {bx:.0f} {by:.0f}" fill="none" '
        'stroke="#546e7a" marker-end="url(#tip)"/>'
    )


def _border(centre: tuple[float, float], towards: tuple[float, float]) -> tuple[float, float]:
    """Where the line from a box's centre leaves the box."""
    dx, dy = towards[0] - centre[0], towards[1] - centre[1]
    share = min((BOX[0] / 2 + 3) / max(abs(dx), 1e-9), (BOX[1] / 2 + 3) / max(abs(dy), 1e-9), 1.0)
    return centre[0] + share * dx, centre[1] + share * dy


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
                    label += f" ({branch.guard.words})"
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
        return branch.guard.words
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
    return _words(action.kind) + higher + (" (by force if refused)" if action.force else "")


def _name(state: State) -> str:
    return _words(state)


def _words(name: str) -> str:
    return str(name).replace("_", " ")


if __name__ == "__main__":
    main()
