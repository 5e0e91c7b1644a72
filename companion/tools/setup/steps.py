"""The checklist: what the wiring and the settings need of the computer, and what would be changed for it.

Each step looks at the machine as it is then, so that the list can be gone through any number of times: what
is done already is found done. Nothing is changed here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from companion.config import CompanionConfig
from companion.tools.setup.boot_files import has_overlay, parameter, with_lines, without_serial_console
from companion.tools.setup.machine import Machine, Model

MODULES_FILE: Final = "/etc/modules-load.d/companion.conf"
OFFLINE: Final = "needs a network: without one, leave it out"
I2C_BAUD: Final = "400000"
GROUPS: Final = ("companion", "dialout", "i2c", "spi", "video", "gpio")


class StepState(StrEnum):
    DONE = "done"
    TO_DO = "to do"
    LEFT_OUT = "left out"


@dataclass(frozen=True, slots=True)
class FileChange:
    """A file, and its text after the change; `added` and `removed` are what a person is shown."""

    name: str
    text: str
    added: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()


Program = tuple[str, ...]  # its words


@dataclass(frozen=True, slots=True)
class Step:
    """One line of the checklist. `needed`: by the settings; `reboots`: it counts after the next start."""

    title: str
    state: StepState
    detail: str
    needed: bool = True
    changes: tuple[FileChange | Program, ...] = ()
    reboots: bool = False


def _done(title: str, detail: str, *, needed: bool = True) -> Step:
    return Step(title, StepState.DONE, detail, needed)


def _left_out(title: str, why: str) -> Step:
    return Step(title, StepState.LEFT_OUT, why, needed=False)


# ---------------------------------------------------------------- the boot partition


def _in_config_txt(machine: Machine, title: str, missing: tuple[str, ...]) -> tuple[FileChange, ...]:
    if not missing:
        return ()
    name = machine.boot_file("config.txt")
    return (FileChange(name, with_lines(machine.read(name) or "", title, missing), added=missing),)


def _is_set(machine: Machine, model: Model, line: str) -> bool:
    text = machine.read(machine.boot_file("config.txt")) or ""
    kind, _, rest = line.partition("=")
    if kind == "dtoverlay":
        return has_overlay(text, model.sections, rest)
    name, _, value = rest.partition("=")
    return parameter(text, model.sections, name) == value


def _uart(
    machine: Machine, title: str, pick: Callable[[Model], str | None], why: str, *, needed: bool
) -> Step:
    model = machine.model
    if model is None:
        return _left_out(title, machine.no_model)
    line = pick(model)
    if line is None:
        return _left_out(
            title, f"a {model.name} has no further UART: use a USB adapter, or USB of the device"
        )
    return _line(machine, model, title, line, line, why, needed=needed)


def _line(
    machine: Machine, model: Model, title: str, line: str, done: str, why: str, *, needed: bool
) -> Step:
    if _is_set(machine, model, line):
        return _done(title, done, needed=needed)
    changes = _in_config_txt(machine, title, (line,))
    return Step(title, StepState.TO_DO, why, needed, changes, reboots=True)


def gps_uart(machine: Machine, config: CompanionConfig) -> Step:
    """The UART of pins 8 and 10."""
    needed = config.sense.source == "boards"
    why = f"sense.gps.port: {config.sense.gps.port}; up to the Pi 4 Bluetooth gives it up"
    return _uart(machine, "UART for the GPS, pins 8 and 10", lambda model: model.gps, why, needed=needed)


def autopilot_uart(machine: Machine, config: CompanionConfig) -> Step:
    """The UART of pins 7 and 29."""
    connection = config.link.connection
    needed = connection.startswith(("serial:/dev/ttyAMA", "serial:/dev/serial"))
    title = "UART for the autopilot, pins 7 and 29"
    return _uart(
        machine, title, lambda model: model.autopilot, f"link.connection: {connection}", needed=needed
    )


def rangefinder_uart(machine: Machine, config: CompanionConfig) -> Step:
    """The UART of pins 32 and 33."""
    sense = config.sense
    needed = sense.source == "boards" and sense.range.kind != "gpio"
    why = f"sense.range.kind: {sense.range.kind}, port: {sense.range.port}"
    title = "UART for the rangefinder, pins 32 and 33"
    return _uart(machine, title, lambda model: model.rangefinder, why, needed=needed)


def serial_console(machine: Machine, config: CompanionConfig) -> Step:
    """No login console on a serial line."""
    title, name = "login console off the serial port", machine.boot_file("cmdline.txt")
    text = machine.read(name)
    if machine.model is None or text is None:
        return _left_out(title, machine.no_model if machine.model is None else f"there is no {name}")
    after = without_serial_console(text)
    if after == text:
        return _done(title, f"{name} has none")
    removed = tuple(word for word in text.split() if word not in after.split())
    change = FileChange(name, after, removed=removed)
    return Step(title, StepState.TO_DO, "else it talks to the GPS", True, (change,), reboots=True)


def i2c(machine: Machine, config: CompanionConfig) -> Step:
    """The I2C bus, its speed, and /dev/i2c-1 (the module i2c-dev)."""
    title, model = "I2C at 400 kHz, and /dev/i2c-1", machine.model
    needed = config.sense.source == "boards" and config.sense.imu.bus.startswith("i2c:")
    if model is None:
        return _left_out(title, machine.no_model)
    lines = ("dtparam=i2c_arm=on", f"dtparam=i2c_arm_baudrate={I2C_BAUD}")
    missing = tuple(line for line in lines if not _is_set(machine, model, line))
    files = ("/etc/modules", MODULES_FILE, "/etc/modules-load.d/modules.conf")
    loaded = any("i2c-dev" in (machine.read(name) or "").split() for name in files)
    module: tuple[FileChange | Program, ...] = ()
    if not loaded:
        text = (machine.read(MODULES_FILE) or "") + "i2c-dev\n"
        module = (FileChange(MODULES_FILE, text, added=("i2c-dev",)), ("modprobe", "i2c-dev"))
    changes = (*_in_config_txt(machine, title, missing), *module)
    if not changes:
        return _done(title, "on, i2c-dev is loaded at the start", needed=needed)
    why = f"sense.imu.bus: {config.sense.imu.bus}"
    return Step(title, StepState.TO_DO, why, needed, changes, reboots=bool(missing))


def spi(machine: Machine, config: CompanionConfig) -> Step:
    title, model = "SPI", machine.model
    needed = config.sense.source == "boards" and config.sense.imu.bus.startswith("spi:")
    if model is None:
        return _left_out(title, machine.no_model)
    why = f"sense.imu.bus: {config.sense.imu.bus}"
    return _line(machine, model, title, "dtparam=spi=on", "on", why, needed=needed)


# ---------------------------------------------------------------- the system


def groups(machine: Machine, config: CompanionConfig) -> Step:
    """The user who runs sudo may ask the service, and use the devices for calibrations."""
    title, user = "groups of the user", machine.user
    if user is None:
        names = ",".join(GROUPS)
        return _left_out(title, f"no user named; expected sudo by that user, or: usermod -aG {names} USER")
    members = machine.group_members()
    missing = [group for group in GROUPS if group in members and user not in members[group]]
    if not missing:
        return _done(title, f"{user} is in all that there are")
    change = ("usermod", "--append", "--groups", ",".join(missing), user)
    why = f"{user} may ask the service and calibrate; counts from the next login on"
    return Step(title, StepState.TO_DO, why, True, (change,))


def packages(machine: Machine, config: CompanionConfig) -> Step:
    """What comes with the distribution only: picamera2, spidev, and for pins gpiozero and lgpio."""
    title, sense = "system packages", config.sense
    wanted = {
        "picamera2": sense.vision.source.startswith("picamera2:"),
        "spidev": sense.source == "boards" and sense.imu.bus.startswith("spi:"),
        "gpiozero": sense.source == "boards" and sense.range.kind == "gpio",
        "lgpio": sense.source == "boards" and sense.range.kind == "gpio",
    }
    if not any(wanted.values()):
        return _done(title, "the settings need none")
    missing = [module for module, need in wanted.items() if need and not machine.has_module(module)]
    if not missing:
        return _done(title, f"{', '.join(module for module, need in wanted.items() if need)}: there")
    names = tuple(f"python3-{module}" for module in missing)
    install = ("apt-get", "install", "--yes", "--no-install-recommends", *names)
    why = f"the settings need {', '.join(missing)}; {OFFLINE}"
    return Step(title, StepState.TO_DO, why, True, (("apt-get", "update"), install))


def time_synchronisation(machine: Machine, config: CompanionConfig) -> Step:
    """The clock is set whenever there is a network: logs and signing want it."""
    title = "time synchronisation"
    if any(machine.run(("systemctl", "is-active", "--quiet", unit))[0] == 0 for unit in ("chrony", "ntpsec")):
        return _done(title, "chrony or ntpsec runs")
    code, told = machine.run(("timedatectl", "show", "--property=NTP", "--property=CanNTP"))
    if code != 0:
        return _left_out(title, "no timedatectl here")
    if "NTP=yes" in told.split():
        return _done(title, "on")
    on = ("timedatectl", "set-ntp", "true")
    why = "logs and signing need the date; a Raspberry Pi does not keep it"
    if "CanNTP=no" in told.split():
        install = ("apt-get", "install", "--yes", "systemd-timesyncd")
        return Step(title, StepState.TO_DO, f"{why}; {OFFLINE}", True, (install, on))
    return Step(title, StepState.TO_DO, why, True, (on,))


STEPS: Final[tuple[Callable[[Machine, CompanionConfig], Step], ...]] = (
    gps_uart,
    autopilot_uart,
    rangefinder_uart,
    serial_console,
    i2c,
    spi,
    groups,
    packages,
    time_synchronisation,
)
