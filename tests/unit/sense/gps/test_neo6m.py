"""The NEO-6M's driver on hand-made bytes: UBX, NMEA, and what a line does to them."""

import math
import struct

import numpy as np
import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.messages import GpsFix
from companion.config import GpsConfig
from companion.sense.gps.commands import SILENCE_S
from companion.sense.gps.fixes import EpochClock
from companion.sense.gps.framing import FrameSplitter
from companion.sense.gps.neo6m import ABOVE_ELLIPSOID, Neo6m
from sitl.devices.neo6m import nmea, ubx

BYTE_S = 10.0 / 9600.0


CONFIG = GpsConfig(baud=9600)  # what the hand-made bytes are timed for


def rmc(time: str = "120001.00", status: str = "A", course: str = "90.00") -> bytes:
    return nmea(f"GPRMC,{time},{status},4730.00000,N,00815.00000,W,10.000,{course},070126,,,A")


def gga(time: str = "120001.00", quality: int = 1) -> bytes:
    return nmea(f"GPGGA,{time},4730.00000,N,00815.00000,W,{quality},07,1.50,410.5,M,47.0,M,,")


# ---------------- The NEO-6M's driver on hand-made bytes: UBX, NMEA, and what a line does to them

TIME_OF_WEEK_MS = 302_400_200


def posllh(itow: int = TIME_OF_WEEK_MS) -> bytes:
    return ubx(1, 0x02, struct.pack("<IiiiiII", itow, -75_1234567, 47_7654321, 447_000, 400_500, 2500, 3750))


def velned(itow: int = TIME_OF_WEEK_MS) -> bytes:
    return ubx(1, 0x12, struct.pack("<IiiiIIiII", itow, 150, -250, 75, 301, 292, 0, 30, 0))


def sol(itow: int = TIME_OF_WEEK_MS, fix: int = 3, flags: int = 0x0D) -> bytes:
    fields = (itow, 0, 2400, fix, flags, 0, 0, 0, 0, 0, 0, 0, 0, 180, 0, 9, 0)
    return ubx(1, 0x06, struct.pack("<IihBBiiiIiiiIHBBI", *fields))


def fixes(data: bytes) -> list[GpsFix]:
    return Neo6m(CONFIG).feed(data, 100.0)


# ---------------------------------------------------------------- UBX


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0)])
def test_three_messages_of_one_epoch_make_one_fix(order: tuple[int, int, int]) -> None:
    parts = (posllh(), velned(), sol())
    (fix,) = fixes(b"".join(parts[k] for k in order))
    assert fix.latitude_deg == pytest.approx(47.7654321, abs=1e-9)
    assert fix.longitude_deg == pytest.approx(-75.1234567, abs=1e-9)
    assert fix.altitude_m == pytest.approx(400.5)  # above mean sea level, not the ellipsoid's 447
    assert fix.velocity_ned_m_s == pytest.approx((1.5, -2.5, 0.75))
    assert (fix.horizontal_accuracy_m, fix.vertical_accuracy_m) == pytest.approx((2.5, 3.75))
    assert fix.speed_accuracy_m_s == pytest.approx(0.3)
    assert fix.satellites == 9


def test_messages_of_two_epochs_are_not_joined() -> None:
    later = TIME_OF_WEEK_MS + 200
    assert fixes(posllh() + velned() + sol(later)) == []
    assert len(fixes(posllh() + sol(later) + posllh(later) + velned(later))) == 1


@pytest.mark.parametrize(("fix", "flags"), [(0, 0x0D), (1, 0x0D), (2, 0x0D), (5, 0x0D), (3, 0x0C)])
def test_no_three_dimensional_fix_is_no_position(fix: int, flags: int) -> None:
    assert fixes(posllh() + velned() + sol(fix=fix, flags=flags)) == []


def test_time_is_the_epochs_less_transmission_and_latency() -> None:
    """All 140 bytes read at 100 s in one piece: the first bit left 140 byte times before."""
    data = posllh() + velned() + sol()
    (fix,) = fixes(data)
    assert len(data) == 140
    assert fix.time_s == pytest.approx(100.0 - len(data) * BYTE_S - CONFIG.latency_s)


def test_time_does_not_depend_on_the_pieces() -> None:
    data = posllh() + velned() + sol()
    receiver = Neo6m(CONFIG)
    found = [
        fix
        for end in range(1, len(data) + 1)
        for fix in receiver.feed(data[end - 1 : end], 100.0 - (len(data) - end) * BYTE_S)
    ]
    assert found[0].time_s == pytest.approx(fixes(data)[0].time_s)


def test_a_reader_woken_late_does_not_make_a_fix_younger() -> None:
    receiver = Neo6m(CONFIG)
    times = []
    for k in range(50):
        itow = TIME_OF_WEEK_MS + 200 * k
        late_s = 0.15 if k % 7 == 3 else 0.0
        data = posllh(itow) + velned(itow) + sol(itow)
        times += [fix.time_s for fix in receiver.feed(data, 10.0 + 0.2 * k + late_s)]
    assert np.diff(times) == pytest.approx(np.full(49, 0.2), abs=1e-3)


def test_epoch_clock_follows_drift_and_jumps() -> None:
    clock = EpochClock()
    for k in range(3000):
        local_s = clock.local_s(0.2 * k, 5.0 + 0.2 * k * (1.0 + 30e-6))
    assert local_s == pytest.approx(5.0 + 0.2 * 2999 * (1.0 + 30e-6), abs=1e-3)
    # the receiver sets its clock ahead: that is no lateness, and shows at once
    assert clock.local_s(10_000.0, 700.0) == 700.0


@pytest.mark.parametrize("turn_s", [86_400, 604_800])
def test_epoch_clock_goes_on_over_the_turn_of_day_and_week(turn_s: int) -> None:
    clock = EpochClock()
    times = [clock.local_s((turn_s - 3 + k) % turn_s, 100.0 + k + 0.02 * (k == 3)) for k in range(6)]
    assert np.diff(times) == pytest.approx(np.ones(5), abs=1e-3)


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 10.0])
@pytest.mark.parametrize("held_s", [0.5, 0.9, 1.5, 2.5, 6.0])
def test_what_was_held_up_comes_in_a_heap_and_is_as_old_as_it_is(held_s: float, rate_hz: float) -> None:
    """Each epoch of the heap takes 12 ms on the line, from the end of the hold-up on or back from it."""
    clock, period_s = EpochClock(), 1.0 / rate_hz
    for k in range(100):
        measured_s = k * period_s
        held_until_s = 20.0 * period_s + held_s
        heaped = max(0.0, held_until_s - measured_s) if k > 20 else 0.0
        began_s = held_until_s - 0.012 * rate_hz * heaped if heaped else measured_s
        assert clock.local_s(measured_s, began_s) == pytest.approx(measured_s, abs=0.001)


@pytest.mark.parametrize("scatter_s", [0.0, 0.01, 0.2])
def test_a_clock_set_back_by_seconds_is_followed_once_it_is_sure(scatter_s: float) -> None:
    clock, rng = EpochClock(), np.random.default_rng(7)
    for k in range(20):
        clock.local_s(100.0 + 0.2 * k, 10.0 + 0.2 * k)
    for k in range(20, 80):
        local_s = clock.local_s(97.0 + 0.2 * k, 10.0 + 0.2 * k + scatter_s * rng.exponential())
    assert local_s == pytest.approx(10.0 + 0.2 * 79, abs=0.1 * scatter_s + 0.001)


# ---------------------------------------------------------------- what a line does to bytes


@pytest.mark.parametrize("flip", [0, 2, 4, 10, 30, -1])
def test_a_damaged_message_is_no_fix_and_the_next_epoch_is(flip: int) -> None:
    damaged = bytearray(posllh())
    damaged[flip] ^= 0x04
    later = TIME_OF_WEEK_MS + 200
    good = posllh(later) + velned(later) + sol(later)
    found = fixes(bytes(damaged) + velned() + sol() + good + bytes(1100))
    assert len(found) == 1


@pytest.mark.parametrize("cut", range(1, 44))
def test_half_a_message_does_not_swallow_what_follows(cut: int) -> None:
    """Where a length is garbled, the message seems to be hundreds of bytes: later ones are still found."""
    epochs = range(TIME_OF_WEEK_MS + 200, TIME_OF_WEEK_MS + 1200, 200)
    data = posllh()[:cut] + b"".join(posllh(t) + velned(t) + sol(t) for t in epochs)
    assert len(fixes(data)) == 5


@settings(max_examples=60, deadline=None)
@given(st.lists(st.binary(max_size=30), max_size=8), st.integers(1, 40))
def test_garbage_before_whole_epochs_survives(noise: list[bytes], step: int) -> None:
    receiver = Neo6m(CONFIG)
    data = b"".join(noise) + b"".join(
        posllh(t) + velned(t) + sol(t) for t in range(TIME_OF_WEEK_MS, TIME_OF_WEEK_MS + 3000, 200)
    )
    found: list[GpsFix] = []
    for start in range(0, len(data), step):
        found += receiver.feed(data[start : start + step], 10.0 + start * BYTE_S)
    # a length in the noise can at worst hide the half kilobyte behind it
    assert len(found) >= 11
    assert all(fix.latitude_deg == pytest.approx(47.7654321) for fix in found)


@settings(max_examples=60)
@given(st.binary(max_size=300))
def test_the_splitter_returns_whole_messages_whatever_comes(data: bytes) -> None:
    splitter = FrameSplitter(9600)
    for message in splitter.feed(data, 1.0) + splitter.feed(posllh() + bytes(1200), 2.0):
        assert message.data[:1] in (b"\xb5", b"$")
        assert message.began_s <= 2.0


# ---------------------------------------------------------------- NMEA


def test_rmc_and_gga_of_one_second_make_a_fix() -> None:
    (fix,) = fixes(rmc() + gga())
    assert (fix.latitude_deg, fix.longitude_deg, fix.altitude_m) == pytest.approx((47.5, -8.25, 410.5))
    assert fix.velocity_ned_m_s == pytest.approx((0.0, 5.1444, 0.0), abs=1e-3)
    assert fix.horizontal_accuracy_m == pytest.approx(3.75)
    assert fix.satellites == 7


def test_a_receiver_at_rest_leaves_the_course_out() -> None:
    (fix,) = fixes(rmc(course="") + gga())
    assert fix.velocity_ned_m_s == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "data",
    [
        rmc(status="V") + gga(),
        rmc() + gga(quality=0),
        rmc("120001.00") + gga("120002.00"),
        nmea("GPGSA,A,2,01,02,03,,,,,,,,,,2.00,1.00,1.70") + rmc() + gga(),
        nmea("GPRMC,,V,,,,,,,,,,N") + nmea("GPGGA,,,,,,0,00,99.99,,,,,,"),
        rmc().replace(b"4730", b"4731") + gga(),
    ],
)
def test_nmea_without_a_good_fix_is_no_position(data: bytes) -> None:
    assert fixes(data) == []


def test_nmea_is_silent_beside_ubx_and_serves_when_ubx_stops() -> None:
    receiver = Neo6m(CONFIG)
    assert len(receiver.feed(posllh() + velned() + sol(), 10.0)) == 1
    assert receiver.feed(rmc("120001.00") + gga("120001.00"), 11.0) == []
    assert len(receiver.feed(rmc("120009.00") + gga("120009.00"), 11.0 + SILENCE_S)) == 1


# ----------------
# The NEO-6M's NMEA with a right check sum and wrong contents: no sentence ends the receiver.

FIX_3D = nmea("GPGSA,A,3,01,02,03,04,05,06,07,,,,,,2.5,1.5,2.0")
FIELD = st.one_of(
    st.sampled_from(
        ["", "A", "V", "3", "inf", "nan", "-1", "1e400", "4730.00000", "N", "120001.00", "070126"]
    ),
    st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E, exclude_characters=",*$"), max_size=12),
)


def fed(*sentences: bytes) -> list[float]:
    """All numbers of the fixes that a receiver makes of these sentences."""
    receiver, now_s, numbers = Neo6m(CONFIG), 0.0, list[float]()
    for sentence in sentences:
        now_s += BYTE_S * len(sentence)
        for fix in receiver.feed(sentence, now_s):
            numbers += [fix.latitude_deg, fix.longitude_deg, fix.altitude_m, *fix.velocity_ned_m_s]
            numbers += [fix.horizontal_accuracy_m, fix.vertical_accuracy_m, fix.speed_accuracy_m_s]
    return numbers


def test_whole_sentences_make_a_fix() -> None:
    assert len(fed(FIX_3D, rmc(), gga())) == 9


@pytest.mark.parametrize(
    "kind", ["GPGSA,A", "GPGSA", "GPGGA,120001.00,4730.0,N", "GPRMC,120001.00,A", "GPRMC"]
)
def test_a_short_sentence_with_a_right_check_sum_is_dropped(kind: str) -> None:
    assert len(fed(nmea(kind), FIX_3D, rmc(), nmea(kind), gga(), rmc("120002.00"), gga("120002.00"))) >= 9


@pytest.mark.parametrize("identity", ["G RMC", "PxRMC", "P RMC", "ZZRMC"])
def test_a_sentence_whose_identity_is_damaged_is_dropped(identity: str) -> None:
    spoilt = nmea(identity + rmc().decode()[6:].partition("*")[0])
    assert fed(spoilt, FIX_3D, rmc(), gga()) == fed(b"", FIX_3D, rmc(), gga())


@pytest.mark.parametrize("course", ["inf", "nan", "1e400"])
def test_a_course_that_is_no_number_is_none(course: str) -> None:
    assert all(math.isfinite(number) for number in fed(FIX_3D, rmc(course=course), gga()))


@given(st.sampled_from(["GPRMC", "GPGGA", "GPGSA"]), st.lists(FIELD, max_size=18))
def test_whatever_the_fields_hold_nothing_is_raised_and_no_fix_is_not_finite(
    kind: str, fields: list[str]
) -> None:
    sentence = nmea(",".join([kind, *fields]))
    numbers = fed(FIX_3D, sentence, rmc(), gga(), sentence, rmc("120002.00"), gga("120002.00"))
    assert all(math.isfinite(number) for number in numbers)


# ---------------- Which fixes are believed: NAV-STATUS and NAV-DOP, NAV-SOL alone, a time that stands still

START_MS = 302_400_200
PLACE = (47.7654321, 8.1234567, 447.0)  # ellipsoid; the sea is 46.5 m higher up there


def place(itow: int) -> bytes:
    lat, lon, height = PLACE
    numbers = (itow, round(lon * 1e7), round(lat * 1e7), round(height * 1e3), 400_500, 2500, 3750)
    return ubx(1, 0x02, struct.pack("<IiiiiII", *numbers))


def moves(itow: int) -> bytes:
    return ubx(1, 0x12, struct.pack("<IiiiIIiII", itow, 150, -250, 75, 301, 292, 0, 30, 0))


def solved(itow: int, fix: int = 3, flags: int = 0x0D) -> bytes:
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
        return self.epoch(place(self.itow), *more, solved(self.itow), moves(self.itow))


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
    assert (
        line.epoch(place(line.itow), dop(line.itow, 99.99), solved(line.itow, 0, 0), moves(line.itow)) == []
    )
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
        line.epoch(place(START_MS), solved(START_MS), moves(START_MS))
    assert len(line.fixes) == 1
    assert line.driver.problem == "NEO-6M: no fix"


def test_one_that_hangs_over_its_nmea_gives_one_fix_and_is_reported() -> None:
    receiver = Neo6m(CONFIG)
    found = []
    for second in range(30):
        found += receiver.feed(rmc() + gga(), 100.0 + second)
        receiver.pending(100.0 + second)
    assert len(found) == 1
    assert "no fix" in (receiver.problem or "")


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
        line.epoch(solved(line.itow), status(line.itow), dop(line.itow, 1.5))
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
        line.epoch(solved(line.itow))
    assert line.fixes[-1].altitude_m == pytest.approx(400.5, abs=0.02)
    assert line.fixes[-1].vertical_accuracy_m == pytest.approx(3.1)
    assert ABOVE_ELLIPSOID not in (line.driver.problem or "")


def test_one_epoch_that_has_lost_the_rest_is_not_taken_for_a_habit() -> None:
    line = EpochLine()
    for _ in range(5):
        line.epoch(solved(line.itow))
        line.whole()
    assert len(line.fixes) == 5
    assert all(fix.altitude_m == pytest.approx(400.5) for fix in line.fixes)


@pytest.mark.parametrize(("fix", "flags"), [(0, 0x0D), (2, 0x0D), (3, 0x0C)])
def test_sol_without_a_good_fix_is_no_position(fix: int, flags: int) -> None:
    line = EpochLine()
    for _ in range(5):
        line.epoch(solved(line.itow, fix, flags))
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
        line.epoch(place(line.itow), solved(line.itow, 0, 0), moves(line.itow))
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
