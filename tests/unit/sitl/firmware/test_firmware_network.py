"""Between a firmware and its clients: all passes through unchanged, and the ground station hears it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from companion.link.codec import mavlink
from sitl.firmware.process import Firmware, Moment
from sitl.firmware.vehicle import FirmwareNetwork
from sitl.mavlink.ground_station import GroundStation
from sitl.scenario.scenario import BeaconSettings
from sitl.vehicle.quadrotor import RotorValues
from tests.unit.sitl.external.external_vehicle import ARDUPILOT, PX4, MessageSender, heartbeat
from tests.unit.sitl.firmware.fake_firmware import HOME, messages

PAD = ((10.0, 5.0, -0.3), (1.0, 0.0, 0.0))


class RecordedFirmware(Firmware):
    """A firmware that says what it is given, and keeps what it is told."""

    def __init__(self) -> None:
        self.says: list[bytes] = []
        self.told: list[bytes] = []

    def step(self, moment: Moment) -> RotorValues:
        raise NotImplementedError

    def read(self) -> list[bytes]:
        said, self.says = self.says, []
        return said

    def write(self, data: bytes) -> None:
        self.told.append(data)

    def close(self) -> None:
        raise NotImplementedError


class FirmwareClients:
    """A firmware's network with clients, whose beacon has begun to beat."""

    def __init__(self, clients: int = 1, *, datagrams: bool = True) -> None:
        self.firmware = RecordedFirmware()
        self.ground_station = GroundStation(
            BeaconSettings(position_std_m=0.0), np.random.default_rng(0), HOME
        )
        self.network = FirmwareNetwork(self.firmware, self.ground_station)
        self.heard: list[list[bytes]] = [[] for _ in range(clients)]
        self.ports = [self.network.connect(heard.extend, datagrams=datagrams) for heard in self.heard]
        self.transmit(0.0)
        self.beacon = self.firmware.told.pop()
        for heard in self.heard:
            heard.clear()

    def transmit(self, now_s: float) -> None:
        self.network.transmit(now_s, *PAD)

    def say(self, data: bytes, now_s: float) -> None:
        """By the first client."""
        self.network.receive(self.ports[0], data, now_s)


COMPANION = MessageSender(1, 191)


def test_the_beacon_beats_for_the_firmware_and_for_every_client() -> None:
    desk = FirmwareClients(2)
    (beat,) = messages(desk.beacon)
    assert (beat.get_type(), beat.get_srcSystem()) == ("HEARTBEAT", 255)
    desk.transmit(1.0)
    assert [messages(b"".join(heard))[0].get_srcSystem() for heard in desk.heard] == [255, 255]
    assert len(desk.firmware.told) == 1


def test_what_the_firmware_says_reaches_every_client_unchanged_that_has_not_gone() -> None:
    desk, beat = FirmwareClients(3), heartbeat(PX4)
    said = [MessageSender().pack(beat, beat), b"no MAVLink at all", MessageSender().pack(beat)]
    desk.firmware.says = list(said)
    desk.transmit(0.1)
    assert desk.heard == [said] * 3
    desk.transmit(0.2)
    assert desk.heard == [said] * 3  # nothing has come since
    desk.network.disconnect(desk.ports[0])
    desk.firmware.says = [b"said"]
    desk.transmit(0.3)
    assert desk.heard == [said, [*said, b"said"], [*said, b"said"]]


def test_a_stream_of_bytes_is_cut_into_frames_however_it_comes() -> None:
    desk = FirmwareClients(datagrams=False)
    frames = [COMPANION.pack(heartbeat(ARDUPILOT)) for _ in range(3)]
    data = b"noise" + b"".join(frames)
    for at in range(0, len(data), 7):
        desk.say(data[at : at + 7], 0.01)
    assert desk.firmware.told == frames


def test_what_a_client_says_reaches_the_firmware_frame_by_frame_and_half_a_one_holds_up_none() -> None:
    desk = FirmwareClients()
    frames = [COMPANION.pack(heartbeat(ARDUPILOT)) for _ in range(4)]
    desk.say(b"".join(frames[:3]), 0.1)
    assert desk.firmware.told == frames[:3]
    desk.say(frames[3][:9], 0.2)
    desk.say(frames[3], 0.201)
    assert desk.firmware.told == frames


@pytest.mark.parametrize("system", [1, 3])
def test_it_is_armed_by_the_autopilots_own_heartbeat_alone(system: int) -> None:
    desk = FirmwareClients()
    for component, armed, expected in ((1, True, True), (191, False, True), (1, False, False)):
        desk.firmware.says = [MessageSender(system, component).pack(heartbeat(PX4, armed=armed))]
        desk.transmit(0.1)
        assert desk.network.armed is expected


def test_the_ground_station_tells_where_the_pad_is() -> None:
    desk = FirmwareClients()
    asked = mavlink.MAVLink_command_long_message(
        255, 190, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, mavlink.MAVLINK_MSG_ID_FOLLOW_TARGET, *[0] * 6
    )
    desk.say(COMPANION.pack(asked), 0.1)
    desk.transmit(0.2)
    desk.transmit(0.7)
    answers: list[Any] = messages(b"".join(desk.heard[0]))
    assert [answer.get_type() for answer in answers] == ["COMMAND_ACK", "FOLLOW_TARGET"]
    assert answers[1].lat == pytest.approx(47.00009e7, abs=100)
    assert len(desk.firmware.told) == 3  # the app's one, and the ground station's two


def test_whatever_comes_does_no_harm() -> None:
    desk = FirmwareClients()
    rng = np.random.default_rng(3)
    junk: Sequence[bytes] = [rng.bytes(int(size)) for size in rng.integers(0, 300, 200)]
    desk.firmware.says = list(junk)
    desk.transmit(0.1)
    for number, data in enumerate(junk):
        desk.say(data, 0.2 + 0.01 * number)
    assert desk.heard == [junk]
    assert desk.firmware.told == []
