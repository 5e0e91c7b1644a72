"""What the preflight check says of one thing. Pure."""

import json
from collections import Counter
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Final

from rich.table import Table
from rich.text import Text

from companion.base.geometry import Vector3

NO_HINT = ""
TAKEN: Final = "is running and has it: two programs on one device harm both"


class FindingState(StrEnum):
    """How it is; only FAIL keeps a vehicle on the ground."""

    OK = "ok"
    WARNING = "warning"
    FAIL = "fail"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """What a parameter of the autopilot's is, and is to become; `expected` is None where nobody can say.

    `mav_type` is its MAV_PARAM_TYPE.
    """

    system_id: int
    value: float
    expected: float | None
    mav_type: int


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the table: its group, its name, the state, what was found, and what to do about it.

    `detail` of what was not checked says why not. `horizon_rad`: roll and pitch, where it has measured them;
    `place`: latitude and longitude (deg), altitude (m).
    `change` is of a parameter of the autopilot's that differs.
    """

    group: str
    name: str
    state: FindingState
    detail: str
    hint: str = NO_HINT
    horizon_rad: tuple[float, float] | None = None
    place: Vector3 | None = None
    change: ParameterChange | None = None


@dataclass(frozen=True, slots=True)
class FindingGroup:
    """Makes the findings of one group."""

    group: str

    def ok(self, name: str, detail: str) -> Finding:
        """All is well."""
        return Finding(self.group, name, FindingState.OK, detail)

    def warn(self, name: str, detail: str, hint: str) -> Finding:
        """It may fly; a person should know."""
        return Finding(self.group, name, FindingState.WARNING, detail, hint)

    def fail(self, name: str, detail: str, hint: str) -> Finding:
        """It should not fly like that."""
        return Finding(self.group, name, FindingState.FAIL, detail, hint)

    def skip(self, name: str, why: str, hint: str = NO_HINT) -> Finding:
        """It was not looked at."""
        return Finding(self.group, name, FindingState.NOT_CHECKED, why, hint)


def worst(findings: list[Finding]) -> FindingState:
    """The state of all together; what was not checked counts for nothing."""
    states = {finding.state for finding in findings}
    return next(
        (state for state in (FindingState.FAIL, FindingState.WARNING) if state in states), FindingState.OK
    )


def not_looked_at(findings: list[Finding]) -> list[str]:
    looked_at = {finding.group for finding in findings if finding.state is not FindingState.NOT_CHECKED}
    return list(dict.fromkeys(finding.group for finding in findings if finding.group not in looked_at))


# ---------------------------------------------------------------- for people

STYLES: Final = {
    FindingState.OK: "green",
    FindingState.WARNING: "yellow",
    FindingState.FAIL: "bold red",
    FindingState.NOT_CHECKED: "dim",
}


def findings_table(findings: list[Finding]) -> Table:
    """A line each under its group's name; what to do about it stands under what was found."""
    table = Table(title="preflight check", title_justify="left", show_lines=False)
    for heading in ("", "", "found"):
        table.add_column(heading, no_wrap=heading == "", overflow="fold")
    last = ""
    for finding in findings:
        if finding.group != last:
            table.add_section()
            table.add_row("", "", Text(finding.group, "bold"))
            last = finding.group
        table.add_row(Text(finding.state, STYLES[finding.state]), finding.name, _words(finding))
    return table


def _words(finding: Finding) -> Text:
    words = Text(finding.detail)
    return words.append(f"\n→ {finding.hint}", "italic") if finding.hint else words


def summary_line(findings: list[Finding]) -> str:
    """All in one line, with the names of what failed, and of what nobody looked at."""
    counts = Counter(finding.state for finding in findings)
    detail = ", ".join(f"{counts[state]} {state}" for state in FindingState if counts[state])
    failed = [
        f"{finding.group}: {finding.name}" for finding in findings if finding.state is FindingState.FAIL
    ]
    left = not_looked_at(findings)
    verdict = "of what was looked at nothing fails" if left else "nothing fails"
    if any(finding.state is FindingState.NOT_CHECKED and TAKEN in finding.detail for finding in findings):
        verdict = "no preflight check, since a running app has the devices"
    if failed:
        verdict = f"not ready to fly: {', '.join(failed)}"
    return f"{detail}; {verdict}" + (f"; not looked at: {', '.join(left)}" if left else "")


def findings_json(findings: list[Finding]) -> str:
    """`state` (the worst), and the findings in their order."""
    plain = [
        {
            key: value
            for key, value in asdict(finding).items()
            if key not in {"horizon_rad", "place"} and (key != "change" or value is not None)
        }
        for finding in findings
    ]
    return json.dumps({"state": worst(findings), "findings": plain}, indent=2, ensure_ascii=False) + "\n"
