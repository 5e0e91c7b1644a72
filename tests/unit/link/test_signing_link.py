"""Signing in the app: against the simulated autopilot with the same key, another one, and none."""

import hashlib
from pathlib import Path

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.config import ConfigError, LinkConfig
from companion.link.codec import Codec, heartbeat, mavlink
from companion.link.commands import NO_ANSWER, VehicleCommand
from companion.link.session import Session
from companion.link.signing import EPOCH_UNIX_S, STAMPS_PER_S, LinkSigning, read_signing_key, stamp_from_unix
from sitl.mavlink.endpoint import MavlinkEndpoint
from sitl.mavlink.framing import Signing
from tests.unit.sitl.autopilot.autopilot_flight import AutopilotFlight

KEY, OTHER = bytes(range(32)), bytes(range(1, 33))
UNIX_S = 1.7e9
STAMP = stamp_from_unix(UNIX_S)
COMMAND = VehicleCommand(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0, 0.0))


def signing_of(secret: bytes, stamp: int = STAMP, kept_stamp: int = 0) -> LinkSigning:
    return LinkSigning(secret, stamp, kept_stamp)


def sender(secret: bytes = KEY, stamp: int = STAMP, system_id: int = 1, component_id: int = 1) -> Codec:
    codec = Codec(system_id, component_id)
    codec.sign(signing_of(secret, stamp))
    return codec


def receiver(stamp: int = STAMP, kept_stamp: int = 0) -> Codec:
    codec = Codec(1)
    codec.sign(signing_of(KEY, stamp, kept_stamp))
    return codec


def connected(
    ours: bytes | None, theirs: bytes | None, kind: AutopilotKind = "px4"
) -> tuple[Session, int, bool]:
    """Three seconds: the session, how many of its frames were refused, whether a command was answered."""
    session = Session(LinkConfig(), signing=None if ours is None else signing_of(ours))
    autopilot = AutopilotFlight(kind).autopilot
    signing = Signing(kind, theirs)
    endpoint = MavlinkEndpoint(autopilot, signing=signing, unix_at_start_s=UNIX_S)
    asked = session.command(COMMAND)
    for step in range(300):
        now_s = 0.01 * step
        endpoint.receive(session.tick(now_s), now_s)
        session.receive(endpoint.transmit(now_s), now_s)
    return session, signing.refused, asked.outcome not in {None, NO_ANSWER}


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_with_the_same_key_both_sides_understand_each_other(kind: AutopilotKind) -> None:
    session, refused, answered = connected(KEY, KEY, kind)
    assert session.state.connected
    assert session.state.refused_frames == refused == 0
    assert answered


@pytest.mark.parametrize(("ours", "theirs"), [(KEY, None), (KEY, OTHER)])
def test_what_is_not_rightly_signed_is_refused_and_counted(ours: bytes, theirs: bytes | None) -> None:
    session, _, answered = connected(ours, theirs)
    assert not session.state.connected
    assert not answered
    assert session.state.refused_frames > 10


def test_an_autopilot_that_demands_signatures_refuses_an_app_without() -> None:
    session, refused, answered = connected(None, KEY)
    assert session.state.connected  # its heartbeats can be read
    assert not answered
    assert refused > 0


def test_a_clock_that_is_years_behind_does_no_harm() -> None:
    session = Session(LinkConfig(), signing=LinkSigning(KEY, 0))
    signing = Signing("px4", KEY)
    endpoint = MavlinkEndpoint(AutopilotFlight("px4").autopilot, signing=signing, unix_at_start_s=UNIX_S)
    asked = session.command(COMMAND)
    for step in range(300):
        now_s = 0.01 * step
        session.receive(endpoint.transmit(now_s), now_s)  # its first word moves our stamps on
        endpoint.receive(session.tick(now_s), now_s)
    assert asked.outcome not in {None, NO_ANSWER}


def test_a_stranger_that_stamps_far_ahead_does_not_move_our_own_stamps() -> None:
    signing = signing_of(KEY)
    assert not signing.accepts(sender(OTHER, STAMP + 3600 * STAMPS_PER_S).encode(heartbeat()))
    assert signing.next_stamp() == STAMP + 1


def test_what_was_accepted_before_a_restart_is_not_accepted_after_it() -> None:
    before = signing_of(KEY)
    frame = sender(stamp=STAMP + 500).encode(heartbeat())
    assert before.accepts(frame)
    a_second_later, clock_behind = signing_of(KEY, STAMP + STAMPS_PER_S), signing_of(KEY, 0)
    # this is what the kept stamp is for
    assert a_second_later.is_fresh(frame)
    assert clock_behind.is_fresh(frame)
    for clock_stamp in (STAMP + STAMPS_PER_S, 0):
        after = receiver(clock_stamp, before.stamp)
        assert after.decode(frame) == []
        # whoever had heard us goes on from our stamps
        assert len(after.decode(sender(stamp=before.stamp + 1).encode(heartbeat()))) == 1


def test_after_a_restart_our_own_stamps_go_on_from_the_last() -> None:
    assert signing_of(KEY, 0, STAMP).next_stamp() == STAMP + 1


def test_what_is_sent_again_long_after_is_refused_though_we_have_sent_little() -> None:
    recorded = sender(system_id=255, component_id=190).encode(heartbeat())
    session = Session(LinkConfig(), signing=signing_of(KEY))
    session.tick(100.0)
    session.receive(recorded, 100.0 + 3600.0)
    assert session.counters.refused == 1


def test_an_unsigned_frame_and_one_of_mavlink_1_are_refused() -> None:
    ours = receiver()
    assert ours.decode(Codec(1, 1).encode(heartbeat())) == []
    old = heartbeat().pack(mavlink.MAVLink(None, 1, 1), force_mavlink1=True)
    assert ours.decode(old) == []
    assert ours.counters.refused == 2


def key_file(folder: Path, content: bytes, mode: int = 0o600) -> Path:
    path = folder / "key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


def test_the_key_is_32_bytes_or_a_passphrase(tmp_path: Path) -> None:
    key = read_signing_key(key_file(tmp_path, KEY), EPOCH_UNIX_S + 2.0)
    assert (key.secret, key.stamp) == (KEY, 200_000)
    words = read_signing_key(key_file(tmp_path, b"open sesame\n"), UNIX_S)
    assert words.secret == hashlib.sha256(b"open sesame").digest()


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o666])
def test_a_key_that_others_may_read_is_refused(tmp_path: Path, mode: int) -> None:
    with pytest.raises(ConfigError, match=rf"mode 0{mode:o}, others may read it; expected 0600"):
        read_signing_key(key_file(tmp_path, KEY, mode), UNIX_S)


def test_a_key_that_is_missing_or_empty_is_reported_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"link.signing_key .*none: No such file"):
        read_signing_key(tmp_path / "none", UNIX_S)
    with pytest.raises(ConfigError, match=r"empty; expected 32 bytes or a passphrase"):
        read_signing_key(key_file(tmp_path, b" \n"), UNIX_S)


def test_mavsdk_cannot_sign() -> None:
    with pytest.raises(ValueError, match="MAVSDK cannot sign"):
        LinkConfig(signing_key=Path("key"))
    assert LinkConfig(signing_key=Path("key"), actions="pymavlink").signing_key == Path("key")
