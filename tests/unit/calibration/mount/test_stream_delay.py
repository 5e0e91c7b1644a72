"""`calibrate-mount` finds the delay of a camera on the network: real servers on loopback, in real time."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.mount.recording import (
    GravityFreePadDetector,
    MountRecording,
    frames_of,
    in_camera_axes,
    read_recording,
)
from calibration.mount.result import shutter_s
from calibration.mount.solver import solve
from companion.base.clock import Clock
from companion.base.messages import Frame
from companion.config import CompanionConfig
from companion.sense.camera.stream import StreamDevice
from tests.unit.calibration.mount.mount_world import HandHeld, record_sway, scenario_of
from tests.unit.sense.camera.mjpeg_camera import mjpeg_server
from tests.unit.sense.camera.rtsp_camera import rtsp_server

pytestmark = pytest.mark.slow

LATENCY_S = 0.045
FIELD_PX, BITS = 16, 12  # a block of H.264's is as large
REPEAT_S = 1 / 30
LAST = 10  # frames that need not come


def numbered(image: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    """A picture with its number in the corner, as black and white fields."""
    marked = image.copy()
    for bit in range(BITS):
        marked[:FIELD_PX, bit * FIELD_PX : (bit + 1) * FIELD_PX] = 255 if number >> bit & 1 else 0
    return marked


def number_of(image: NDArray[np.uint8]) -> int:
    return sum(int(image[FIELD_PX // 2, bit * FIELD_PX + FIELD_PX // 2] > 128) << bit for bit in range(BITS))


def as_due(pictures: list[tuple[float, NDArray[np.uint8]]]) -> Iterator[bytes]:
    """The pictures, each from its time on, 30 a second: one of H.264 is whole when the next one begins."""
    for (from_s, picture), (next_s, _) in pairwise(pictures):
        for due_s in np.arange(from_s, next_s - REPEAT_S / 2.0, REPEAT_S):
            time.sleep(max(0.0, due_s - time.monotonic()))
            yield picture.tobytes()


@contextmanager
def playing(kind: str, pictures: list[tuple[float, NDArray[np.uint8]]]) -> Iterator[str]:
    """Serve each picture at its time, as JPEG over HTTP or as H.264 over RTSP; the address."""
    if kind == "rtsp":
        with rtsp_server(as_due(pictures)) as port:
            yield f"rtsp://127.0.0.1:{port}/camera"
        return
    jpegs = [(due_s, cv2.imencode(".jpg", picture)[1].tobytes()) for due_s, picture in pictures]

    def each() -> Iterator[bytes]:
        """So long after its exposure as the camera, encoder and network take."""
        for due_s, data in jpegs:
            time.sleep(max(0.0, due_s - time.monotonic()))
            yield data

    with mjpeg_server(each) as port:
        yield f"http://127.0.0.1:{port}/"


@pytest.fixture(scope="module")
def swayed(tmp_path_factory: pytest.TempPathFactory) -> tuple[MountRecording, list[Frame]]:
    """What the boards gave while the vehicle was swayed, and the camera's frames at their true exposures."""
    folder: Path = tmp_path_factory.mktemp("stream") / "swayed"
    held = HandHeld(scenario_of({"camera": {"stamp_error_s": 0.0}}), 11, "sway")
    record_sway(held, CompanionConfig(), folder, 20.0)
    return read_recording(folder), list(frames_of(folder / "flight.mcap"))


@pytest.mark.parametrize(
    ("kind", "delay_s"), [("http", 0.12), ("http", 0.25), ("rtsp", 0.0), ("rtsp", 0.1), ("rtsp", 0.25)]
)
async def test_the_delay_of_a_stream_is_found_to_ten_milliseconds(
    swayed: tuple[MountRecording, list[Frame]], kind: str, delay_s: float
) -> None:
    recording, frames = swayed
    detector = GravityFreePadDetector(
        recording.pad, recording.camera, recording.vehicle, recording.config.sense.vision
    )
    starts_s = time.monotonic() + 2.0 - frames[0].time_s  # of the recording's clock
    pictures = [
        (starts_s + frame.time_s + delay_s, numbered(frame.image, number))
        for number, frame in enumerate(frames)
    ]
    clock, shots, offsets_s = Clock(), list[Frame](), []
    to_recording_s = time.monotonic() - clock.now_s() - starts_s
    with playing(kind, pictures) as url:
        device = StreamDevice(url, recording.camera, LATENCY_S, clock)
        while not shots or shots[-1].sequence < len(frames) - LAST:
            shot = device.read()
            number, stamp_s = number_of(shot.image), shot.time_s + to_recording_s
            if not shots or number != shots[-1].sequence:
                offsets_s.append(frames[number].time_s - stamp_s)
                shots.append(Frame(stamp_s, stamp_s, number, shot.image))
        device.close()
    looked = (detector.look(shot) for shot in shots)  # afterwards: it must not keep the reading waiting
    seen = [sighting for sighting in looked if sighting is not None]
    found = solve(
        recording.inertial,
        in_camera_axes(seen, recording.vehicle),
        np.array(recording.vehicle.camera_position_body_m),
        shutter_s(recording),
    )
    true_s = float(np.median(offsets_s))
    print(
        f"{kind}: {len(seen)} sightings, true {1e3 * true_s:.1f} ms, found {1e3 * found.time_offset_s:.1f} ms"
    )
    assert LATENCY_S - delay_s - 0.1 < true_s < LATENCY_S - delay_s  # the server's, encoder's and decoder's
    assert abs(found.time_offset_s - true_s) < 0.010
