"""Settings and scenario files, spoilt as text and as trees: each loads, or ends in one line."""

from __future__ import annotations

import random
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Final

from benchmarks.mutations.mutating import spoiled_text, spoiled_tree
from companion.config import (
    CONFIG_FOLDER,
    CameraConfig,
    CompanionConfig,
    ConfigError,
    VehicleConfig,
    load_config,
    load_model,
    read_yaml,
    validate,
)
from companion.pad import load_pad
from companion.plan.speed.fuzzy_rules import load_rules
from sitl.scenario.scenario import Scenario, load_airframe, load_scenario

_LONGEST_LINE: Final = 1500  # all kinds of fault by name are 1200
Loader = Callable[[Path], Any]
_LOADERS: Final[tuple[tuple[str, Loader], ...]] = (
    ("companion.yaml", load_config),
    ("scenarios/*.yaml", load_scenario),
    ("vehicles/*.yaml", lambda path: load_model(VehicleConfig, path)),
    ("cameras/*.yaml", lambda path: load_model(CameraConfig, path)),
    ("pads/*.yaml", load_pad),
    ("fuzzy/*.yaml", load_rules),
    ("airframes/*.yaml", load_airframe),
)


def texts(rng: random.Random) -> Iterator[None]:
    """Every shipped file with its text spoilt."""
    files = [(path, load) for pattern, load in _LOADERS for path in sorted(CONFIG_FOLDER.glob(pattern))]
    read = [(path.read_text(encoding="utf-8"), load) for path, load in files]
    with tempfile.TemporaryDirectory(prefix="bench-mutations-") as folder:
        path = Path(folder) / "spoilt.yaml"
        while True:
            text, load = rng.choice(read)
            path.write_bytes(spoiled_text(rng, text))
            _load(partial(load, path))
            yield


def trees(rng: random.Random) -> Iterator[None]:
    """Settings and scenarios with every value written out, some of them others."""
    whole = CompanionConfig().model_dump(mode="json")
    plain = [(CompanionConfig, whole), (CompanionConfig, read_yaml(CONFIG_FOLDER / "companion.yaml"))]
    models: list[tuple[type[Any], dict[str, Any]]] = [*plain]
    for path in sorted((CONFIG_FOLDER / "scenarios").glob("*.yaml")):
        models.append((Scenario, read_yaml(path)))
        models.append((Scenario, load_scenario(path).model_dump(mode="json", by_alias=True)))
    while True:
        model, tree = rng.choice(models)
        spoilt = spoiled_tree(rng, tree)
        _load(partial(validate, model, spoilt, "spoilt.yaml"))
        yield


def _load(load: Callable[[], Any]) -> None:
    try:
        load()
    except ConfigError as error:
        words = str(error)
        assert "\n" not in words, f"more than one line: {words!r}"
        assert len(words) <= _LONGEST_LINE, f"{len(words)} characters: {words[:200]!r}"
