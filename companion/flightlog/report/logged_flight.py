"""What a report needs of a flight's folder: messages, pictures at key moments, how the sensors came.

Times count from the app's first cycle, as in result.json.
"""

import math
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from mcap.records import Message
from pydantic import ValidationError

from companion.base.messages import (
    ActionResult,
    ControlReport,
    FrameReport,
    Notice,
    PadSighting,
    PadState,
    Phase,
    PlanStep,
    Setpoint,
    Truth,
    VehicleState,
)
from companion.config import ConfigError
from companion.flightlog.log_file import OF_A_FOLDER, VERSIONS_RECORD, LogReader, log_name
from companion.flightlog.replay.mcap_log import SAMPLES
from companion.flightlog.result import Result, from_start
from companion.flightlog.summary import ending

RESULT_NAME: Final = "result.json"
KINDS: Final[dict[str, type[Any]]] = {
    "vehicle": VehicleState,
    "pad": PadState,
    "sighting": PadSighting,
    "frame_report": FrameReport,
    "setpoint": Setpoint,
    "plan": PlanStep,
    "notice": Notice,
    "control_report": ControlReport,
    "action_result": ActionResult,
    "truth": Truth,
}
SENSORS: Final[dict[str, type[Any]]] = {**SAMPLES, "frame_report": FrameReport}
# pictures where the height over the pad first is below these, besides those where a phase begins
PICTURE_HEIGHTS_M: Final = (5.0, 2.0, 1.0, 0.5, 0.25)


@dataclass(frozen=True, slots=True)
class Picture:
    """A JPEG, base64 as in the log, and the moment that it shows."""

    time_s: float
    moment: str
    jpeg_base64: str


@dataclass(slots=True)
class SensorRecord:
    """How one sensor's samples came: when they were written, and how old they were by then (s)."""

    arrival_s: list[float] = field(default_factory=list)
    age_s: list[float] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class LoggedFlight:
    """A flight as read from its folder; `result` is None for a flight without truth."""

    name: str
    start_unix_s: float
    kept: dict[str, list[Any]]
    truth: list[Truth]
    pictures: list[Picture]
    sensors: dict[str, SensorRecord]
    settings: dict[str, Any]
    versions: dict[str, str]
    result: Result | None
    cut: bool

    @property
    def outcome(self) -> str:
        """How it ended: the simulator's verdict, else by the last phase of the app's own mission."""
        if self.result is not None:
            return self.result.outcome.value
        if not self.kept.get("plan"):
            return "nothing flown"
        return ending(self.kept["plan"][-1].phase)

    @property
    def title(self) -> str:
        """What was flown and how it ended, in one line."""
        if self.result is not None:
            return f"{self.result.scenario}, seed {self.result.seed}: {self.outcome}"
        return f"{self.name}: {self.outcome}"


def read_flight(path: Path) -> LoggedFlight:
    """Read a flight's folder, or its flight.mcap; a log cut short as far as it goes."""
    reading = _Reading(reader := LogReader(path))
    for topic, message in reader.messages():
        reading.take(topic, message)
    beside = reader.path.parent / RESULT_NAME
    return reading.finish(_result(beside) if reader.path.name in OF_A_FOLDER else None)


def _result(path: Path) -> Result | None:
    try:
        return Result.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        raise ConfigError(f"{path}: is not a result of this program: {str(error).splitlines()[0]}") from error


class _Reading:
    def __init__(self, reader: LogReader) -> None:
        self._reader = reader
        self._kept: dict[str, list[Any]] = defaultdict(list)
        self._sensors: dict[str, SensorRecord] = {}
        self._pictures: list[Picture] = []
        self._moments: list[str] = []
        self._heights_m = list(PICTURE_HEIGHTS_M)
        self._phase = ""
        self._latest_picture: Message | None = None
        # of UTC (s) over the app's clock, by messages that are written the moment they are made
        self._start_unix_s = math.inf

    def take(self, topic: str, record: Message) -> None:
        if topic == "camera":
            self._take_picture(record)
        elif (kind := KINDS.get(topic) or SENSORS.get(topic)) is not None:
            message = self._reader.decoded(kind, topic, record)
            age_s = 1e-9 * record.log_time - message.time_s
            if topic in SENSORS:
                sensor = self._sensors.setdefault(topic, SensorRecord())
                sensor.arrival_s.append(1e-9 * record.log_time)
                sensor.age_s.append(age_s)
            if topic in KINDS:
                self._kept[topic].append(message)
            if topic in ("plan", "pad"):
                self._start_unix_s = min(self._start_unix_s, age_s)
                self._watch_moments(message)

    def _watch_moments(self, message: Any) -> None:
        """Have the next picture shown where a phase begins, or a height is passed in the descent."""
        if isinstance(message, PlanStep):
            if message.phase != self._phase:
                self._phase = message.phase
                self._moments.append(message.phase.replace("_", " "))
        elif self._phase in (Phase.DESCEND, Phase.TOUCHDOWN):
            while self._heights_m and message.height_m < self._heights_m[0]:
                self._moments.append(f"below {self._heights_m.pop(0):g} m")

    def _take_picture(self, record: Message) -> None:
        if self._moments:
            self._keep_picture(record, ", ".join(self._moments))
            self._moments, self._latest_picture = [], None
        else:
            self._latest_picture = record

    def _keep_picture(self, record: Message, moment: str) -> None:
        image = self._reader.content("camera", record)
        exposed_s = image["timestamp"]["sec"] + 1e-9 * image["timestamp"]["nsec"]
        self._pictures.append(Picture(exposed_s, moment, image["data"]))

    def finish(self, result: Result | None) -> LoggedFlight:
        if self._latest_picture is not None:
            self._keep_picture(self._latest_picture, "the last one")
        plans = self._kept.get("plan")
        if not plans:
            raise ConfigError(
                f"{self._reader.path}: holds no flight; expected a flight.mcap that `--record` left"
            )
        unix_s = self._start_unix_s + plans[0].time_s
        kept, truth = from_start(self._kept, self._kept.pop("truth", []))
        for sensor in self._sensors.values():
            sensor.arrival_s = [time_s - unix_s for time_s in sensor.arrival_s]
            sensor.age_s = [age_s - self._start_unix_s for age_s in sensor.age_s]
        return LoggedFlight(
            name=log_name(self._reader.path),
            start_unix_s=unix_s,
            kept=kept,
            truth=truth,
            pictures=[Picture(p.time_s - unix_s, p.moment, p.jpeg_base64) for p in self._pictures],
            sensors=self._sensors,
            settings=self._reader.settings,
            versions=self._reader.metadata.get(VERSIONS_RECORD, {}),
            result=result,
            cut=self._reader.cut,
        )
