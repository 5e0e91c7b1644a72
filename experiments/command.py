"""`python -m experiments`: the paper's figures from its own settings.

Only the options are here. What flies and draws is imported once they are right.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from companion.base.command_line import Command, VersionOption, lazy_app, run_program
from companion.base.files import find_file, must_be_writable
from experiments import PROFILED

if TYPE_CHECKING:
    from rich.console import Console

PROGRAM: Final = "python -m experiments"
COMMANDS: Final = {
    "fig14": Command(
        "experiments.fig14.command:fig14",
        "MPC, the paper's recursion and PID on one minimum-jerk reference (Fig. 14).",
    )
}
# no completion: a shell completes programs, not modules
app = lazy_app(COMMANDS, no_args_is_help=True, add_completion=False)


@app.callback()
def experiments(*, version: VersionOption = False) -> None:
    """The paper's experiments, each with a table and a plot."""


Picture = Annotated[Path, typer.Option("--output", "-o", help="Where the picture goes.", metavar="FILE.png")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Repeats the experiment.")]


@app.command("fig13")
def fig13_command(
    *,
    scenario: Annotated[str, typer.Option(help="A name in configs/scenarios, or a file.")] = "circle",
    seed: Seed = 0,
    output: Picture = Path("fig13.png"),
) -> None:
    """Fig. 13: the EKF's position beside the GPS's and the truth, in a simulated flight."""
    find_file("scenarios", scenario)
    must_be_writable("--output", output, ".png")
    from rich.console import Console  # noqa: PLC0415

    from experiments import fig13  # noqa: PLC0415
    from experiments.flown import fly_scenario  # noqa: PLC0415

    observed = fig13.observe(fly_scenario(scenario, seed))
    fig13.draw(observed, output)
    console = Console()
    console.print(fig13.table(observed))
    console.print(fig13.EXPLANATION, highlight=False)
    finish(console, {"EKF's path and noise": observed.holds()}, output)


@app.command("profiles")
def profiles_command(
    *,
    scenarios: Annotated[
        list[str],
        typer.Option(
            "--scenario", help="A name in configs/scenarios, or a file; again for more.", metavar="NAME"
        ),
    ] = list(PROFILED),  # noqa: B006 - typer's way to give a list a default
    seed: Seed = 0,
    flights: Annotated[int, typer.Option(min=1, help="Of each law in each scenario.")] = 3,
    jobs: Annotated[int, typer.Option(min=1, help="Processes that fly.")] = 1,
    fixed_speed: Annotated[float, typer.Option(min=0.2, max=3.0, help="Of the fixed law, m/s.")] = 0.9,
    output: Picture = Path("profiles.png"),
) -> None:
    """Descents by the fuzzy speed controller, a fixed speed and a log polynomial, in whole flights."""
    for scenario in scenarios:
        find_file("scenarios", scenario)
    must_be_writable("--output", output, ".png")
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import track  # noqa: PLC0415

    from experiments import profiles  # noqa: PLC0415

    console, count = Console(), len(profiles.LAWS) * len(scenarios) * flights
    flown = profiles.fly_all(scenarios, range(seed, seed + flights), jobs, fixed_speed)
    descents = list(track(flown, "flying", total=count, console=console, disable=not console.is_terminal))
    profiles.draw(descents, output)
    console.print(profiles.table(descents))
    console.print(profiles.conditions_table(descents))
    finish(console, profiles.bars(descents), output)


@app.command("table1")
def table1_command(
    *,
    pad: Annotated[str, typer.Option(help="A name in configs/pads, or a file.")] = "moving_1300",
    camera: Annotated[str, typer.Option(help="A name in configs/cameras, or a file.")] = "hd_1280x720",
    frames: Annotated[int, typer.Option(min=10, help="From each height.")] = 100,
    seed: Seed = 0,
) -> None:
    """Table 1: several markers against a single one, recall and precision in rendered frames."""
    find_file("pads", pad)
    find_file("cameras", camera)
    from rich.console import Console  # noqa: PLC0415

    from experiments import table1  # noqa: PLC0415

    console, cells = Console(), table1.look(pad, camera, frames, seed)
    console.print(table1.table(cells))
    finish(console, table1.bars(cells))


@app.command("pad-recall")
def pad_recall_command(
    *,
    camera: Annotated[str, typer.Option(help="A name in configs/cameras, or a file.")] = "sitl_640x480",
    other: Annotated[str, typer.Option(help="Another, to judge the fit.")] = "hd_1280x720",
    frames: Annotated[int, typer.Option(min=20, help="Of each marker and lens.")] = 400,
    seed: Seed = 0,
    output: Picture = Path("pad-recall.png"),
) -> None:
    """Fit how surely vision reads a marker: what `companion pad --coverage` goes by."""
    for name in (camera, other):
        find_file("cameras", name)
    must_be_writable("--output", output, ".png")
    from rich.console import Console  # noqa: PLC0415

    from experiments import pad_recall  # noqa: PLC0415

    console = Console()
    looks = pad_recall.look(camera, frames, seed)
    model = pad_recall.fit(looks)
    console.print(repr(model), highlight=False, soft_wrap=True)
    judged = {
        "fitted to": pad_recall.classes(looks, model),
        "other frames": pad_recall.classes(pad_recall.look(camera, frames // 2, seed + 1), model),
        other: pad_recall.classes(pad_recall.look(other, frames // 4, seed + 2), model),
    }
    console.print(pad_recall.table(judged))
    pad_recall.draw(looks, model, output)
    finish(console, pad_recall.bars(judged), output)


@app.command("tune-flight-pid")
def tune_command(
    *,
    draws: Annotated[int, typer.Option(min=1, help="Gains tried in each of three rounds.")] = 12,
    seed: Seed = 0,
) -> None:
    """Tune the gains of control.pid (a few minutes), and fly them on seeds that tuned nothing."""
    from rich.console import Console  # noqa: PLC0415

    from experiments import tune_flight_pid  # noqa: PLC0415

    console = Console()
    pid = tune_flight_pid.tune(draws, seed, lambda line: console.print(line, highlight=False))
    tune_flight_pid.show(pid, console)


def finish(console: Console, bars: Mapping[str, bool], output: Path | None = None) -> None:
    """Say which bars hold and where the picture is, if there is one; the exit status is 0 when all do.

    Raises:
        typer.Exit: always.
    """
    words = ", ".join(f"{name} {'holds' if holds else 'FAILS'}" for name, holds in bars.items())
    if output is not None:
        console.print(f"picture: {output}", highlight=False, soft_wrap=True, markup=False)
    console.print(f"bars: {words}", highlight=False, soft_wrap=True)
    raise typer.Exit(0 if all(bars.values()) else 1)


def main() -> None:
    """Run an experiment: whatever the user got wrong ends in one line on standard error."""
    run_program(app, PROGRAM)
