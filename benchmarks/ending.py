"""How a benchmark ends: its bars in one line, and an exit status to match."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console

from sitl.campaign.figures import Bar


def judged(console: Console, bars: Sequence[Bar]) -> int:
    """Print the bars; the exit status is 0 when there are some and all hold."""
    console.print(f"bars: {', '.join(map(str, bars))}", highlight=False, soft_wrap=True)
    return 0 if bars and all(bar.holds for bar in bars) else 1
