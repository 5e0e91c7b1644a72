"""`companion --sitl`: a flight against the simulator, from the options to the result and the exit code."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from companion.app.command import EXIT_CODES, Output, must_fly, new_log
from companion.app.terminal import StatusView
from companion.base.autopilot_kind import AutopilotKind
from companion.base.command_line import print_error
from companion.base.errors import ConfigError
from companion.base.files import must_be_writable, write_atomically
from companion.base.messages import Outcome
from companion.base.signals import signals_held_back
from companion.flightlog.report import write_report
from companion.flightlog.report.tables import result_table
from companion.flightlog.result import Result
from companion.sense.vision.opencv import prepare_opencv
from companion.sim.process import SimulatorError
from companion.sim.runner import SitlFlight, fly
from companion.sim.scoring import reason, score
from companion.sim.settings import calibrations_left_out, sitl_settings, vehicle_differs
from companion.sim.trial import External, Trial
from sitl.firmware.spec import FirmwareSpec
from sitl.run.tick_timer import LATE_S

SIMULATOR_FAILED: Final = 1

# an app whose cycles come late more often than this has no time for its samples either
LATE_SHARE: Final = 0.01


def load_trial(
    scenario: str,
    seed: int,
    external: Mapping[str, str | None],
    firmware: tuple[AutopilotKind | None, Path | None, list[str] | None],
    *,
    fast: bool,
) -> Trial:
    kind, program, parameters = firmware
    return Trial.load(
        scenario, seed, External.of(external, fast=fast), FirmwareSpec.of(kind, program, parameters or ())
    )


def fly_in_sitl(config_path: Path, trial: Trial, output: Output, *, fast: bool) -> int:
    """Fly a scenario, show and write its result, and return the exit code."""
    prepare_opencv()
    settings = output.shown(sitl_settings(config_path, trial, fast=fast))
    must_fly(settings, f"--sitl: {config_path}")
    if left_out := calibrations_left_out(config_path, settings):
        output.console.print(f"left out, for the simulated vehicle is another: {', '.join(left_out)}")
    if (differs := vehicle_differs(settings, trial)) is not None:
        output.console.print(differs, style="yellow", highlight=False, markup=False, soft_wrap=True)
    if output.json_file is not None:
        must_be_writable("--json", output.json_file)
    title = f"{trial.scenario.name}, seed {trial.seed}"
    with signals_held_back():
        log = new_log(output.record, virtual=fast)
        try:
            with StatusView(output.console, title, live=output.live) as view:
                flight = fly(settings, trial, log, view, fast=fast)
            for record in flight.report.truth:
                log.write("truth", record, record.time_s)
        except SimulatorError as error:
            return print_error("companion", str(error), SIMULATOR_FAILED)
        except ConfigError:
            log.discard()
            raise
        finally:
            log.close()
    result = score(trial, flight, log)
    publish(trial, result, flight, output)
    return EXIT_CODES[result.outcome]


def publish(trial: Trial, result: Result, flight: SitlFlight, output: Output) -> None:
    """Write the result, print the table, and say in one line what was wrong if something was."""
    bounds = trial.scenario.pass_bounds.model_dump()
    output.console.print(result_table(result, bounds))
    nearest_m = flight.report.nearest_obstacle_m
    if nearest_m is not None:
        output.console.print(f"nearest to an obstacle: {nearest_m:.2f} m from the rotors' tips")
    late = None
    if flight.report.latest_tick_s > LATE_S:
        late = f"the simulator ran up to {flight.report.latest_tick_s:.1f} s late"
    elif flight.late_share > LATE_SHARE:
        late = f"{100.0 * flight.late_share:.0f} % of the control cycles came late"
    if late is not None:
        print(f"companion: {late}: too busy a machine for real time", file=sys.stderr)
    if result.outcome is not Outcome.LANDED:
        print_error("companion", f"{result.outcome}: {reason(result, flight)}", EXIT_CODES[result.outcome])
    text = result.model_dump_json(indent=2) + "\n"  # after the table: the disk may be full
    if output.record is not None:
        write_atomically(output.record / "result.json", text)
        try:
            # where the library that draws its plots is installed: a flight needs none
            write_report(output.record, bounds=bounds)
        except ConfigError as error:
            print(f"companion: no page: {error}", file=sys.stderr)
        output.console.print(f"logs and report in {output.record}", highlight=False, soft_wrap=True)
    if output.json_file is not None:
        write_atomically(output.json_file, text)
