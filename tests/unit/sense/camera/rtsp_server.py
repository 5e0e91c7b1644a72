"""An RTSP server on loopback by GStreamer's own library, run by a Python that has it; prints its port.

Serves what comes on standard input, 640x480 in grey, as H.264 with a key frame every two seconds, as many
cameras have it, and a silent sound track.
"""

import sys
import threading
from typing import Any

import gi  # type: ignore[import-not-found, unused-ignore]

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer  # type: ignore[import-not-found, unused-ignore]  # noqa: E402

WIDTH, HEIGHT = 640, 480
LAUNCH = (
    "( appsrc name=source is-live=true do-timestamp=true format=time max-buffers=2 leaky-type=downstream "
    f'caps="video/x-raw,format=GRAY8,width={WIDTH},height={HEIGHT},framerate=30/1" '
    "! videoconvert ! video/x-raw,format=I420 ! x264enc tune=zerolatency speed-preset=ultrafast "
    "key-int-max=60 bitrate=4000 ! rtph264pay name=pay0 pt=96 "
    "audiotestsrc is-live=true wave=silence ! audio/x-raw,rate=8000,channels=1 "
    "! alawenc ! rtppcmapay name=pay1 pt=8 )"
)


def feed(sources: list[Any]) -> None:
    """Push each picture that comes into the newest source, until there are no more."""
    while len(picture := sys.stdin.buffer.read(WIDTH * HEIGHT)) == WIDTH * HEIGHT:
        for source in sources[-1:]:
            source.emit("push-buffer", Gst.Buffer.new_wrapped(picture))


def main(port: str) -> None:
    """Serve at rtsp://127.0.0.1:PORT/camera until killed."""
    Gst.init(None)
    server, factory = GstRtspServer.RTSPServer.new(), GstRtspServer.RTSPMediaFactory.new()
    server.set_address("127.0.0.1")
    server.set_service(port)
    factory.set_launch(LAUNCH)
    factory.set_shared(True)
    sources: list[Any] = []
    factory.connect(
        "media-configure", lambda _, media: sources.append(media.get_element().get_child_by_name("source"))
    )
    server.get_mount_points().add_factory("/camera", factory)
    server.attach(None)
    print(server.get_bound_port(), flush=True)
    threading.Thread(target=feed, args=(sources,), daemon=True).start()
    GLib.MainLoop().run()


if __name__ == "__main__":
    main(sys.argv[1])
