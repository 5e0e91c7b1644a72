"""A camera by HTTP-MJPEG for tests, on loopback in threads of this process (`mjpeg_server`)."""

import http.server
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager


@contextmanager
def mjpeg_server(jpegs: Callable[[], Iterable[bytes]], port: int = 0) -> Iterator[int]:
    """Send each who asks pictures of its own, each as it comes; the port."""
    off = threading.Event()

    class Camera(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            for data in jpegs():
                if off.is_set():
                    return
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                try:
                    self.wfile.write(head.encode() + data + b"\r\n")
                except OSError:
                    return

        def log_message(self, *_: object) -> None:
            """It is quiet."""

    with http.server.ThreadingHTTPServer(("127.0.0.1", port), Camera) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_port
        off.set()
        server.shutdown()
