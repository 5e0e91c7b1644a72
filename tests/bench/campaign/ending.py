"""How benchmarks of many flights end: the bars in one line, an exit status to match, one line on Ctrl-C."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

from rich.console import Console

from companion.config import ConfigError
from sitl.campaign.figures import Bar


def judged(console: Console, bars: Sequence[Bar]) -> int:
    """Print the bars; the exit status is 0 when there are some and all hold."""
    console.print(f"bars: {', '.join(map(str, bars))}", highlight=False, soft_wrap=True)
    return 0 if bars and all(bar.holds for bar in bars) else 1


def run_bench(main: Callable[[], int]) -> NoReturn:
    """Run a resumable benchmark to its end.

    Raises:
        SystemExit: always.
    """
    try:
        sys.exit(main())
    except ConfigError as problem:
        sys.exit(str(problem))
    except KeyboardInterrupt:
        sys.exit("stopped; the same command goes on")
