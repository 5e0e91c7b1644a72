"""SITL flights with their score, and many of them in one process: what a campaign's workers run.

`companion flights` reads one request a line from its standard input and answers each with one line on its
standard output, both JSON: {"scenario": ..., "seed": ..., "config": ...} and an `Answer`. Flights are in
virtual time and each is the one that `companion --sitl --fast` flies, to the bit; only the start of Python
and the libraries is shared. The process ends with its standard input, even in the middle of a flight, so it
outlives nobody who started it.
"""

import gc
import os
import sys
import threading
import traceback
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Final

from pydantic import BaseModel, ConfigDict, ValidationError

from companion.config import CONFIG_FOLDER, ConfigError
from companion.flightlog.record import FlightLog
from companion.flightlog.result import Result
from companion.sense.vision.opencv import prepare_opencv
from companion.sim.runner import fly
from companion.sim.scoring import reason, score
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from sitl.firmware.spec import FirmwareSpec

FLIGHTS_HELP: Final = "Fly what is asked for on standard input, one JSON line a flight (a campaign's worker)."


class _Line(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Request(_Line):
    """One flight that is asked for; without `config` the shipped settings."""

    scenario: str
    seed: int
    config: str | None = None
    firmware: FirmwareSpec | None = None


class Answer(_Line):
    """What became of a request: a result with its reason, or a mistake of the user's, or a fault of ours.

    `touchdown_pad_m` is where on the pad: along its heading and to its right.
    """

    result: Result | None = None
    reason: str = ""
    touchdown_pad_m: tuple[float, float] | None = None
    refused: str | None = None
    fault: str | None = None


def fly_request(request: Request) -> Answer:
    """Fly one in virtual time and score it.

    Raises:
        ConfigError: the scenario or the settings are wrong, or do not go together.
    """
    trial = Trial.load(request.scenario, request.seed, firmware=request.firmware)
    path = CONFIG_FOLDER / "companion.yaml" if request.config is None else Path(request.config)
    log = FlightLog(None, start_unix_s=0.0)
    flight = fly(sitl_settings(path, trial, fast=True), trial, log, lambda _status: None, fast=True)
    result = score(trial, flight, log)
    return Answer(result=result, reason=reason(result, flight), touchdown_pad_m=flight.report.touchdown_pad_m)


# ---------------------------------------------------------------- many


def answer(line: bytes) -> Answer:
    """Answer a request, whatever happens: one flight that fails must not end the others."""
    try:
        return fly_request(Request.model_validate_json(line))
    except (ConfigError, ValidationError) as error:
        return Answer(refused=" ".join(str(error).split()))
    except Exception as error:
        traceback.print_exc()
        return Answer(fault=f"{type(error).__name__}: {error}")


def flights_command() -> None:
    """Answer standard input's lines until it ends. Standard output is for answers alone.

    What a library prints by itself (OSQP does, from C) goes to standard error.
    """
    prepare_opencv()
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb", buffering=0) as answers:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        requests: SimpleQueue[bytes] = SimpleQueue()
        # unbuffered: a thread that waits in a buffered read would hold its lock when the process ends
        asked = os.fdopen(os.dup(sys.stdin.fileno()), "rb", buffering=0)
        threading.Thread(target=_read, args=(asked, requests.put, os._exit), daemon=True).start()
        while True:
            line = answer(requests.get()).model_dump_json()
            answers.write(line.encode() + b"\n")
            # a flight's tasks refer to one another: its world of 30 MB goes now, or a dozen pile up
            gc.collect()


def _read(asked: IO[bytes], take: Callable[[bytes], None], end: Callable[[int], None]) -> None:
    """Hand on each line; at the end of the input end the process, which may be flying."""
    for line in asked:
        take(line)
    end(0)
