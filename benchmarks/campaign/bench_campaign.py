"""How much faster a campaign is on two jobs than on one, and that its runs are the same to the bit.

    python -m benchmarks campaign --runs 100

Flies one scenario under so many seeds on one job, then on two, each with workers of its own: what they cost
to start is part of it. Needs the machine to itself. Ends in one line that says whether the bar holds; the
exit status is 0 when it does.
"""

import argparse
from collections.abc import Sequence
from typing import Any, Final

from rich.progress import track

from benchmarks.report import BenchReport
from companion.base.clock import wall_clock_s
from sitl.campaign.manifest import CampaignRun, make_plan
from sitl.campaign.worker import fly_locally

SMOKE: Final = ("--runs", "1")
JOBS: Final = 2
FASTER: Final = 1.8


def timed(flights: Sequence[CampaignRun], jobs: int, report: BenchReport) -> tuple[float, dict[int, Any]]:
    """Fly on so many jobs: seconds it took, and each seed's result but for what depends on the machine."""
    started_s = wall_clock_s()
    ended = track(fly_locally(flights, jobs), f"jobs: {jobs}", len(flights), console=report, transient=True)
    results = {flown.flight.seed: flown.result or {"failed": flown.error} for flown in ended}
    taken_s = wall_clock_s() - started_s
    for result in results.values():
        result.pop("sim", None)
    report.show(f"{len(flights)} runs on {jobs} job(s): {taken_s:.1f} s")
    return taken_s, results


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenario", default="static")
    parser.add_argument("--runs", type=int, default=100)
    chosen = parser.parse_args(arguments)
    flights = list(make_plan([chosen.scenario], 0, chosen.runs, None).flights())
    report = BenchReport()
    one_s, alone = timed(flights, 1, report)
    several_s, together = timed(flights, JOBS, report)
    failed = [result["failed"] for result in (*alone.values(), *together.values()) if "failed" in result]
    faster = one_s / several_s
    held = {
        f"{faster:.2f} x as fast on {JOBS} jobs (>= {FASTER:g})": faster >= FASTER,
        "same results to the bit": alone == together,
        f"{len(failed)} failed": not failed,
    }
    return report.judge(held)
