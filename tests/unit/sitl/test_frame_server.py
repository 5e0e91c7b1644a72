"""The simulator's camera socket: frames arrive whole, and the camera never waits for a client."""

import asyncio
from pathlib import Path

import numpy as np

from companion.config import CameraConfig, find_file, load_model
from companion.messages import Frame
from companion.sense.camera import open_camera
from sitl.frame_server import FrameServer

CAMERA = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))


def frame(sequence: int) -> Frame:
    image = np.full((CAMERA.height_px, CAMERA.width_px), sequence % 256, np.uint8)
    return Frame(time_s=0.1 * sequence, received_s=0.0, sequence=sequence, image=image)


async def test_a_frame_arrives_as_it_was_sent(tmp_path: Path) -> None:
    server = FrameServer(tmp_path / "camera")
    await server.start()
    camera = await open_camera(f"socket:{tmp_path / 'camera'}", CAMERA)
    await until_connected(server, 1)
    server.deliver(frame(7))
    received = await camera.next()
    assert (received.sequence, received.time_s) == (7, 0.7000000000000001)
    assert received.image.shape == (480, 640)
    assert int(received.image[0, 0]) == 7
    camera.close()
    await server.close()
    assert not (tmp_path / "camera").exists()


async def test_a_client_that_does_not_read_misses_frames_and_holds_nobody_up(tmp_path: Path) -> None:
    server = FrameServer(tmp_path / "camera")
    await server.start()
    _, lazy = await asyncio.open_unix_connection(tmp_path / "camera", limit=1024)
    await until_connected(server, 1)
    for sequence in range(100):
        server.deliver(frame(sequence))
    assert max(client.transport.get_write_buffer_size() for client in server._clients) < 2 * 640 * 480
    lazy.close()
    await server.close()


async def test_without_a_client_frames_are_dropped(tmp_path: Path) -> None:
    server = FrameServer(tmp_path / "camera")
    await server.start()
    server.deliver(frame(0))
    assert server.client_count == 0
    await server.close()


async def until_connected(server: FrameServer, clients: int) -> None:
    for _ in range(2000):
        if server.client_count >= clients:
            return
        await asyncio.sleep(0.001)
    raise AssertionError("nobody connected")
