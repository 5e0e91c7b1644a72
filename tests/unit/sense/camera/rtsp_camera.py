"""A camera by RTSP for tests: GStreamer's own server on loopback, in a process of its own (`rtsp_server`)."""

import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("rtsp_server.py")
PYTHONS = (sys.executable, "/usr/bin/python3")


@contextmanager
def rtsp_server(pictures: Iterable[bytes], port: int = 0) -> Iterator[int]:
    """Serve grey pictures, 640x480, each as it comes; the port. Skips the test where there is no server."""
    for python in PYTHONS:
        process = subprocess.Popen(
            [python, str(SCRIPT), str(port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        assert process.stdin is not None
        assert process.stdout is not None
        if line := process.stdout.readline():
            break
        process.wait()
    else:
        pytest.skip("no RTSP server: needs Debian's gir1.2-gst-rtsp-server-1.0, python3-gi and x264enc")
    thread = threading.Thread(target=_feed, args=(pictures, process), daemon=True)
    thread.start()
    try:
        yield int(line)
    finally:
        process.kill()
        process.wait()
        thread.join()


def _feed(pictures: Iterable[bytes], process: subprocess.Popen[bytes]) -> None:
    """Hand on the pictures until they or the server end."""
    assert process.stdin is not None
    with suppress(OSError):
        for picture in pictures:
            process.stdin.write(picture)
            process.stdin.flush()
    while process.poll() is None:  # the last ones are still to be sent
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.1)
