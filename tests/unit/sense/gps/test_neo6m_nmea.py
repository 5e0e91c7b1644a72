"""The NEO-6M's NMEA with a right check sum and wrong contents: no sentence ends the receiver."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.sense.gps.neo6m import Neo6m
from sitl.devices.neo6m import nmea
from tests.unit.sense.gps.nmea import BYTE_S, CONFIG, gga, rmc

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
