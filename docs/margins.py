"""Picture and table of docs/explanation/margins.md: the margins of every control loop that is shipped.

    python -m docs.margins --to docs/images

writes margins.png, a Nyquist diagram for each kind of setpoint, and prints the table.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from benchmarks.control.margins import DOWN, SIDEWAYS, MarginCase, loop_transfer, margins
from companion.base.autopilot_kind import AutopilotKind
from companion.config import ControlConfig, Kind, VehicleConfig, find_file, load_model

mpl.use("Agg")

VEHICLE: Final = "x500"
LOOPS: Final[tuple[tuple[AutopilotKind, Kind], ...]] = (
    ("px4", "acceleration"),
    ("px4", "attitude"),
    ("ardupilot", "attitude"),
)
AXES: Final = {"sideways": SIDEWAYS, "down": DOWN}
COLOURS: Final = {"sideways": "#2471a3", "down": "#d68910"}
REACH: Final = 2.2


def main() -> None:
    """Draw and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--to", type=Path, default=Path("docs/images"))
    folder: Path = parser.parse_args().to
    folder.mkdir(parents=True, exist_ok=True)
    vehicle = load_model(VehicleConfig, find_file("vehicles", VEHICLE))
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    turn = np.linspace(0.0, 2.0 * math.pi, 200)
    print("| loop | phase margin | delay margin | gain margin up / down | crossover |\n|---|---|---|---|---|")
    for plot, (autopilot_kind, kind) in zip(figure.subplots(1, len(LOOPS)), LOOPS, strict=True):
        plot.plot(np.cos(turn), np.sin(turn), color="#bbbbbb", lw=0.8)
        for name, axis in AXES.items():
            response = vehicle.responses.of(autopilot_kind, kind)
            along = response.sideways if axis == SIDEWAYS else response.down
            w, L = loop_transfer(
                MarginCase(ControlConfig(setpoint=kind), vehicle, autopilot_kind, axis, along)
            )
            found = margins(w, L)
            plot.plot(L.real, L.imag, color=COLOURS[name], label=f"{name}: {found.phase_deg:.0f} deg")
            print(
                f"| {autopilot_kind} {kind}, {name} | "
                f"{found.phase_deg:.0f} deg | {1e3 * found.delay_s:.0f} ms "
                f"| {_db(found.gain_up)} / {_db(found.gain_down)} | {found.crossover_rad_s:.1f} rad/s |"
            )
        plot.plot(-1.0, 0.0, "+", color="#c0392b", ms=10)
        plot.set(xlim=(-REACH, REACH), ylim=(-REACH, REACH), aspect="equal", xlabel="Re L", ylabel="Im L")
        plot.set_title(f"{autopilot_kind}, {kind}")
        plot.legend(loc="upper right", fontsize=8)
        plot.grid(visible=True, lw=0.3)
    figure.savefig(folder / "margins.png", dpi=110)


def _db(gain: float) -> str:
    return f"{20.0 * math.log10(gain):.1f} dB" if math.isfinite(gain) else "-"


if __name__ == "__main__":
    main()
