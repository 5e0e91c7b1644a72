"""What a serial receiver makes of bytes that were sent at another rate: the waveform, sampled wrongly.

8N1: a start bit (low), eight data bits with the least first, a stop bit (high). The receiver waits for a
falling edge and looks at the middle of each of its own bits. A byte whose stop bit is low (a framing error)
reads as 0, as Linux's tty gives it by default (termios(3), neither IGNPAR nor PARMRK).
"""

import math
from typing import Final

BITS_PER_BYTE: Final = 10


def as_received(data: bytes, sent_baud: int, receiver_baud: int) -> bytes:
    """The bytes that a receiver at `receiver_baud` gets of `data` sent in one go at `sent_baud`."""
    if sent_baud == receiver_baud or not data:
        return data
    wave = _waveform(data)
    ratio = sent_baud / receiver_baud  # bits of the sender in one of the receiver's
    heard = bytearray()
    at = _falling_edge(wave, 0)
    while at is not None:
        bits = [_level(wave, at + (k + 0.5) * ratio) for k in range(BITS_PER_BYTE)]
        value = sum(bit << k for k, bit in enumerate(bits[1:9]))
        stop = bits[9]
        if bits[0]:
            at = _falling_edge(wave, math.ceil(at + 0.5 * ratio))  # a spike, no start bit
            continue
        heard.append(value if stop else 0)
        at = _falling_edge(wave, math.ceil(at + (BITS_PER_BYTE - 0.5) * ratio))
    return bytes(heard)


def _waveform(data: bytes) -> list[int]:
    wave = [1]
    for byte in data:
        wave += [0, *(byte >> k & 1 for k in range(8)), 1]
    return wave


def _level(wave: list[int], at: float) -> int:
    """The line rests high before and after."""
    index = int(at)
    return wave[index] if index < len(wave) else 1


def _falling_edge(wave: list[int], start: int) -> int | None:
    for index in range(max(1, start), len(wave)):
        if wave[index - 1] and not wave[index]:
            return index
    return None
