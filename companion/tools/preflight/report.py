"""The preflight check's findings for people (a table) and for programs (JSON). Pure."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict
from typing import Final

from rich.table import Table
from rich.text import Text

from companion.tools.preflight.findings import Finding, FindingState, worst

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
    """All in one line, with the names of what failed."""
    counts = Counter(finding.state for finding in findings)
    detail = ", ".join(f"{counts[state]} {state}" for state in FindingState if counts[state])
    failed = [
        f"{finding.group}: {finding.name}" for finding in findings if finding.state is FindingState.FAIL
    ]
    return f"{detail}; not ready to fly: {', '.join(failed)}" if failed else f"{detail}; nothing fails"


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
