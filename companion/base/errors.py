"""Errors that end in one line for the user."""


class ConfigError(Exception):
    """A setting, a file or an option that the user can correct; the text is the one line to show."""


class DeviceMissing(ConfigError):  # noqa: N818 - it reads as what happened
    """A device that the settings name is not there now. It may be plugged in, or boot, later."""
