"""`companion detect --send`: a target for each picture that shows the pad, and nothing that flies."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.config import (
    CameraConfig,
    CompanionConfig,
    ConfigError,
    VisionConfig,
    find_file,
    load_model,
    validate,
)
from companion.link.codec import Codec, mavlink
from companion.pad import load_pad
from companion.tools.detect import send as module
from companion.tools.detect.run import PadFinder, detect_all
from companion.tools.detect.send import TargetLink
from tests.unit.tools.detect.test_detect import picture
from tests.waiting import soon

PAD = load_pad("moving_1300")
ASKING = {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE}


class Autopilot:
    """One that sends heartbeats and where it is, by UDP, and keeps what it receives."""

    def __init__(self, kind: AutopilotKind, *, tells: bool) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.02)
        self.port: int = self._socket.getsockname()[1]
        self._make = PROFILES[kind].mavlink_autopilot
        self._tells = tells
        self.heard: list[Any] = []
        self.done = False

    def run(self) -> None:
        codec, reader = Codec(1, 1), Codec(9)
        while not self.done:
            try:
                data, peer = self._socket.recvfrom(4096)
            except TimeoutError:
                continue
            self.heard += reader.decode(data)
            messages = [mavlink.MAVLink_heartbeat_message(2, self._make, 0, 0, 4, 3)]
            if self._tells:
                now_ms = int(1e3 * time.monotonic()) % 2**32
                messages += [
                    mavlink.MAVLink_local_position_ned_message(now_ms, 10.0, 20.0, -4.0, 0.0, 0.0, 0.0),
                    mavlink.MAVLink_attitude_message(now_ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
                ]
            self._socket.sendto(b"".join(codec.encode(m) for m in messages), peer)

    def targets(self) -> list[Any]:
        return [m for m in self.heard if m.get_type() == "LANDING_TARGET"]


@contextmanager
def flying(kind: AutopilotKind, *, tells: bool = True) -> Iterator[Autopilot]:
    autopilot = Autopilot(kind, tells=tells)
    thread = threading.Thread(target=autopilot.run)
    thread.start()
    try:
        yield autopilot
    finally:
        autopilot.done = True
        thread.join()
        autopilot._socket.close()


def link(port: int) -> TargetLink:
    settings = {"link": {"connection": f"udp:127.0.0.1:{port}"}}
    return TargetLink(validate(CompanionConfig, settings, "test"))


def photo(folder: Path) -> Path:
    import cv2

    path = folder / "pad.png"
    cv2.imwrite(str(path), picture(2.0, 0.3))
    return path


def finder() -> PadFinder:
    return PadFinder(PAD, load_model(CameraConfig, find_file("cameras", "sitl_640x480")), VisionConfig())


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_a_picture_with_the_pad_is_a_target(kind: AutopilotKind, tmp_path: Path) -> None:
    with flying(kind) as autopilot:
        with link(autopilot.port).opened() as opened:
            assert detect_all([photo(tmp_path)], finder(), None, opened.send)
            assert soon(autopilot.targets)
        (target,) = autopilot.targets()
        # the camera is 2 m above the pad, and 0.3 m ahead of it
        away = (target.x, target.y, target.z)
        origin = (10.0, 20.0, -4.0) if kind == "px4" else (0.0, 0.0, 0.0)
        assert [a - o for a, o in zip(away, origin, strict=True)] == pytest.approx((-0.3, 0.0, 2.0), abs=0.02)
        for m in autopilot.heard:
            harmless = m.get_type() in {"HEARTBEAT", "TIMESYNC", "LANDING_TARGET"}
            assert harmless or m.command in ASKING


def test_what_keeps_it_from_being_sent_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PATIENCE_S", 0.3)
    monkeypatch.setattr(module, "POSE_PATIENCE_S", 0.2)
    with (
        flying("px4", tells=False) as autopilot,
        link(autopilot.port).opened() as opened,
        pytest.raises(ConfigError, match="does not tell where it is"),
    ):
        detect_all([photo(tmp_path)], finder(), None, opened.send)
    with pytest.raises(ConfigError, match="no PX4 or ArduPilot within"), link(autopilot.port).opened():
        pass
