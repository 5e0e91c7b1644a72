"""What a person looks at after a flight: the table, the plots as pictures, and the page."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from companion.base.errors import ConfigError
from companion.flightlog.log_file import LOG_NAMES, find_log

PAGE_NAME: Final = "report.html"


def write_report(path: Path, output: Path | None = None, bounds: Mapping[str, float] | None = None) -> Path:
    """Write the page of a flight, and return where; `bounds`: what passes, by the touchdown's keys.

    Raises:
        ConfigError: there is no flight, plotly is missing, or the page cannot be written.
    """
    log = find_log(path)
    try:
        from companion.flightlog.report.page import write_page  # noqa: PLC0415 - may be left out
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "plotly":
            raise
        raise ConfigError("the report needs plotly; expected it installed: pip install plotly") from None
    from companion.flightlog.report.logged_flight import read_flight  # noqa: PLC0415 - reported first

    beside = log.with_name(PAGE_NAME) if log.name == LOG_NAMES[0] else log.with_suffix(".html")
    write_page(read_flight(log), output or beside, bounds)
    return output or beside
