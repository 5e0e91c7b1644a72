"""What the app says, heard on its line: STATUSTEXT, the phases and the first sighting in it. Sans I/O.

A fault can begin by it, and a judge of the flight reads it. Only what the app says to everybody is heard.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from sitl.mavlink.framing import FrameReader, MavFrame, dialect

mavlink: Any = dialect

_WHOLE_CHUNK_BYTES: Final = 50
_SIGHTING: Final = "pad seen"


class AppText(NamedTuple):
    """One text: when (s of the simulation), MAV_SEVERITY, and the words."""

    time_s: float
    severity: int
    text: str


class StatusTextMonitor:
    """Collects an app's texts. The bytes are whole frames."""

    def __init__(self) -> None:
        self.texts: list[AppText] = []
        self.phase_began_s: dict[str, float] = {}
        self.sighted_s: float | None = None
        self._reader = FrameReader(datagrams=True)
        self._decoder = mavlink.MAVLink(None)
        self._chunks: dict[int, list[str]] = {}

    def hear(self, data: bytes, now_s: float) -> None:
        """Take bytes that the app has just sent."""
        for frame in self._reader.read(data, now_s):
            if frame.message_id == mavlink.MAVLINK_MSG_ID_STATUSTEXT:
                self._take(frame, now_s)

    def _take(self, frame: MavFrame, now_s: float) -> None:
        message = self._decoder.decode(bytearray(frame.data))
        words = str(message.text)
        if message.id != 0:
            self._chunks.setdefault(message.id, []).append(words)
            if len(words.encode("utf-8", "replace")) >= _WHOLE_CHUNK_BYTES:
                return
            words = "".join(self._chunks.pop(message.id))
        self._note(AppText(now_s, int(message.severity), words))

    def _note(self, said: AppText) -> None:
        self.texts.append(said)
        phase, colon, rest = said.text.partition(": ")
        if not colon:
            return
        self.phase_began_s.setdefault(phase, said.time_s)
        if self.sighted_s is None and rest.startswith(_SIGHTING):
            self.sighted_s = said.time_s
