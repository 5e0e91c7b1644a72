"""Opening a log: what it is by its first bytes, whatever it is called, and what every replay needs of it."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

from companion.base.messages import ImuSample, MagSample
from companion.config import ConfigError
from companion.flightlog.log_file import log_file
from companion.flightlog.replay.dataflash import read_dataflash
from companion.flightlog.replay.flight_record import FlightRecord
from companion.flightlog.replay.mcap_log import read_mcap
from companion.flightlog.replay.ulog import read_ulog

READERS: Final[dict[bytes, Callable[[Path], FlightRecord]]] = {
    b"\x89MCAP0\r\n": read_mcap,
    b"\xa3\x95": read_dataflash,
    b"ULog\x01\x12\x35": read_ulog,
}
EXPECTED: Final = "expected a flight's folder, a flight.mcap, an ArduPilot .bin or a PX4 .ulg"


def read_log(path: Path) -> FlightRecord:
    """Read a log of ours, of ArduPilot's or of PX4's.

    Raises:
        ConfigError: it is not there, is no such log, or holds nothing to replay.
    """
    path = log_file(path)
    try:
        with path.open("rb") as stream:
            start = stream.read(max(map(len, READERS)))
        reader = next((read for magic, read in READERS.items() if start.startswith(magic)), None)
        if reader is None:
            raise ConfigError(f"{path}: not a flight log; {EXPECTED}")
        record = reader(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; {EXPECTED}") from error
    cut = f" ({record.cut})" if record.cut else ""
    for kind, name in ((ImuSample, "IMU"), (MagSample, "magnetometer")):
        if not any(isinstance(event.item, kind) for event in record.events):
            raise ConfigError(f"{path}: no {name} samples in the log{cut}; the estimators need both")
    return record
