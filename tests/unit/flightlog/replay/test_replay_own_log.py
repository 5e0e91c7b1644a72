"""Our own log replayed: it repeats to the bit, and says so when it does not."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import SeekingReader

from companion.base.message_json import decode, encode
from companion.base.messages import ImuSample, Notice, PadSighting, VehicleState
from companion.config import CompanionConfig, VehicleConfig
from companion.flightlog.record import FlightLog
from companion.flightlog.replay.compare import Comparison, repetition
from companion.flightlog.replay.flight_record import FlightRecord
from companion.flightlog.replay.mcap_log import read_mcap
from companion.flightlog.replay.run import replay
from companion.flightlog.replay.settings import choose
from tests.programs import ProgramHere
from tests.unit.flightlog.replay.log_files import FLIGHT, own_rig, write_own


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_own(tmp_path_factory.mktemp("own"))


@pytest.fixture(scope="module")
def record(log: Path) -> FlightRecord:
    return read_mcap(log)


def test_the_log_holds_all_that_the_estimators_were_made_from(record: FlightRecord) -> None:
    assert record.rig == own_rig()
    assert record.cut is None
    assert record.versions.keys() >= {"numpy", "filterpy"}


def test_every_sample_comes_back_to_the_bit_and_in_order(record: FlightRecord) -> None:
    samples = [event.item for event in record.events if hasattr(event.item, "__slots__")]
    read = [encode(item) for item in samples if type(item).__name__ != "Ask"]
    assert read == [encode(sample) for _, sample in FLIGHT.samples]


def test_a_replay_under_the_flights_own_settings_repeats_it_to_the_bit(record: FlightRecord) -> None:
    choice = choose(record, None)
    assert choice.repeats
    result = repetition(record, replay(record.events, choice.rig))
    assert result.identical, result
    assert result.states > 300


def test_it_agrees_with_the_truth_as_the_flight_did(record: FlightRecord) -> None:
    errors = Comparison(replay(record.events, own_rig()), record.references["truth"]).errors()
    assert errors.attitude_deg is not None
    assert errors.attitude_deg.rms < 2.0
    assert errors.pad_position_m is not None
    assert errors.pad_position_m.rms < 0.15
    # in the air from 5 s to 16 s, at 30 Hz
    assert errors.attitude_deg.samples == pytest.approx(330, abs=3)


def test_other_settings_give_other_estimates(record: FlightRecord, tmp_path: Path) -> None:
    path = tmp_path / "other.yaml"
    path.write_text("estimate: {ekf: {accel_noise_m_s2: 3.0}}\n")
    choice = choose(record, path)
    assert not choice.repeats
    assert not repetition(record, replay(record.events, choice.rig)).identical


def test_the_first_state_that_differs_is_named(record: FlightRecord) -> None:
    replayed = replay(record.events, own_rig())
    changed = replayed.states[100]
    assert isinstance(changed, VehicleState)
    x, y, z = changed.position_ned_m
    replayed.states[100] = replace(changed, position_ned_m=(np.nextafter(x, 1e9).item(), y, z))
    result = repetition(record, replayed)
    assert (result.identical, result.differs_from_s) == (False, changed.time_s)
    del replayed.states[200:]
    replayed.states[100] = changed
    assert repetition(record, replayed).differs_from_s == record.states[200].time_s


@pytest.mark.parametrize("share", [0.35, 0.8])
def test_a_log_cut_short_is_read_up_to_the_cut(log: Path, tmp_path: Path, share: float) -> None:
    data = log.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(share * len(data))])
    record = read_mcap(cut)
    assert record.cut is not None
    assert record.cut.startswith("the log is cut after ")
    assert 100 < len(record.events) < len(read_mcap(log).events)
    assert repetition(record, replay(record.events, own_rig())).identical


def test_a_damaged_chunk_ends_the_log_there(log: Path, tmp_path: Path) -> None:
    data = bytearray(log.read_bytes())
    summary = SeekingReader(io.BytesIO(data)).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[len(summary.chunk_indexes) // 2]
    data[chunk.chunk_start_offset + chunk.chunk_length - 20] ^= 0xFF  # within its compressed records
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data)
    assert read_mcap(damaged).cut is not None


@pytest.mark.parametrize(
    "command",
    [
        ("companion", "replay"),
        ("companion", "report"),
        ("companion", "identify"),
        ("calibrate-magnetometer",),
        ("calibrate-mount", "camera"),
    ],
)
def test_damaged_settings_are_named(
    command: tuple[str, ...], log: Path, tmp_path: Path, program: ProgramHere
) -> None:
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(log.read_bytes().replace(b'{"pad":', b'{"pad?:', 1))
    refusal = program(*command, damaged).refusal
    assert f"{damaged}: settings: config: cannot be read: " in refusal
    assert "expected JSON" in refusal


def test_an_older_log_without_settings_is_replayed_under_the_shipped_ones(tmp_path: Path) -> None:
    record = read_mcap(write_own(tmp_path, settings=False))
    assert record.rig is None
    choice = choose(record, None)
    assert not choice.repeats
    assert choice.field.source == "World Magnetic Model at the first fix"


def test_settings_that_this_version_does_not_have_are_left_out_and_noted(tmp_path: Path) -> None:
    class Earlier(VehicleConfig):
        gone_since: float = 3.0

    rig = own_rig()
    earlier = Earlier.model_validate(rig.vehicle.model_dump())
    log = FlightLog(tmp_path, 0.0)
    log.write_settings(config=CompanionConfig(), vehicle=earlier, pad=rig.pad)
    log.close()
    record = read_mcap(tmp_path / "flight.mcap")
    assert record.rig is not None
    assert record.rig.vehicle == rig.vehicle
    assert record.notes == [
        f"{tmp_path / 'flight.mcap'}: settings: vehicle: gone_since: not in this version, left out"
    ]


def test_messages_that_the_disk_lost_are_reported(tmp_path: Path) -> None:
    log = FlightLog(tmp_path, 0.0)
    log.write("notice", Notice(1.0, "record", "the disk does not keep up: 3 messages lost", "warning"), 1.0)
    log.close()
    assert read_mcap(tmp_path / "flight.mcap").notes == [
        "the log says of itself: the disk does not keep up: 3 messages lost"
    ]


def test_numbers_that_are_none_come_back_as_nan() -> None:
    sample = ImuSample(1.0, (0.1, float("nan"), 0.3), (0.0, 0.0, -9.8), float("nan"))
    back = decode(ImuSample, {"time_s": 1.0, **_plain(sample)})
    assert np.isnan(back.rate_body_rad_s[1])
    assert np.isnan(back.temperature_c)
    assert encode(back) == encode(sample)


def test_a_sighting_comes_back_with_its_matrix() -> None:
    sighting = next(s for _, s in FLIGHT.samples if isinstance(s, PadSighting))
    back = decode(PadSighting, _plain(sighting))
    assert np.array_equal(back.covariance, sighting.covariance)
    assert back.body_from_pad == sighting.body_from_pad
    assert back.marker_ids == (0, 1)
    with pytest.raises(TypeError, match="missing"):
        decode(PadSighting, {"time_s": 1.0})


def _plain(message: object) -> dict[str, object]:
    import json

    plain: dict[str, object] = json.loads(encode(message))
    return plain
