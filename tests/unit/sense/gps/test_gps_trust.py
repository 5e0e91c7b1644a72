"""Which fixes are believed: NAV-STATUS and NAV-DOP, NAV-SOL alone, a time that stands still."""

import struct

import pymap3d
import pytest

from companion.base.messages import GpsFix
from companion.config import GpsConfig
from companion.sense.gps.baud_rate import SILENCE_S
from companion.sense.gps.neo6m import ABOVE_ELLIPSOID, Neo6m
from sitl.devices.neo6m import nmea, ubx

START_MS = 302_400_200
PLACE = (47.7654321, 8.1234567, 447.0)  # ellipsoid; the sea is 46.5 m higher up there


def posllh(itow: int) -> bytes:
    lat, lon, height = PLACE
    numbers = (itow, round(lon * 1e7), round(lat * 1e7), round(height * 1e3), 400_500, 2500, 3750)
    return ubx(1, 0x02, struct.pack("<IiiiiII", *numbers))


def velned(itow: int) -> bytes:
    return ubx(1, 0x12, struct.pack("<IiiiIIiII", itow, 150, -250, 75, 301, 292, 0, 30, 0))


def sol(itow: int, fix: int = 3, flags: int = 0x0D) -> bytes:
    ecef = [round(float(x) * 100) for x in pymap3d.geodetic2ecef(*PLACE)]
    speed = [round(float(v) * 100) for v in pymap3d.enu2uvw(-2.5, 1.5, -0.75, *PLACE[:2])]
    fields = (itow, 0, 2400, fix, flags, *ecef, 310, *speed, 33, 180, 0, 9, 0)
    return ubx(1, 0x06, struct.pack("<IihBBiiiIiiiIHBBI", *fields))


def status(itow: int, *, ok: bool = True) -> bytes:
    return ubx(1, 0x03, struct.pack("<IBBBBII", itow, 3, 0x0D if ok else 0x0C, 0, 0, 29_000, 60_000))


def dop(itow: int, horizontal: float) -> bytes:
    hundredths = [round(100 * horizontal)] * 7
    return ubx(1, 0x04, struct.pack("<I7H", itow, *hundredths))


class EpochLine:
    """Feeds epochs, five a second."""

    def __init__(self, config: GpsConfig | None = None) -> None:
        self.driver = Neo6m(config or GpsConfig())
        self.itow = START_MS
        self.now_s = 100.0
        self.fixes: list[GpsFix] = []

    def epoch(self, *messages: bytes) -> list[GpsFix]:
        found = self.driver.feed(b"".join(messages), self.now_s)
        self.driver.pending(self.now_s)
        self.itow += 200
        self.now_s += 0.2
        self.fixes += found
        return found

    def whole(self, *more: bytes) -> list[GpsFix]:
        return self.epoch(posllh(self.itow), *more, sol(self.itow), velned(self.itow))


def test_a_fix_that_the_status_calls_bad_is_no_position_and_the_next_is() -> None:
    line = EpochLine()
    assert len(line.whole(status(line.itow))) == 1
    assert line.whole(status(line.itow, ok=False)) == []
    assert len(line.whole(status(line.itow))) == 1
    assert len(line.whole()) == 1


@pytest.mark.parametrize(("horizontal", "believed"), [(1.0, 1), (6.0, 1), (6.01, 0), (99.99, 0)])
def test_a_fix_of_too_few_directions_is_no_position(horizontal: float, believed: int) -> None:
    line = EpochLine(GpsConfig(maximum_hdop=6.0))
    assert len(line.whole(dop(line.itow, horizontal))) == believed
    # on a slow line it comes once a second, and holds until then
    assert len(line.whole()) == believed


def test_an_old_dilution_says_nothing() -> None:
    line = EpochLine()
    assert line.whole(dop(line.itow, 20.0)) == []
    line.now_s += SILENCE_S
    assert len(line.whole()) == 1


def test_the_dilution_of_a_lost_fix_does_not_hold_up_the_next_one() -> None:
    line = EpochLine()
    assert line.epoch(posllh(line.itow), dop(line.itow, 99.99), sol(line.itow, 0, 0), velned(line.itow)) == []
    assert len(line.whole()) == 1


def test_fixes_that_are_not_believed_are_reported() -> None:
    line = EpochLine()
    for _ in range(20):
        line.whole(dop(line.itow, 20.0))
    assert line.driver.problem == "NEO-6M: no fix to trust"


def test_nmea_with_a_poor_dilution_is_no_position() -> None:
    rmc = nmea("GPRMC,120001.00,A,4730.00000,N,00815.00000,W,10.000,90.00,070126,,,A")
    gga = "GPGGA,120001.00,4730.00000,N,00815.00000,W,1,04,{},410.5,M,47.0,M,,"
    assert Neo6m(GpsConfig()).feed(rmc + nmea(gga.format("7.50")), 1.0) == []
    assert len(Neo6m(GpsConfig()).feed(rmc + nmea(gga.format("5.50")), 1.0)) == 1


def test_a_receiver_that_repeats_one_epoch_for_ever_gives_one_fix_and_is_reported() -> None:
    line = EpochLine()
    for _ in range(30):
        line.epoch(posllh(START_MS), sol(START_MS), velned(START_MS))
    assert len(line.fixes) == 1
    assert line.driver.problem == "NEO-6M: no fix"


@pytest.mark.parametrize("length", [0, 4, 8, 27, 29, 51])
def test_a_whole_message_of_the_wrong_length_is_passed_over(length: int) -> None:
    line = EpochLine()
    for message in (0x02, 0x03, 0x04, 0x06, 0x12):
        line.epoch(ubx(1, message, bytes(length)))
    assert line.fixes == []
    assert len(line.whole()) == 1


# ---------------------------------------------------------------- NAV-SOL alone


def test_a_receiver_with_nothing_but_sol_gives_position_and_velocity() -> None:
    line = EpochLine()
    for _ in range(5):
        line.epoch(sol(line.itow), status(line.itow), dop(line.itow, 1.5))
    assert len(line.fixes) == 3  # two epochs to be sure; the last has not ended yet
    fix = line.fixes[0]
    assert (fix.latitude_deg, fix.longitude_deg) == pytest.approx(PLACE[:2], abs=1e-7)
    assert fix.velocity_ned_m_s == pytest.approx((1.5, -2.5, 0.75), abs=0.02)
    assert fix.horizontal_accuracy_m == pytest.approx(3.1)
    # nobody has told the sea level: the ellipsoid's height, and as uncertain as that
    assert fix.altitude_m == pytest.approx(447.0, abs=0.02)
    assert fix.vertical_accuracy_m > 40.0
    assert line.fixes[1].time_s - fix.time_s == pytest.approx(0.2, abs=0.01)
    assert line.driver.problem == f"{line.driver.name}: {ABOVE_ELLIPSOID}"


def test_the_sea_level_is_remembered_from_posllh() -> None:
    line = EpochLine()
    line.whole()
    line.now_s += SILENCE_S
    for _ in range(5):
        line.epoch(sol(line.itow))
    assert line.fixes[-1].altitude_m == pytest.approx(400.5, abs=0.02)
    assert line.fixes[-1].vertical_accuracy_m == pytest.approx(3.1)
    assert ABOVE_ELLIPSOID not in (line.driver.problem or "")


def test_one_epoch_that_has_lost_the_rest_is_not_taken_for_a_habit() -> None:
    line = EpochLine()
    for _ in range(5):
        line.epoch(sol(line.itow))
        line.whole()
    assert len(line.fixes) == 5
    assert all(fix.altitude_m == pytest.approx(400.5) for fix in line.fixes)


@pytest.mark.parametrize(("fix", "flags"), [(0, 0x0D), (2, 0x0D), (3, 0x0C)])
def test_sol_without_a_good_fix_is_no_position(fix: int, flags: int) -> None:
    line = EpochLine()
    for _ in range(5):
        line.epoch(sol(line.itow, fix, flags))
    assert line.fixes == []


def age_s(line: EpochLine) -> float:
    """Of the last fix when it was read."""
    return line.now_s - 0.2 - line.fixes[-1].time_s


def usual_age_s() -> float:
    line = EpochLine()
    line.whole()
    return age_s(line)


def test_a_receiver_clock_that_is_set_with_the_first_fix_does_not_shift_the_fixes() -> None:
    line = EpochLine()
    line.itow += 900  # its own quartz runs ahead until then
    for _ in range(10):
        line.epoch(posllh(line.itow), sol(line.itow, 0, 0), velned(line.itow))
    line.itow -= 900
    line.whole()
    assert age_s(line) == pytest.approx(usual_age_s(), abs=0.005)


def test_a_receiver_clock_that_steps_back_is_followed_within_seconds() -> None:
    line = EpochLine()
    for _ in range(20):
        line.whole()
    line.itow -= 300
    for _ in range(30):
        line.whole()
    assert age_s(line) == pytest.approx(usual_age_s(), abs=0.005)


def test_nmea_knows_no_vertical_speed_and_says_so() -> None:
    rmc = nmea("GPRMC,120001.00,A,4730.00000,N,00815.00000,W,10.000,90.00,070126,,,A")
    gga = nmea("GPGGA,120001.00,4730.00000,N,00815.00000,W,1,08,1.00,410.5,M,47.0,M,,")
    (fix,) = Neo6m(GpsConfig()).feed(rmc + gga, 1.0)
    assert fix.vertical_speed_accuracy_m_s is not None
    assert fix.vertical_speed_accuracy_m_s >= 20.0
