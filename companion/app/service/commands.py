"""`companion status` and `companion order`: what a person asks of the running service."""

import json
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path
from typing import Annotated, Any, Final, NoReturn

import typer
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from companion.app.service.local_socket import listening_elsewhere, where_to_ask
from companion.app.service.systemd import SERVICE, service_state
from companion.base.clock import sleep_s, up_s
from companion.base.errors import ConfigError
from companion.base.messages import OrderKind, OrderOutcome
from companion.base.second_sources import SourceState

STATUS_HELP: Final = """Show what the service does: phase, inputs, estimate, pad, machine, last events.

Exit code 0: healthy; 1: not, and the table says why; 2: no service answers.
"""
ORDER_HELP: Final = """Order the running service to land, to fly, or to stop.

'land' takes over a vehicle that flies, finds the pad, lands and disarms; 'fly' is the whole flight, where
plan.mission.may_arm allows it; 'stop' returns control to the autopilot. Exit code 0: taken (with --wait:
carried out), 1: refused or failed, 2: no service answers.
"""
UNHEALTHY: Final = 1
RUNNING: Final = "a running companion, see 'systemctl status companion'"
# by systemd's word for a service that is installed and does not listen
NOT_LISTENING: Final = {
    "activating": "is starting; expected the same again in some seconds, else 'journalctl --unit companion'",
    "deactivating": "is stopping; expected 'sudo systemctl start companion'",
    "failed": "has failed; expected what 'journalctl --unit companion' says to be mended",
    "inactive": "is stopped; expected 'sudo systemctl start companion'",
}
OF_THE_GROUP: Final = "sudo, or 'sudo usermod -aG companion USER' and a new login"
NOT_OURS: Final = (
    "that is no answer of this version's service; expected its local socket, or a restart after an upgrade"
)
ANSWER_S: Final = 5.0
LONGEST_ANSWER: Final = 1 << 20
WATCH_S: Final = 1.0
SocketOption = Annotated[
    Path | None, typer.Option("--socket", help="The service's local socket.", metavar="PATH")
]


def status_command(
    watch: Annotated[
        bool, typer.Option("--watch", help="Show it every second; wait where no service runs.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="As one line of JSON.")] = False,
    path: SocketOption = None,
) -> None:
    console = Console()
    if watch:
        _watch(path, console, as_json=as_json)
    with _connected(path) as ask:
        report = ask({"request": "status"})
    if as_json:
        print(json.dumps(report))
    else:
        console.print(_table(report))
    raise typer.Exit(UNHEALTHY if report.get("problems", True) else 0)


def _watch(path: Path | None, console: Console, *, as_json: bool) -> NoReturn:
    """Show the status each second until interrupted; where no service runs, wait for one."""
    with Live(console=console, auto_refresh=False) if not as_json else nullcontext() as live:
        while True:
            try:
                with _connected(path) as ask:
                    while True:
                        report = ask({"request": "status"})
                        if live is None:
                            print(json.dumps(report), flush=True)
                        else:
                            live.update(_table(report), refresh=True)
                        sleep_s(WATCH_S)
            except ConfigError as error:
                if live is None:
                    print(json.dumps({"error": str(error)}), flush=True)
                else:
                    live.update(Text(f"waiting: {error}"), refresh=True)
            sleep_s(WATCH_S)


def order_command(
    kind: Annotated[OrderKind, typer.Argument(help="land, fly or stop.")],
    wait: Annotated[bool, typer.Option("--wait", help="Until it is carried out, or failed.")] = False,
    path: SocketOption = None,
) -> None:
    with _connected(path) as ask:
        answer = ask({"request": "order", "kind": kind.value, "until_s": up_s() + ANSWER_S})
        _say(kind, answer)
        if wait and answer["outcome"] == OrderOutcome.IN_PROGRESS:
            answer = ask(None)
            _say(kind, answer)
    taken = {OrderOutcome.ACCEPTED, OrderOutcome.IN_PROGRESS}
    raise typer.Exit(0 if answer["outcome"] in taken else 1)


def _say(kind: OrderKind, answer: dict[str, Any]) -> None:
    words = f": {answer['text']}" if answer["text"] else ""
    typer.echo(f"{kind.value}: {answer['outcome'].replace('_', ' ')}{words}")


class _Asking:
    """A connection to the service: call it with a request, or with None for a further answer."""

    def __init__(self, path: Path, connection: socket.socket) -> None:
        self._path, self._connection = path, connection
        self._lines = connection.makefile("rb")

    def __call__(self, request: dict[str, Any] | None) -> dict[str, Any]:
        try:
            # how an order ends takes as long as the landing
            self._connection.settimeout(None if request is None else ANSWER_S)
            if request is not None:
                self._connection.sendall(json.dumps(request).encode() + b"\n")
            line = self._lines.readline(LONGEST_ANSWER)
        except OSError as error:
            raise ConfigError(f"{self._path}: the service does not answer: {error}") from error
        if not line:
            raise ConfigError(f"{self._path}: the service has ended")
        try:
            answer = json.loads(line)
        except ValueError:
            answer = None
        if not isinstance(answer, dict) or "error" in answer:
            raise ConfigError(f"{self._path}: {NOT_OURS}")
        return answer


@contextmanager
def _connected(path: Path | None) -> Iterator[_Asking]:
    where = where_to_ask() if path is None else path
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)) as connection:
        try:
            connection.settimeout(ANSWER_S)
            connection.connect(str(where))
        except OSError as error:
            raise ConfigError(_no_answer(where, error, chosen=path is not None)) from error
        yield _Asking(where, connection)


def _no_answer(where: Path, error: OSError, *, chosen: bool) -> str:
    """Why nobody takes the call, in a line; not `chosen` by the user, `where` may be the wrong place."""
    reason = f"{where}: {error.strerror or error}"
    if isinstance(error, PermissionError):
        return f"{reason}; expected {OF_THE_GROUP}"
    if not chosen:
        if others := listening_elsewhere(where):
            return f"{reason}; one listens at {', '.join(others)}: expected --socket with its path"
        state = service_state()
        if state is not None and state.load == "loaded" and state.active in NOT_LISTENING:
            return f"{SERVICE} {NOT_LISTENING[state.active]}"
    return f"{reason}; expected {RUNNING}"


# ---------------------------------------------------------------- as text


def _table(report: dict[str, Any]) -> Table:
    try:
        rows = list(_rows(report))
    except (KeyError, TypeError) as error:
        raise ConfigError(f"status: {NOT_OURS}") from error
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim")
    table.add_column()
    for name, words in rows:
        table.add_row(name, words)
    return table


_SOURCE_STYLES: Final = {"refused": "bold red", "differs": "yellow"}


def _rows(r: dict[str, Any]) -> Iterator[tuple[str, str | Text]]:
    problems = r["problems"]
    head = "" if r["order"] else "NOT READY: "  # an order is carried out
    words = Text(head + "; ".join(problems), style="bold red") if problems else Text("healthy", style="green")
    yield "state", words
    order = f", {r['order']}" if r["order"] else ""
    yield "phase", f"{r['phase'].replace('_', ' ')}{order}, up {_duration(r['up_s'])}"
    battery = "" if r["battery_percent"] is None else f", battery {r['battery_percent']:.0f} %"
    armed = "armed" if r["armed"] else "disarmed"
    yield "autopilot", f"{r['autopilot']}, {r['mode']}, {armed}{battery}" if r["autopilot"] else "-"
    for entry in r["inputs"]:
        yield entry["name"], _input(entry)
    yield "estimate", _estimate(r)
    yield "pad", _pad(r)
    for entry in r["sources"]:
        if entry["state"] != SourceState.NOT_MEASURED:
            yield entry["quantity"], Text(entry["words"], style=_SOURCE_STYLES.get(entry["state"], ""))
    if waiting := [e["quantity"] for e in r["sources"] if e["state"] == SourceState.NOT_MEASURED]:
        yield "not measured yet", Text(", ".join(waiting), style="dim")
    for name, latency in r["latency"].items():
        yield (f"exposure to {name}", f"p50 {latency['p50_ms']:.0f} ms, p99 {latency['p99_ms']:.0f} ms")
    yield "late cycles", f"{r['late_cycles_percent']:.1f} %"
    yield "machine", _machine(r["machine"])
    yield "recording", r["recording"] or "-"
    for event in r["events"]:
        yield _age(r["up_s"] - event["time_s"]), event["text"]


def _input(entry: dict[str, Any]) -> str:
    if entry["silent"]:
        return "silent" if entry["age_s"] < 1.0 else f"silent for {_duration(entry['age_s'])}"
    # there is no rate before the first seconds are over
    rate_hz = entry["rate_hz"]
    rate = f"{rate_hz:.{0 if rate_hz >= 1.0 else 1}f} Hz" if rate_hz > 0.0 else "begins"
    shown = f"{rate}, {_age(entry['age_s'])}"
    if not entry.get("refused"):
        return shown
    use = "NOT USED" if entry["unused"] else f"used {entry['used']}"
    return f"{shown}, {use}, refused {entry['refused']}: {entry['reason']}"


def _estimate(r: dict[str, Any]) -> str:
    if not r["aligned"]:
        return "not aligned"
    return (
        f"attitude ±{r['attitude_std_deg']:.1f} deg, velocity ±{r['velocity_std_m_s']:.2f} m/s, "
        f"position ±{r['position_std_m']:.1f} m"
    )


def _pad(r: dict[str, Any]) -> str:
    if r["pad_seen_s"] is None:
        return "not seen"
    return (
        f"lateral offset {r['pad_lateral_m']:.2f} m, {r['pad_height_m']:.2f} m below, {_age(r['pad_seen_s'])}"
    )


def _machine(m: dict[str, Any]) -> str:
    cells = [f"{m['memory_mb']:.0f} MB"]
    if m["cpu_percent"] is not None:
        cells.insert(0, f"{m['cpu_percent']:.0f} % of a core")
    if m["temperature_deg_c"] is not None:
        cells.append(f"{m['temperature_deg_c']:.0f} °C")
    if m.get("clock_mhz") is not None and m["full_clock_mhz"] is not None:
        cells.append(f"{m['clock_mhz']:.0f} of {m['full_clock_mhz']:.0f} MHz")
    if m["disk_free_mb"] is not None:
        cells.append(f"{m['disk_free_mb'] / 1000.0:.1f} GB free")
    return ", ".join(cells)


def _age(age_s: float) -> str:
    return "now" if age_s < 1.0 else f"{_duration(age_s)} ago"


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.0f} h"
