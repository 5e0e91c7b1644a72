"""The example of docs/reference/camera-frames.md feeds the app: run as written, in its own process."""

import asyncio
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np

from companion.base.clock import Clock
from companion.config import CONFIG_FOLDER, CameraConfig, find_file, load_model
from companion.sense.camera.source import open_camera

PAGE = (CONFIG_FOLDER.parent / "docs" / "reference" / "camera-frames.md").read_text(encoding="utf-8")


def example(folder: Path) -> Path:
    found = re.search(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    assert found is not None
    assert len(found[1].splitlines()) <= 25
    path = folder / "feed.py"
    path.write_text(found[1])
    return path


async def test_the_example_feeds_the_app(tmp_path: Path) -> None:
    camera = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
    pictures = tmp_path / "pictures"
    await asyncio.to_thread(pictures.mkdir)
    for k in range(2):
        cv2.imwrite(str(pictures / f"{k}.png"), np.full((480, 640), 50 + 100 * k, np.uint8))
    words = (sys.executable, str(example(tmp_path)), str(tmp_path / "frames"), str(pictures))
    process = await asyncio.to_thread(subprocess.Popen, words, stderr=subprocess.DEVNULL)
    try:
        while not await asyncio.to_thread((tmp_path / "frames").is_socket):  # noqa: ASYNC110 - a process's
            await asyncio.sleep(0.05)
        await asyncio.sleep(0.1)  # between bind and listen
        source = await open_camera(f"socket:{tmp_path / 'frames'}", camera)
        frames = [await asyncio.wait_for(source.next(), 5.0) for _ in range(3)]
        source.close()
    finally:
        process.kill()
        await asyncio.to_thread(process.wait)
    assert [f.sequence for f in frames] == sorted({f.sequence for f in frames})
    assert {int(f.image[0, 0]) for f in frames} <= {50, 150}
    assert all(0.0 <= f.received_s - f.time_s < 1.0 for f in frames)
    assert frames[-1].time_s <= Clock().now_s()
