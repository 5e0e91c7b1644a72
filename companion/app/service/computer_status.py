"""What the machine under the app is like: its load, temperature, clock frequency and disk."""

import os
import resource
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from companion.link.codec import Message, computer_status

_THERMAL: Final = Path("/sys/class/thermal/thermal_zone0/temp")  # 0.001 deg C
_CLOCK: Final = Path("/sys/devices/system/cpu/cpu0/cpufreq")  # files in kHz
_MEGABYTE: Final = 1e6
_VCGENCMD_S: Final = 1.0
# bits of `vcgencmd get_throttled` that hold now (Raspberry Pi documentation)
_THROTTLED: Final = {0: "under-voltage", 1: "frequency capped", 2: "throttled", 3: "soft temperature limit"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ComputerStatus:
    """`cpu_percent` of one core, since the last time it was asked; None: not known here.

    `clock_mhz` is the processor's clock frequency now, `full_clock_mhz` the most that it may be.
    """

    cpu_percent: float | None = None
    memory_mb: float
    temperature_deg_c: float | None = None
    clock_mhz: float | None = None
    full_clock_mhz: float | None = None
    throttled: tuple[str, ...] | None = None
    disk_free_mb: float | None = None


class ComputerWatch:
    """Call `state` now and then; the CPU's share is that of the time between."""

    def __init__(self, now_s: float) -> None:
        self._asked_s, self._used_s = now_s, _cpu_s()

    def state(
        self, now_s: float, folder: Path | None, held_back: tuple[str, ...] | None = None
    ) -> ComputerStatus:
        """The state now; `folder` is where flights are recorded, `held_back` what `throttled` gave."""
        used_s, elapsed_s = _cpu_s(), now_s - self._asked_s
        share = 100.0 * (used_s - self._used_s) / elapsed_s if elapsed_s > 0.5 else None
        if share is not None:
            self._asked_s, self._used_s = now_s, used_s
        return ComputerStatus(
            cpu_percent=share,
            memory_mb=_memory_mb(),
            temperature_deg_c=_thousandth(_THERMAL),
            clock_mhz=_thousandth(_CLOCK / "scaling_cur_freq"),
            full_clock_mhz=_thousandth(_CLOCK / "cpuinfo_max_freq"),
            throttled=held_back,
            disk_free_mb=_disk_free_mb(folder),
        )


def ground_report(status: ComputerStatus, folder: Path | None, unix_s: float, up_s: float) -> Message:
    """The same for a ground station: the app's own share of the whole processor, its memory, the disk."""
    cores, share = os.cpu_count() or 1, status.cpu_percent
    total_mb = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / _MEGABYTE
    storage = None
    if status.disk_free_mb is not None:
        total = shutil.disk_usage(folder or Path("/")).total / _MEGABYTE
        storage = (total - status.disk_free_mb, total)
    return computer_status(
        round(1e6 * unix_s),
        round(1e3 * up_s) % 2**32,
        None if share is None else share / cores,
        status.temperature_deg_c,
        (status.memory_mb, total_mb),
        storage,
    )


def throttled() -> tuple[str, ...] | None:
    """What holds the Raspberry Pi's processor back now; None on another machine. Takes some milliseconds."""
    program = shutil.which("vcgencmd")
    if program is None:
        return None
    try:
        said = subprocess.run(
            [program, "get_throttled"], capture_output=True, text=True, timeout=_VCGENCMD_S, check=True
        ).stdout
        bits = int(said.strip().removeprefix("throttled="), 16)
    except (OSError, ValueError, subprocess.SubprocessError):
        return None
    return tuple(words for bit, words in _THROTTLED.items() if bits >> bit & 1)


def _cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def _memory_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def _thousandth(file: Path) -> float | None:
    """A thousandth of the number in a file of the kernel's; None where there is none."""
    try:
        return int(file.read_text(encoding="ascii")) / 1000.0
    except (OSError, ValueError):
        return None


def _disk_free_mb(folder: Path | None) -> float | None:
    while folder is not None and not folder.exists():
        folder = folder.parent if folder.parent != folder else None
    return None if folder is None else shutil.disk_usage(folder).free / 1e6
