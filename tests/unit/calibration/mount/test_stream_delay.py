"""`calibrate-mount` finds the delay of a camera on the network: a real server on loopback, in real time."""

import http.server
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

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
from companion.base.messages import Frame, PadSighting
from companion.config import CompanionConfig
from companion.sense.camera.stream import StreamDevice
from tests.unit.calibration.mount.mount_world import HandHeld, record_sway, scenario_of

pytestmark = pytest.mark.slow

LATENCY_S = 0.045
FIELD_PX, BITS = 8, 12


def numbered(image: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    """A picture with its number in the corner, as black and white fields."""
    marked = image.copy()
    for bit in range(BITS):
        marked[:FIELD_PX, bit * FIELD_PX : (bit + 1) * FIELD_PX] = 255 if number >> bit & 1 else 0
    return marked


def number_of(image: NDArray[np.uint8]) -> int:
    return sum(int(image[FIELD_PX // 2, bit * FIELD_PX + FIELD_PX // 2] > 128) << bit for bit in range(BITS))


class StreamServer(http.server.BaseHTTPRequestHandler):
    """Sends each picture so long after its exposure as the camera, encoder and network take."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        server: Any = self.server
        for due_s, data in server.pictures:
            time.sleep(max(0.0, due_s - time.monotonic()))
            head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
            try:
                self.wfile.write(head.encode() + data + b"\r\n")
            except OSError:
                return

    def log_message(self, *_: object) -> None:
        """It is quiet."""


@contextmanager
def playing(pictures: list[tuple[float, bytes]]) -> Iterator[str]:
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), StreamServer) as server:
        server.daemon_threads, server.pictures = True, pictures  # type: ignore[attr-defined]
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@pytest.fixture(scope="module")
def swayed(tmp_path_factory: pytest.TempPathFactory) -> tuple[MountRecording, list[Frame]]:
    """What the boards gave while the vehicle was swayed, and the camera's frames at their true exposures."""
    folder: Path = tmp_path_factory.mktemp("stream") / "swayed"
    held = HandHeld(scenario_of({"camera": {"stamp_error_s": 0.0}}), 11, "sway")
    record_sway(held, CompanionConfig(), folder, 20.0)
    return read_recording(folder), list(frames_of(folder / "flight.mcap"))


@pytest.mark.parametrize("delay_s", [0.12, 0.25])
async def test_the_delay_of_a_stream_is_found_to_ten_milliseconds(
    swayed: tuple[MountRecording, list[Frame]], delay_s: float
) -> None:
    recording, frames = swayed
    jpegs = [
        cv2.imencode(".jpg", numbered(frame.image, number))[1].tobytes()
        for number, frame in enumerate(frames)
    ]
    detector = GravityFreePadDetector(
        recording.pad, recording.camera, recording.vehicle, recording.config.sense.vision
    )
    starts_s = time.monotonic() + 1.0 - frames[0].time_s  # of the recording's clock
    pictures = [(starts_s + f.time_s + delay_s, jpeg) for f, jpeg in zip(frames, jpegs, strict=True)]
    clock, seen, offsets_s = Clock(), list[PadSighting](), []
    to_recording_s = time.monotonic() - clock.now_s() - starts_s
    with playing(pictures) as url:
        device = StreamDevice(url, recording.camera, LATENCY_S, clock)
        number = -1
        while number < len(frames) - 2:
            shot = device.read()
            number, stamp_s = number_of(shot.image), shot.time_s + to_recording_s
            offsets_s.append(frames[number].time_s - stamp_s)
            if (sighting := detector.look(Frame(stamp_s, stamp_s, number, shot.image))) is not None:
                seen.append(sighting)
        device.close()
    found = solve(
        recording.inertial,
        in_camera_axes(seen, recording.vehicle),
        np.array(recording.vehicle.camera_position_body_m),
        shutter_s(recording),
    )
    true_s = float(np.median(offsets_s))
    print(f"{len(seen)} sightings, true {1e3 * true_s:.1f} ms, found {1e3 * found.time_offset_s:.1f} ms")
    assert true_s == pytest.approx(LATENCY_S - delay_s, abs=0.03)
    assert abs(found.time_offset_s - true_s) < 0.010
