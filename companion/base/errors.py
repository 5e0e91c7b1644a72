"""Errors that end in one line for the user."""


class ConfigError(Exception):
    """A setting, a file or an option that the user can correct; the text is the one line to show.

    It ends the program with that line (`companion.base.command_line`). Commands and what they call say that
    they raise it only where somebody handles it before.
    """


class DeviceMissing(ConfigError):  # noqa: N818 - it reads as what happened
    """A device that the settings name is not there now. It may be plugged in, or boot, later."""
