"""Our own log, `flight.mcap`: samples, control cycles and recorded states in the order they were written.

Every float is written with all its digits, so what is read here is, to the bit,
what the estimators had.
"""

import math
from pathlib import Path
from typing import Any, Final, TypeVar

from mcap.records import Message
from pydantic import BaseModel

from companion.base.geometry import subtract
from companion.base.messages import (
    PAD_OBSERVATIONS,
    AutopilotAttitude,
    GpsFix,
    ImuSample,
    MagSample,
    PadState,
    RangeSample,
    Truth,
    VehicleState,
)
from companion.config import CameraConfig, CompanionConfig, ConfigError, VehicleConfig, validate_recorded
from companion.flightlog.log_file import VERSIONS_RECORD, LogReader
from companion.flightlog.replay.flight_record import (
    Ask,
    FlightRecord,
    RecordedEvent,
    RecordedReference,
    ReplaySetup,
    Sample,
    known_references,
    known_tracks,
    tracks_of_states,
)
from companion.pad import Pad

SAMPLES: Final[dict[str, type[Sample]]] = {
    "imu": ImuSample,
    "mag": MagSample,
    "gps": GpsFix,
    "range": RangeSample,
    "autopilot_attitude": AutopilotAttitude,
    **PAD_OBSERVATIONS,
}
STATES: Final = {"vehicle": VehicleState, "pad": PadState}
Settings = TypeVar("Settings", bound=BaseModel)


def read_mcap(path: Path) -> FlightRecord:
    """Read a flight of ours."""
    reading = _Reading(reader := LogReader(path))
    for topic, message in reader.messages():
        reading.take(topic, message)
    return reading.finish()


class _Reading:
    def __init__(self, reader: LogReader) -> None:
        self._reader = reader
        self._events: list[RecordedEvent] = []
        self._states: list[VehicleState | PadState] = []
        self._truth: list[Truth] = []
        self._notes: list[str] = []
        self._asked_s = -math.inf
        self._first_ns: int | None = None
        self._newest_ns = 0

    def take(self, topic: str, message: Message) -> None:
        decoded = self._reader.decoded
        if topic == "truth":
            self._truth.append(decoded(Truth, topic, message))
            return
        self._first_ns = message.log_time if self._first_ns is None else self._first_ns
        self._newest_ns = message.log_time
        if topic in SAMPLES:
            arrival_s = 1e-9 * message.log_time
            self._events.append(RecordedEvent(arrival_s, decoded(SAMPLES[topic], topic, message)))
        elif topic == "plan":
            # the first thing that a control cycle writes; a cycle with states has them under the same time
            self._ask(float(self._reader.content(topic, message)["time_s"]), message)
        elif topic in STATES:
            state: VehicleState | PadState = decoded(STATES[topic], topic, message)
            self._ask(state.time_s, message)
            self._states.append(state)
        elif topic == "notice":
            self._take_notice(self._reader.content(topic, message))

    def _ask(self, time_s: float, message: Message) -> None:
        if time_s != self._asked_s:
            self._asked_s = time_s
            self._events.append(RecordedEvent(1e-9 * message.log_time, Ask(time_s)))

    def _take_notice(self, notice: dict[str, Any]) -> None:
        if notice.get("kind") == "record":
            self._notes.append(f"the log says of itself: {notice.get('text')}")

    # ------------------------------------------------------------ the end

    def finish(self) -> FlightRecord:
        seconds = 0.0 if self._first_ns is None else 1e-9 * (self._newest_ns - self._first_ns)
        return FlightRecord(
            kind="companion",
            events=self._events,
            references=known_references(_states_reference(self._states), _truth_reference(self._truth)),
            rig=self._rig(),
            settings=self._reader.settings,
            states=self._states,
            versions=self._reader.metadata.get(VERSIONS_RECORD, {}),
            cut=f"the log is cut after {seconds:.1f} s: read up to there" if self._reader.cut else None,
            notes=self._notes,
        )

    def _rig(self) -> ReplaySetup | None:
        settings = self._reader.settings
        if not settings:
            return None
        source = f"{self._reader.path}: settings"
        missing = {"config", "vehicle", "pad"} - settings.keys()
        if missing:
            raise ConfigError(f"{source}: expected {', '.join(sorted(missing))} among them")
        return ReplaySetup(
            self._recorded(CompanionConfig, settings, "config"),
            self._recorded(VehicleConfig, settings, "vehicle"),
            self._recorded(Pad, settings, "pad"),
            self._recorded(CameraConfig, settings, "camera") if "camera" in settings else None,
        )

    def _recorded(self, model: type[Settings], settings: dict[str, Any], name: str) -> Settings:
        return validate_recorded(model, settings[name], f"{self._reader.path}: settings: {name}", self._notes)


# ---------------------------------------------------------------- what it is held against


def _states_reference(states: list[VehicleState | PadState]) -> RecordedReference:
    vehicles = [state for state in states if isinstance(state, VehicleState)]
    pads = [state for state in states if isinstance(state, PadState)]
    origins = [vehicle.origin for vehicle in vehicles if vehicle.origin is not None]
    return RecordedReference(tracks_of_states(vehicles, pads), origins[-1] if origins else None)


def _truth_reference(truth: list[Truth]) -> RecordedReference:
    """The truth in the air: on the ground the vehicle does not use the estimates."""
    flown = [record for record in truth if not record.in_contact]
    return RecordedReference(
        known_tracks(
            attitude=((t.time_s, t.vehicle_attitude) for t in flown),
            velocity=((t.time_s, t.vehicle_velocity_ned_m_s) for t in flown),
            position=((t.time_s, t.vehicle_position_ned_m) for t in flown),
            pad_position=(
                (t.time_s, subtract(t.pad_position_ned_m, t.vehicle_position_ned_m)) for t in flown
            ),
            pad_velocity=((t.time_s, t.pad_velocity_ned_m_s) for t in flown),
        )
    )
