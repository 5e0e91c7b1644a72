"""The error of a firmware that flies in lockstep."""

from __future__ import annotations


class FirmwareError(RuntimeError):
    """The firmware has ended, or does not answer; the text is one line."""
