"""Which MAVLink messages did not arrive, by their sequence numbers, whatever dialect they are of. Pure.

The app's codec knows one dialect and passes over what is none of it as if it were noise; an autopilot that
sends messages of a newer one would look like a bad line. Here a frame is what its header says it is, provided
that another one follows it.
"""

from __future__ import annotations

from companion.link.codec import MARKER, SIGNATURE_BYTES, SIGNED_FLAG, V2_MARKER

V2_OVERHEAD, V1_OVERHEAD = 12, 8  # header and checksum


class FrameCounter:
    """Counts frames, gaps in their senders' sequences, and bytes of no frame."""

    def __init__(self) -> None:
        self.frames = self.lost = self.stray_bytes = 0
        self._buffer = bytearray()
        self._sequences: dict[tuple[int, int], int] = {}

    def feed(self, data: bytes) -> None:
        """Take bytes in their order."""
        buffer = self._buffer
        buffer += data
        start = 0
        while (marker := MARKER.search(buffer, start)) is not None:
            self.stray_bytes += marker.start() - start
            start = marker.start()
            if len(buffer) - start < V2_OVERHEAD:
                break
            size = _size(buffer, start)
            if len(buffer) - start <= size:
                break
            if MARKER.match(buffer, start + size) is None:
                self.stray_bytes += 1
                size = 1
            else:
                self._count(buffer, start)
            start += size
        else:
            self.stray_bytes += len(buffer) - start
            start = len(buffer)
        del buffer[:start]

    def _count(self, buffer: bytearray, start: int) -> None:
        at = start + (4 if buffer[start] == V2_MARKER else 2)
        sequence, source = buffer[at], (buffer[at + 1], buffer[at + 2])
        last = self._sequences.get(source)
        self._sequences[source] = sequence
        self.frames += 1
        if last is not None:
            self.lost += (sequence - last - 1) % 256


def _size(buffer: bytearray, start: int) -> int:
    """Of the frame that would begin here."""
    if buffer[start] != V2_MARKER:
        return V1_OVERHEAD + buffer[start + 1]
    signature = SIGNATURE_BYTES if buffer[start + 2] & SIGNED_FLAG else 0
    return V2_OVERHEAD + buffer[start + 1] + signature
