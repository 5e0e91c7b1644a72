"""A signal ends a program in order, also at the moments in which it is just opening something."""

import asyncio
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from companion.base.signals import run_until_stopped, signals_held_back, stopping_on_signals

ROOT = Path(__file__).resolve().parents[3]
# a program that is sent a signal right after a function of the standard library has done its work
SENT = """
import asyncio.events, os, signal, sys, tempfile
module, name, number, program, *words = sys.argv[1:]
real = getattr(sys.modules[module], name)

def then_a_signal(*arguments, **named):
    made = real(*arguments, **named)
    os.kill(os.getpid(), int(number))
    return made

setattr(sys.modules[module], name, then_a_signal)
sys.argv = [program, *words]
if program == "companion":
    from companion.cli import main
else:
    from sitl.cli import main
main()
"""
FOLDER_MADE = ("tempfile", "mkdtemp")
LOOP_MADE = ("asyncio.events", "new_event_loop")
SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


def started(
    place: Path, when: tuple[str, str], number: signal.Signals, *words: str
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        (sys.executable, "-c", SENT, *when, str(int(number)), *words),
        cwd=ROOT,
        env={**os.environ, "TMPDIR": str(place), "XDG_STATE_HOME": str(place / "state")},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("when", [FOLDER_MADE, LOOP_MADE])
@pytest.mark.parametrize("number", SIGNALS)
def test_a_simulator_that_is_stopped_as_it_opens_leaves_nothing(
    when: tuple[str, str], number: signal.Signals, tmp_path: Path
) -> None:
    ports = ("--port", "0", "--gcs-port", "0", "--tcp-port", "0")
    done = started(tmp_path, when, number, "companion-sitl", *ports)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize("flies", [("--fly",), ()])
def test_the_app_that_is_stopped_as_it_opens_leaves_no_flight(
    flies: tuple[str, ...], number: signal.Signals, tmp_path: Path
) -> None:
    settings, flights = tmp_path / "settings.yaml", tmp_path / "flights"
    settings.write_text("{plan: {mission: {may_arm: true}}, link: {connection: 'udp:127.0.0.1:9'}}\n")
    words = ("companion", *flies, "--config", str(settings), "--record", str(flights), "--no-ui")
    done = started(tmp_path, LOOP_MADE, number, *words)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "companion: interrupted\n"
    assert [path for path in flights.rglob("*") if path.is_file()] == []


def test_inside_the_loop_a_signal_goes_where_it_was_wanted_last() -> None:
    heard = list[str]()

    async def send() -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        for _ in range(100):
            await asyncio.sleep(0.001)

    async def main() -> None:
        with stopping_on_signals(lambda: heard.append("outer")):
            with stopping_on_signals(lambda: heard.append("inner")):
                await send()
            await send()
        try:
            await send()
        except asyncio.CancelledError:
            heard.append("cancelled")
            raise

    with pytest.raises(KeyboardInterrupt):
        run_until_stopped(main())
    assert heard == ["inner", "outer", "cancelled"]


def test_what_ends_for_another_reason_is_not_taken_for_interrupted() -> None:
    async def main() -> None:
        raise asyncio.CancelledError

    before = [signal.getsignal(number) for number in SIGNALS]
    with pytest.raises(asyncio.CancelledError), signals_held_back():
        run_until_stopped(main())
    assert [signal.getsignal(number) for number in SIGNALS] == before
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, ()) & set(SIGNALS)
