"""NMEA sentences made by hand, for the receiver's tests."""

from companion.config import GpsConfig
from sitl.devices.neo6m import nmea

BYTE_S = 10.0 / 9600.0


CONFIG = GpsConfig(baud=9600)  # what the hand-made bytes are timed for


def rmc(time: str = "120001.00", status: str = "A", course: str = "90.00") -> bytes:
    return nmea(f"GPRMC,{time},{status},4730.00000,N,00815.00000,W,10.000,{course},070126,,,A")


def gga(time: str = "120001.00", quality: int = 1) -> bytes:
    return nmea(f"GPGGA,{time},4730.00000,N,00815.00000,W,{quality},07,1.50,410.5,M,47.0,M,,")
