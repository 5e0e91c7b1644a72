"""Going through the checklist: show a step, ask, change, say what was changed."""

import shlex
import sys
from enum import Enum

import typer

from companion.base.errors import ConfigError
from companion.config import CompanionConfig
from companion.tools.setup.machine import BEFORE, Machine
from companion.tools.setup.steps import STEPS, FileChange, Program, Step, StepState


class Answers(Enum):
    """Who answers: nobody (a plan), what the settings need, or the person at the terminal."""

    NONE = "none"
    SUGGESTED = "suggested"
    ASKED = "asked"


def go_through(machine: Machine, config: CompanionConfig, answers: Answers) -> bool:
    if answers is Answers.ASKED and not sys.stdin.isatty():
        raise ConfigError("setup: no terminal to ask at; expected --plan, --yes, or a terminal")
    well, reboot, changed, left = True, False, 0, 0
    for number, look in enumerate(STEPS, 1):
        step = look(machine, config)
        show(number, step)
        if step.state is not StepState.TO_DO:
            continue
        if not _agreed(step, answers):
            left += step.needed
            continue
        done = all(_change(machine, change) for change in step.changes)
        well, reboot = well and done, reboot or step.reboots
        changed, left = changed + done, left + (not done)
    steps = "step" if left == 1 else "steps"
    open_words = f", {left} {steps} that the settings need left open" if left else ""
    typer.echo(f"\n{changed or 'nothing'} changed{open_words}")
    if reboot:
        typer.echo("\nreboot, so that it counts: sudo reboot; then: companion check")
    return well


def show(number: int, step: Step) -> None:
    advice = "" if step.needed or step.state is not StepState.TO_DO else " (the settings do not need it)"
    typer.echo(f"{number}. {step.title}: {step.state}{advice}; {step.detail}")
    for change in step.changes:
        for line in change_lines(change):
            typer.echo(f"     {line}")


def change_lines(change: FileChange | Program) -> list[str]:
    if not isinstance(change, FileChange):
        return [f"run: {shlex.join(change)}"]
    return [
        f"in {change.name}:",
        *(f"  - {line}" for line in change.removed),
        *(f"  + {line}" for line in change.added),
    ]


def _agreed(step: Step, answers: Answers) -> bool:
    if answers is Answers.NONE:
        return False
    if answers is Answers.SUGGESTED:
        return step.needed
    return typer.confirm("   do it?", default=step.needed)


def _change(machine: Machine, change: FileChange | Program) -> bool:
    if isinstance(change, FileChange):
        machine.write(change.name, change.text)
        typer.echo(f"   changed {change.name}; as it was before: {change.name}{BEFORE}")
        return True
    code, told = machine.run(change)
    if code != 0:
        last = told.strip().splitlines()[-1:] or [f"exit code {code}"]
        typer.echo(f"   failed: {shlex.join(change)}: {last[0]}")
        return False
    typer.echo(f"   ran {shlex.join(change)}")
    return True
