"""Errors that end in one line for the user."""

import errno
from typing import Final

# what opening a device that is not there ends in; what has just been plugged in may be nobody's yet, and a
# unit's list of devices may be older than its driver (EPERM)
ABSENT: Final = frozenset(
    {errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.EIO, errno.EACCES, errno.EPERM, errno.EBUSY, errno.EAGAIN}
)


class ConfigError(Exception):
    """A setting, a file or an option that the user can correct; the text is the one line to show.

    It ends the program with that line (`companion.base.command_line`). Commands and what they call say that
    they raise it only where somebody handles it before.
    """


class DeviceMissing(ConfigError):  # noqa: N818 - it reads as what happened
    """A device that the settings name is not there now. It may be plugged in, or boot, later."""
