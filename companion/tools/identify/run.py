"""Reads the flights, and shows what was found, what is offered, and what is withheld and why."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.table import Table

from companion.base.command_line import say
from companion.config import ConfigError
from companion.tools.identify.judge import (
    IdentificationLog,
    Identified,
    Judged,
    flown,
    identify,
    is_open,
    read_flight,
)

# settings by direction: of the vehicle, and of the app by velocity setpoints
OWN_LAGS: Final = {"sideways": "acceleration_time_constant_s", "down": "thrust_time_constant_s"}
LAGS: Final = {"sideways": "autopilot_lag_s", "down": "autopilot_climb_lag_s"}
GAINS: Final = {"sideways": "autopilot_velocity_gain_1_s", "down": "autopilot_climb_gain_1_s"}


def identify_and_show(log: Path, check: Path | None) -> bool:
    """Identify a flight and print what it shows; whether nothing was withheld."""
    record = read_flight(log)
    other = None
    if check is not None:
        second = read_flight(check)
        if second.control.setpoint != record.control.setpoint:
            raise ConfigError(
                f"--check {check}: by {second.control.setpoint} setpoints; expected the same kind"
            )
        other = (str(check), flown(second, check))
    data = flown(record, log)
    try:
        found = identify(record, data, other)
    except ConfigError as error:
        raise ConfigError(f"{log}: {error}") from error
    console = Console()
    console.print(response_table(record, found))
    say(console, *notes(found), *prediction_lines(found), *settings_lines(record, found))
    return found.all_hold


def response_table(record: IdentificationLog, found: Identified) -> Table:
    """What was found beside what is assumed, and what becomes of it."""
    grid = Table(title=f"How {record.vehicle.name} answers, by {record.control.setpoint} setpoints")
    for heading in ("", "assumed", "found", "std", "windows", ""):
        grid.add_column(heading, justify="right" if heading else "left")
    for name, judged in found.responses.items():
        if isinstance(judged, str):
            continue
        best, estimate, count = judged.estimate.response, judged.estimate, str(judged.estimate.windows)
        if judged.assumed.gain_1_s > 0.0:
            shown = (
                ("not shown", "")
                if is_open(estimate.gain_std_1_s)
                else (f"{best.gain_1_s:.2f} 1/s", f"{estimate.gain_std_1_s:.2f}")
            )
            changed = judged.adopted.gain_1_s != judged.assumed.gain_1_s
            verdict = _verdict(changed=changed, withheld=judged.withheld)
            grid.add_row(f"{name}: gain", f"{judged.assumed.gain_1_s:.2f} 1/s", *shown, count, verdict)
        changed = judged.adopted.lag_s != judged.assumed.lag_s
        verdict = _verdict(changed=changed, withheld=judged.withheld)
        lag, std = _ms(best.lag_s), _ms(estimate.lag_std_s)
        grid.add_row(f"{name}: lag", _ms(judged.assumed.lag_s), lag, std, count, verdict)
    hover = found.hover
    if not isinstance(hover, str):
        verdict = _verdict(changed=hover.adopted != hover.assumed, withheld=hover.withheld)
        numbers = (f"{hover.assumed:.3f}", f"{hover.found:.3f}", f"{hover.std:.4f}")
        grid.add_row("hover thrust", *numbers, "", verdict)
    # the controller's own estimate at the end of a flight by attitude
    reports = record.messages["control_report"]
    learnt = reports[-1].get("hover_thrust") if record.by_attitude and reports else None
    if learnt is not None:
        grid.add_row(
            "hover thrust, in flight", f"{record.vehicle.hover_thrust:.3f}", f"{learnt:.3f}", "", "", ""
        )
    return grid


def _verdict(*, changed: bool, withheld: bool) -> str:
    if not changed:
        return "as assumed"
    return "withheld" if withheld else "offered"


def _ms(time_s: float) -> str:
    return f"{1e3 * time_s:.0f} ms"


def notes(found: Identified) -> list[str]:
    missing = {**found.responses, "hover thrust": found.hover}
    lines = [f"{name}: {why}" for name, why in missing.items() if isinstance(why, str)]
    for name, judged in found.responses.items():
        if (
            not isinstance(judged, str)
            and is_open(judged.estimate.gain_std_1_s)
            and judged.assumed.gain_1_s > 0.0
        ):
            lines.append(f"{name}: too little excitation for the gain; the lag is what fits the assumed gain")
    return lines


def prediction_lines(found: Identified) -> Iterator[str]:
    """How well the numbers predict, beside those assumed, and what that means."""
    for name, judged in found.responses.items():
        if isinstance(judged, str) or not judged.contradicts:
            continue
        for each in judged.predictions:
            yield (
                f"velocity {name}, half a second ahead in {each.flight}: {each.found:.3f} m/s rms, "
                f"{each.assumed:.3f} as assumed"
            )
        if judged.withheld:
            worse = " and ".join(each.flight for each in judged.predictions if not each.holds)
            yield f"{name}: withheld: what was found predicts {worse} no better than what is assumed"
    hover = found.hover
    if not isinstance(hover, str) and hover.other is not None:
        yield f"hover thrust in the other flight: {hover.other:.3f}"
        if hover.withheld:
            yield "hover thrust: withheld: the other flight is nearer to what is assumed"


def settings_lines(record: IdentificationLog, found: Identified) -> list[str]:
    """The lines for the vehicle's file and the settings."""
    vehicle, control = _numbers(record, found)
    lines = []
    if vehicle:
        lines += [f"# configs/vehicles/{record.vehicle.name}.yaml", *_yaml(vehicle)]
    if control:
        lines += ["# the app's settings", "control:", *(f"  {line}" for line in _yaml(control))]
    if lines:
        return lines
    if found.all_hold:
        return ["nothing found contradicts the settings: they may stay as they are"]
    return ["nothing is offered: leave the settings as they are"]


def _numbers(record: IdentificationLog, found: Identified) -> tuple[dict[str, float], dict[str, float]]:
    vehicle, control = dict[str, float](), dict[str, float]()
    by_velocity = record.control.setpoint == "velocity"
    if not isinstance(found.hover, str) and found.hover.offered != found.hover.assumed:
        vehicle["hover_thrust"] = found.hover.offered
    for name, judged in found.responses.items():
        if not isinstance(judged, Judged):
            continue
        if judged.offered.gain_1_s != judged.assumed.gain_1_s:
            control[GAINS[name]] = judged.offered.gain_1_s
        if judged.offered.lag_s != judged.assumed.lag_s:
            numbers, key = (control, LAGS[name]) if by_velocity else (vehicle, OWN_LAGS[name])
            numbers[key] = judged.offered.lag_s
    return vehicle, control


def _yaml(numbers: dict[str, float]) -> list[str]:
    return [f"{name}: {value:.3f}" for name, value in numbers.items()]
