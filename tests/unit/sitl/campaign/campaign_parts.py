"""Flights, rows and scenario files for the tests of campaigns."""

from pathlib import Path
from typing import Any

import yaml

from sitl.campaign.manifest import CampaignRun
from sitl.campaign.rows import Row


def flight(seed: int, scenario: str = "static", **changes: Any) -> CampaignRun:
    """A run that is to be flown."""
    values = {"source": scenario, "config": None, "time_limit_s": 60.0, "identity": "code-files"}
    return CampaignRun(scenario=scenario, seed=seed, **{**values, **changes})


def row(scenario: str = "static", seed: int = 0, outcome: str = "landed", **values: Any) -> Row:
    """A run that has ended; a `lateral_m` puts the touchdown there, straight ahead of the centre."""
    lateral_m = values.pop("lateral_m", None)
    place = {} if lateral_m is None else {"touchdown_lateral_m": lateral_m, "touchdown_along_m": lateral_m}
    across = {} if lateral_m is None else {"touchdown_across_m": 0.0}
    fixed = {
        "wall_s": 9.0,
        "version": "0.1.0+abc",
        "command": f"companion --scenario {scenario} --seed {seed}",
    }
    return Row.model_validate(
        {"scenario": scenario, "seed": seed, "outcome": outcome, **fixed, **place, **across, **values}
    )


def scenario_file(folder: Path, name: str = "short", **values: Any) -> Path:
    """A scenario as a file; by default it is over at once."""
    path = folder / f"{name}.yaml"
    path.write_text(
        yaml.safe_dump({"name": name, "description": "For a test.", "time_limit_s": 5.0, **values})
    )
    return path


PLOTS = {f"{name}.png" for name in ("outcomes", "lateral", "vertical_speed", "touchdowns")}
