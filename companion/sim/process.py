"""The simulator as a process of its own, for flights in real time."""

from __future__ import annotations

import asyncio
import json
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from companion.base.errors import ConfigError
from companion.base.messages import Phase
from companion.sim.trial import External, Trial
from sitl.run.process_control import SimulationReport, read_report

START_TIMEOUT_S: Final = 20.0
# an external autopilot may still be booting
EXTERNAL_START_TIMEOUT_S: Final = 60.0
# a firmware that is never ready says so itself before
FIRMWARE_START_TIMEOUT_S: Final = 150.0
WORDS_PERIOD_S: Final = 0.3
END_TIMEOUT_S: Final = 10.0
CLEAR_UP_S: Final = 3.0


class SimulatorError(Exception):
    """The simulator's process failed; the text is the one line to show."""


class SimulatorProcess:
    """The simulator running as a child; it dies with its standard input, so it cannot outlive us."""

    def __init__(self, process: asyncio.subprocess.Process, endpoints: dict[str, Any], words: Path) -> None:
        """Take a child that has said where it listens; `words` is the file of its standard error."""
        self.endpoints = endpoints
        self._process = process
        self._words = words
        self._finished = False
        self._passed_on = 0  # of its words

    @classmethod
    async def start(cls, trial: Trial, folder: Path) -> SimulatorProcess:
        """Start it and wait until it says where it listens; its sockets go into `folder`.

        Raises:
            ConfigError: it ended or said nothing in time; the line is its own.
        """
        words = folder / "stderr"
        # how it learns of the user's autopilot, or of the firmware that flies
        world: tuple[str, ...] = () if trial.firmware is None else trial.firmware.options
        if trial.external is not None:
            world = ("--external", trial.external.world or trial.external.app)
        with words.open("wb") as stderr:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "sitl.cli", "--child", "--scenario", str(trial.path)),
                *("--seed", str(trial.seed), "--folder", str(folder)),
                *world,
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=stderr,
                # Ctrl-C is ours to handle: the vehicle is to be flown to a hold before its world ends
                start_new_session=True,
            )
        simulator = cls(process, {}, words)
        try:
            if trial.external is None:
                # a firmware boots before it is served
                patience_s = START_TIMEOUT_S if trial.firmware is None else FIRMWARE_START_TIMEOUT_S
                simulator.endpoints = await simulator._listen(patience_s)
            else:
                simulator.endpoints = await simulator._find(trial.external)
        except BaseException as error:
            await simulator.kill()
            if isinstance(error, SimulatorError):
                raise ConfigError(f"the simulator did not start: {error}") from error
            raise
        simulator._passed_on = words.stat().st_size
        return simulator

    async def _find(self, external: External) -> dict[str, Any]:
        """Where the world listens, once it has found the vehicle; what it says meanwhile is passed on."""
        passing_on = asyncio.create_task(self._pass_words_on())
        try:
            endpoints = await self._listen(EXTERNAL_START_TIMEOUT_S)
        finally:
            passing_on.cancel()
        if external.world is not None:
            endpoints["link"]["connection"] = external.app
        return endpoints

    async def _pass_words_on(self) -> None:
        """What it waits for, or that it is late: silence would leave a person guessing."""
        with self._words.open(errors="replace") as words:
            words.seek(self._passed_on)
            while self._process.returncode is None:
                print(words.read(), end="", file=sys.stderr, flush=True)
                self._passed_on = words.tell()
                await asyncio.sleep(WORDS_PERIOD_S)

    async def watch(self) -> None:
        """Wait for the end that should not come.

        Raises:
            SimulatorError: it has come.
        """
        passing_on = asyncio.create_task(self._pass_words_on())
        try:
            await self._process.wait()
        finally:
            passing_on.cancel()
        raise SimulatorError(f"the simulator ended in flight: {self._last_words()}")

    async def finish(self, phase: Phase) -> SimulationReport:
        """Have the flight judged and take the report.

        Raises:
            SimulatorError: it has crashed or does not answer.
        """
        assert self._process.stdin is not None
        self._process.stdin.write(f"finish {phase.value}\n".encode())
        self._finished = True
        return read_report(Path((await self._listen(END_TIMEOUT_S))["report"]))

    async def kill(self) -> None:
        """End it, whatever state it is in: it may clear up first."""
        if self._process.returncode is None:
            if not self._finished:
                self._process.terminate()
            with suppress(TimeoutError):
                await asyncio.wait_for(self._process.wait(), CLEAR_UP_S)
        if self._process.returncode is None:
            self._process.kill()
        await self._process.wait()

    async def _listen(self, timeout_s: float) -> dict[str, Any]:
        assert self._process.stdout is not None
        try:
            line = await asyncio.wait_for(self._process.stdout.readline(), timeout_s)
        except TimeoutError as error:
            raise SimulatorError(f"nothing for {timeout_s:g} s: {self._last_words()}") from error
        if not line:
            raise SimulatorError(self._last_words())
        said: dict[str, Any] = json.loads(line)
        return said

    def _last_words(self) -> str:
        words = self._words.read_text(errors="replace").strip().splitlines()
        return words[-1] if words else "no reason given"
