"""ArduPilot's DataFlash log (.bin): IMU, MAG, GPS, RFND; held against ATT and the EKF's own messages.

What ArduPilot logs is ready to use: IMU is calibrated and turned into the board's axes; MAG has offsets,
the DIA/ODI matrix and motor compensation in it (mGauss). What is missing is AHRS_TRIM: its attitude is the
airframe's, its samples are the board's. Older logs name things otherwise (TimeMS, EKF1, UBX3); instances
other than the first are left out.
"""

import contextlib
import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from pymavlink import DFReader

from companion.base.geometry import (
    Quaternion,
    Vector3,
    ned_from_geodetic,
    quat_from_euler,
    quat_rotate,
    scale,
)
from companion.base.messages import GpsFix, ImuSample, MagSample, RangeSample
from companion.config import ConfigError
from companion.flightlog.replay.flight_record import (
    SECONDS_PER_YEAR,
    UT_PER,
    FlightRecord,
    RecordedEvent,
    RecordedReference,
    RecordingPlace,
    Sample,
    antenna_by,
    damage_reported,
    known_references,
    known_tracks,
)

# what the driver assumes of a u-blox receiver when no parameter says otherwise (AP_GPS)
GPS_LATENCY_S: Final = 0.2
# a fix's error, as multiples of HDOP, where the receiver's own figure was not logged
HORIZONTAL_M_PER_HDOP: Final = 2.0
VERTICAL_M_PER_HDOP: Final = 3.0
SPEED_ACCURACY_M_S: Final = 0.3
# newest EKF first; the fields are the same
EKF_MESSAGES: Final = ("XKF1", "NKF1", "EKF1")
SECONDS_PER_WEEK: Final = 604_800.0
GPS_EPOCH_YEAR: Final = 1980.0 + 5.0 / 366.0
DOWNWARD: Final = 25  # MAV_SENSOR_ROTATION_PITCH_270
RANGE_GOOD: Final = 4
KIND: Final = "DataFlash log"


def read_dataflash(path: Path) -> FlightRecord:
    reading = _Reading()
    words = hand_out(path, [*reading.takers], reading.take)
    return reading.finish(_damage(words))


def hand_out(path: Path, kinds: list[str], take: Callable[[Any], None]) -> str:
    """Hand each message of those kinds and of the first instance to `take`.

    Returns:
        What the library said in passing.

    Raises:
        ConfigError: not a DataFlash log, or of `take`.
    """
    words = io.StringIO()
    with (
        contextlib.redirect_stderr(words),
        damage_reported(path, KIND),
        contextlib.closing(_DataFlashLog(str(path))) as log,
    ):
        while (message := log.recv_match(type=kinds)) is not None:
            if getattr(message, "I", getattr(message, "Instance", 0)) == 0:
                take(message)
    return words.getvalue()


class _DataFlashLog(DFReader.DFReader_binary):  # type: ignore[misc]
    """The library's reader, without its quicker index: that one complains past Python's streams."""

    def init_arrays_fast(self, progress_callback: Any = None) -> None:
        self.init_arrays(progress_callback)


def _damage(words: str) -> str | None:
    """What the library said in passing, a line a byte or message that it skipped, as one note."""
    lines = words.splitlines()
    return f"damaged: {len(lines)} bytes or messages passed over, from '{lines[0]}' on" if lines else None


class _Reading:
    """What has been read of one log so far."""

    def __init__(self) -> None:
        self.takers: dict[str, Callable[[Any, float], None]] = {
            "PARM": self._take_parameter,
            "IMU": self._take_imu,
            "MAG": self._take_mag,
            "GPS": self._take_gps,
            "GPA": self._take_accuracy,
            "UBX3": self._take_accuracy,
            "RFND": self._take_range,
            "ATT": self._take_attitude,
            "POS": self._take_position,
            "SIM": self._take_truth,
            **dict.fromkeys(EKF_MESSAGES, self._take_ekf),
        }
        self.parameters: dict[str, float] = {}
        self._events: list[RecordedEvent] = []
        self._newest_s = -math.inf
        self._accuracy: tuple[float, float, float] | None = None
        self._place: RecordingPlace | None = None
        self._attitudes: list[tuple[float, Quaternion]] = []
        self._true_attitudes: list[tuple[float, Quaternion]] = []
        self._true_places: list[tuple[float, Vector3]] = []
        self._places: list[tuple[float, Vector3]] = []
        self._motion: dict[str, list[tuple[float, Vector3, Vector3]]] = {name: [] for name in EKF_MESSAGES}

    def take(self, message: Any) -> None:
        self.takers[message.get_type()](message, _time_s(message))

    def _take_parameter(self, message: Any, _time_s: float) -> None:
        self.parameters[message.Name] = float(message.Value)

    # ------------------------------------------------------------ sensors

    def _arrive(self, time_s: float, sample: Sample) -> None:
        # the file's order is that of arrival; the fields' times are of other clocks' rounding
        self._newest_s = max(self._newest_s, time_s)
        self._events.append(RecordedEvent(self._newest_s, sample))

    def _take_imu(self, m: Any, time_s: float) -> None:
        rate, force = (m.GyrX, m.GyrY, m.GyrZ), (m.AccX, m.AccY, m.AccZ)
        temperature_c = float(getattr(m, "T", getattr(m, "Temp", math.nan)))
        self._arrive(time_s, ImuSample(time_s, self._levelled(rate), self._levelled(force), temperature_c))

    def _take_mag(self, m: Any, time_s: float) -> None:
        if getattr(m, "Health", 1):
            field = scale((m.MagX, m.MagY, m.MagZ), UT_PER["mG"])
            self._arrive(time_s, MagSample(time_s, self._levelled(field)))

    def _levelled(self, board: Vector3) -> Vector3:
        """From the board's axes into the airframe's, which is level where the board is tilted by the trim."""
        roll, pitch = (self.parameters.get(f"AHRS_TRIM_{axis}", 0.0) for axis in "XY")
        return quat_rotate(quat_from_euler(roll, pitch, 0.0), board)

    def _take_accuracy(self, m: Any, _time_s: float) -> None:
        values = {name.lower(): getattr(m, name) for name in m.get_fieldnames()}
        self._accuracy = (float(values["hacc"]), float(values["vacc"]), float(values["sacc"]))

    def _take_gps(self, m: Any, time_s: float) -> None:
        if m.Status < 3:
            return
        course = math.radians(m.GCrs)
        rough = (HORIZONTAL_M_PER_HDOP * m.HDop, VERTICAL_M_PER_HDOP * m.HDop, SPEED_ACCURACY_M_S)
        horizontal_m, vertical_m, speed_m_s = self._accuracy or rough
        fix = GpsFix(
            time_s=time_s - self._gps_latency_s(),
            latitude_deg=m.Lat,
            longitude_deg=m.Lng,
            altitude_m=m.Alt,
            velocity_ned_m_s=(m.Spd * math.cos(course), m.Spd * math.sin(course), m.VZ),
            horizontal_accuracy_m=horizontal_m,
            vertical_accuracy_m=vertical_m,
            speed_accuracy_m_s=speed_m_s,
            satellites=m.NSats,
        )
        self._place = self._place or RecordingPlace(m.Lat, m.Lng, m.Alt, _year(m))
        self._arrive(time_s, fix)

    def _gps_latency_s(self) -> float:
        """From the fix to its arrival, by the parameter of whichever version wrote the log."""
        names = ("GPS1_DELAY_MS", "GPS_DELAY_MS", "EKF_VEL_DELAY")
        given = [self.parameters[name] for name in names if self.parameters.get(name, 0.0) > 0.0]
        return 1e-3 * given[0] if given else GPS_LATENCY_S

    def _take_range(self, m: Any, time_s: float) -> None:
        orientation = getattr(m, "Orient", getattr(m, "Orient1", DOWNWARD))
        if orientation == DOWNWARD and getattr(m, "Stat", RANGE_GOOD) == RANGE_GOOD:
            self._arrive(
                time_s, RangeSample(time_s, float(getattr(m, "Dist", getattr(m, "Dist1", math.nan))))
            )

    # ------------------------------------------------------------ what it is held against

    def _take_attitude(self, m: Any, time_s: float) -> None:
        self._attitudes.append((time_s, _attitude(m)))

    def _take_position(self, m: Any, time_s: float) -> None:
        self._places.append((time_s, (m.Lat, m.Lng, m.Alt)))

    def _take_ekf(self, m: Any, time_s: float) -> None:
        # the second and third core of an EKF are marked in a field of their own
        if getattr(m, "C", 0) == 0:
            row = (time_s, (m.VN, m.VE, m.VD), (m.PN, m.PE, m.PD))
            self._motion[m.get_type()].append(row)

    def _take_truth(self, m: Any, time_s: float) -> None:
        self._true_attitudes.append((time_s, _attitude(m)))
        self._true_places.append((time_s, (m.Lat, m.Lng, m.Alt)))

    # ------------------------------------------------------------ the end

    def finish(self, damage: str | None) -> FlightRecord:
        motion = next((rows for name in EKF_MESSAGES if (rows := self._motion[name])), [])
        recorded = _reference(self._attitudes, self._places)
        local = known_tracks(
            velocity=((time_s, velocity) for time_s, velocity, _ in motion),
            position=((time_s, position) for time_s, _, position in motion),
        )
        recorded = RecordedReference(local | recorded.tracks, recorded.origin)
        return FlightRecord(
            kind="ardupilot",
            events=self._events,
            references=known_references(recorded, _reference(self._true_attitudes, self._true_places)),
            place=self._place,
            antenna_position_body_m=antenna_by(self.parameters, "GPS1_POS_", "GPS_POS1_"),
            notes=[damage] if damage else [],
        )


def _reference(
    attitudes: list[tuple[float, Quaternion]], places: list[tuple[float, Vector3]]
) -> RecordedReference:
    known = [(time_s, place) for time_s, place in places if place[0] or place[1]]
    tracks = known_tracks(
        attitude=attitudes,
        position=((time_s, ned_from_geodetic(*place, known[0][1])) for time_s, place in known),
    )
    return RecordedReference(tracks, known[0][1] if "position" in tracks else None)


def _attitude(m: Any) -> Quaternion:
    return quat_from_euler(math.radians(m.Roll), math.radians(m.Pitch), math.radians(m.Yaw))


def _time_s(m: Any) -> float:
    """Since boot; the old GPS message keeps the receiver's time in TimeMS and ours in T."""
    if hasattr(m, "TimeUS"):
        return 1e-6 * float(m.TimeUS)
    if m.get_type() == "GPS":
        return 1e-3 * float(m.T)
    if m.get_type() == "PARM":
        return 0.0  # as before all else: versions before 3.3 do not say
    if not hasattr(m, "TimeMS"):
        raise ConfigError(f"{m.get_type()} has no time; expected a log of ArduPilot 3.2 (2014) or newer")
    return 1e-3 * float(m.TimeMS)


def _year(m: Any) -> float:
    """The date as a decimal year, of the GPS's week and time of week; leap seconds do not matter here."""
    week_s = 1e-3 * float(getattr(m, "GMS", getattr(m, "TimeMS", 0.0)))
    week = float(getattr(m, "GWk", getattr(m, "Week", 0.0)))
    return GPS_EPOCH_YEAR + (week * SECONDS_PER_WEEK + week_s) / SECONDS_PER_YEAR
