"""The check's result for people (a table) and for programs (JSON)."""

from __future__ import annotations

import json

from rich.table import Table

from companion.tools.pad_check.wizard import Report


def report_table(report: Report) -> Table:
    """A line for each question."""
    table = Table(title="check over the pad", title_justify="left", show_lines=False)
    for heading in ("", "question", "measured"):
        table.add_column(heading)
    for finding in report.findings:
        table.add_row("[green]ok[/]" if finding.passed else "[bold red]NO[/]", finding.name, finding.detail)
    return table


def cause_lines(report: Report) -> list[str]:
    """What to correct, one line a cause, with the questions that it answers."""
    questions: dict[str, list[str]] = {}
    for name, cause in report.causes.items():
        questions.setdefault(cause, []).append(name)
    return [f"{', '.join(names)}: {cause}" for cause, names in questions.items()]


def verdict_line(report: Report) -> str:
    """All in one line."""
    bad = sum(not finding.passed for finding in report.findings)
    if not bad:
        return (
            f"all {len(report.findings)} answers are right: right is right, forward is forward, down is down"
        )
    return f"{bad} of {len(report.findings)} answers are wrong: not ready to fly"


def report_json(report: Report) -> str:
    """The result as JSON: `passed`, and for each question `name`, `passed`, `detail`, `values`, `cause`."""
    checks = [
        {
            "name": finding.name,
            "passed": finding.passed,
            "detail": finding.detail,
            "blamed": list(finding.blamed),
            "cause": report.causes.get(finding.name),
            "values": {name: round(value, 4) for name, value in finding.values.items()},
        }
        for finding in report.findings
    ]
    return json.dumps({"passed": report.passed, "checks": checks}, indent=2, ensure_ascii=False) + "\n"
