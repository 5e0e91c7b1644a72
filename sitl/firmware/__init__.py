"""The real PX4 and ArduCopter as the simulated vehicle's autopilot: our world is the physics, in lockstep."""


class FirmwareError(RuntimeError):
    """The firmware has ended, or does not answer; the text is one line."""
