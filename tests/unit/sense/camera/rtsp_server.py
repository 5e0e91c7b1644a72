"""An RTSP server on loopback by GStreamer's own library, run by a Python that has it; prints its port.

640x480 in H.264, 30 frames a second; the upper rows of each say when it was made, as `stamped_picture` does.
"""

import random
import sys
import time
from typing import Any

import gi  # type: ignore[import-not-found, unused-ignore]

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer  # type: ignore[import-not-found, unused-ignore]  # noqa: E402

WIDTH, HEIGHT, ROWS, BITS = 640, 480, 40, 24
LAUNCH = (
    "( appsrc name=source is-live=true do-timestamp=true format=time "
    f'caps="video/x-raw,format=GRAY8,width={WIDTH},height={HEIGHT},framerate=30/1" '
    "! videoconvert ! video/x-raw,format=I420 ! x264enc tune=zerolatency speed-preset=ultrafast "
    "key-int-max=30 bitrate=4000 ! rtph264pay name=pay0 pt=96 )"
)


class Pusher:
    """Pushes a frame whenever one is due and wanted."""

    def __init__(self) -> None:
        draw = random.Random(0)
        self._bodies = [bytes(draw.choices(range(80, 120), k=WIDTH * (HEIGHT - ROWS))) for _ in range(3)]
        self._number, self._due_s = 0, 0.0

    def push(self, source: Any, _: int) -> None:
        """One frame, at its time."""
        self._due_s = max(self._due_s + 1 / 30, time.monotonic())
        time.sleep(max(0.0, self._due_s - time.monotonic()))
        made_ms = int(1e3 * time.monotonic())
        row = b"".join((b"\xff" if made_ms >> bit & 1 else b"\0") * BITS for bit in range(BITS))
        frame = row.ljust(WIDTH, b"\x60") * ROWS + self._bodies[self._number % 3]
        source.emit("push-buffer", Gst.Buffer.new_wrapped(frame))
        self._number += 1


def main(port: str) -> None:
    """Serve at rtsp://127.0.0.1:PORT/camera until killed."""
    Gst.init(None)
    server, factory = GstRtspServer.RTSPServer.new(), GstRtspServer.RTSPMediaFactory.new()
    server.set_address("127.0.0.1")
    server.set_service(port)
    factory.set_launch(LAUNCH)
    factory.connect(
        "media-configure",
        lambda _, media: media.get_element().get_child_by_name("source").connect("need-data", Pusher().push),
    )
    server.get_mount_points().add_factory("/camera", factory)
    server.attach(None)
    print(server.get_bound_port(), flush=True)
    GLib.MainLoop().run()


if __name__ == "__main__":
    main(sys.argv[1])
