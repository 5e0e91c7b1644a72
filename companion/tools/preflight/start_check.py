"""Whether the service would start: everything it reads before it opens a device, read as the user who asks.

    python -m companion.tools.preflight.start_check FILE

The installer asks a new version this before it switches to it (systemd/versions.sh). Exit codes: 0 all is
read, 2 something is not, with one line that says what.
"""

import sys
from pathlib import Path

from companion.app.page.access import read_access
from companion.app.sensing import load_used_magnetometer
from companion.config import (
    CameraConfig,
    ConfigError,
    find_file,
    load_config,
    load_inertial,
    load_model,
    load_vehicle,
)
from companion.link.signing import read_signing_key
from companion.pad import load_pad


def check_start(path: Path) -> None:
    """Read the settings, and the files, keys and tokens that they name."""
    config = load_config(path)
    load_model(CameraConfig, find_file("cameras", config.camera))
    load_vehicle(config.vehicle, config.mount, config.camera)
    load_pad(config.pad)
    load_used_magnetometer(config.sense)
    load_inertial(config.sense)
    if config.link.signing_key is not None:
        read_signing_key(config.link.signing_key, 0.0)
    read_access(config.serve)


def main(words: list[str]) -> int:
    if len(words) != 1:
        print("start_check: expected one FILE, the settings", file=sys.stderr)
        return 2
    try:
        check_start(Path(words[0]))
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
