"""The definition of a campaign: scenarios, seeds, settings and code, each by its content.

The manifest is stored with the rows. A command that differs from it is rejected, so that a table never
mixes two campaigns; one with more seeds or more scenarios continues the campaign.
"""

import hashlib
import shlex
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final, Literal

from pydantic import ValidationError

from companion import __version__
from companion.config import (
    CONFIG_FOLDER,
    CompanionConfig,
    ConfigError,
    StrictModel,
    find_file,
    load_config,
    merge,
    validate,
)
from sitl.firmware.spec import FirmwareSpec
from sitl.scenario.listing import shipped
from sitl.scenario.scenario import Scenario, load_scenario

MANIFEST_NAME: Final = "campaign.json"
SHIPPED_SETTINGS: Final = CONFIG_FOLDER / "companion.yaml"
PACKAGES: Final = ("companion", "sitl")
_SOURCES: Final = Path(__file__).resolve().parents[2]
_DIGEST_LENGTH: Final = 12


@dataclass(frozen=True, slots=True)
class CampaignRun:
    """One run to fly. `source` is what `--scenario` takes, `scenario` the name in the file.

    `identity` is the digest of its files, settings and code, all but the seed.
    """

    scenario: str
    source: str
    seed: int
    config: str | None
    time_limit_s: float
    identity: str
    firmware: FirmwareSpec | None = None

    @property
    def command(self) -> str:
        words = ["companion", "--sitl", "--fast", "--scenario", self.source, "--seed", str(self.seed)]
        words += () if self.firmware is None else self.firmware.options
        return shlex.join(words if self.config is None else [*words, "--config", self.config])


class Entry(StrictModel):
    """A scenario of a campaign; the digest covers the settings under its overrides too."""

    source: str
    digest: str


class Manifest(StrictModel):
    """The definition of a campaign."""

    format: Literal[1] = 1
    version: str
    code: str
    config: str | None
    settings: str
    scenarios: dict[str, Entry]
    first_seed: int
    runs: int
    firmware: tuple[str, ...] = ()  # the command line's options that name it; none: the bundled autopilot

    @property
    def seeds(self) -> range:
        return range(self.first_seed, self.first_seed + self.runs)


@dataclass(frozen=True, slots=True)
class Plan:
    """A campaign to fly: its manifest and its scenarios by name."""

    manifest: Manifest
    scenarios: dict[str, Scenario]
    firmware: FirmwareSpec | None = None

    def flights(self) -> Iterator[CampaignRun]:
        """Every run, seed by seed, so that one which is cut short has flown all scenarios alike."""
        manifest = self.manifest
        for seed in manifest.seeds:
            for name, entry in manifest.scenarios.items():
                limit_s = self.scenarios[name].time_limit_s
                identity = f"{manifest.code}-{entry.digest}"
                yield CampaignRun(name, entry.source, seed, manifest.config, limit_s, identity, self.firmware)


def make_plan(
    sources: Sequence[str],
    first_seed: int,
    runs: int,
    config: Path | None,
    firmware: FirmwareSpec | None = None,
) -> Plan:
    """Read what is to be flown; "all" stands for every shipped scenario.

    Raises:
        ConfigError: a scenario or the settings are wrong, or two scenarios have one name.
    """
    entries: dict[str, Entry] = {}
    scenarios: dict[str, Scenario] = {}
    settings = None if config is None else str(config.resolve())
    for source in dict.fromkeys(_command_word(source) for source in _expanded(sources)):
        scenario = load_scenario(source)
        if scenario.name in entries:
            first = entries[scenario.name].source
            raise ConfigError(
                f"--scenarios: {first} and {source} are both '{scenario.name}'; expected two names"
            )
        scenarios[scenario.name] = scenario
        entries[scenario.name] = Entry(source=source, digest=scenario_digest(source, settings))
    manifest = Manifest(
        version=__version__,
        code=code_digest(),
        config=settings,
        settings=_digest([load_config(config or SHIPPED_SETTINGS).model_dump_json().encode()]),
        scenarios=entries,
        first_seed=first_seed,
        runs=runs,
        firmware=() if firmware is None else firmware.options,
    )
    return Plan(manifest, scenarios, firmware)


def _expanded(sources: Sequence[str]) -> Iterator[str]:
    for source in sources:
        if source == "all":
            yield from shipped()
        else:
            yield source


def _command_word(source: str) -> str:
    """The `--scenario` argument for any working directory: a name stays, a path becomes absolute."""
    path = find_file("scenarios", source)
    return (
        source
        if path.parent == CONFIG_FOLDER / "scenarios" and not Path(source).suffix
        else str(path.resolve())
    )


# ---------------------------------------------------------------- digests


def scenario_digest(source: str, config: str | None) -> str:
    """Digest of a scenario under the app's settings, and of the files that the two name.

    Raises:
        ConfigError: one of them is wrong or missing.
    """
    scenario = load_scenario(source)
    settings = load_config(SHIPPED_SETTINGS if config is None else Path(config))
    merged = validate(
        CompanionConfig, merge(settings.model_dump(), scenario.companion), f"{source}: companion"
    )
    files = (
        find_file("airframes", scenario.airframe),
        find_file("pads", scenario.pad.name),
        find_file("cameras", scenario.camera.config),
        find_file("pads", merged.pad),
        find_file("cameras", merged.camera),
        find_file("vehicles", merged.vehicle),
        find_file("fuzzy", merged.plan.fuzzy),
    )
    texts = (scenario.model_dump_json().encode(), merged.model_dump_json().encode())
    return _digest([*texts, *(path.read_bytes() for path in files)])


@cache
def code_digest() -> str:
    """Digest of the program's own sources: another version of them may fly otherwise."""
    paths = sorted(path for package in PACKAGES for path in (_SOURCES / package).rglob("*.py"))
    return _digest(
        part for path in paths for part in (str(path.relative_to(_SOURCES)).encode(), path.read_bytes())
    )


def _digest(parts: Iterable[bytes]) -> str:
    """A digest of parts, each by itself, so that no two lists of parts run together."""
    total = hashlib.sha256()
    for part in parts:
        total.update(hashlib.sha256(part).digest())
    return total.hexdigest()[:_DIGEST_LENGTH]


# ---------------------------------------------------------------- the file


def read_manifest(folder: Path) -> Manifest | None:
    """The manifest in a folder; None when there is none.

    Raises:
        ConfigError: the file is none.
    """
    path = folder / MANIFEST_NAME
    if not path.exists():
        return None
    try:
        return Manifest.model_validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise ConfigError(f"{path}: is no campaign's manifest; expected one, or another --out") from error


def check_goes_on(old: Manifest, new: Manifest, folder: Path) -> None:
    """Check that a new command continues the campaign in a folder.

    Raises:
        ConfigError: it is another campaign; the message names the difference.
    """
    if (difference := _difference(old, new)) is not None:
        raise ConfigError(
            f"--out {folder}: holds another campaign: {difference}; expected the same or a new folder"
        )


def _difference(old: Manifest, new: Manifest) -> str | None:
    if (old.version, old.code) != (new.version, new.code):
        return f"flown by version {old.version} ({old.code}), this is {new.version} ({new.code})"
    if old.settings != new.settings:
        return (
            f"the app's settings were {old.config or 'the shipped ones'} ({old.settings}), now {new.settings}"
        )
    if old.firmware != new.firmware:
        return f"its firmware is {shlex.join(old.firmware) or 'the bundled autopilot'}"
    if (other := _other_scenario(old, new)) is not None:
        return other
    if not set(old.seeds) <= set(new.seeds):
        return f"its seeds are {old.seeds[0]} to {old.seeds[-1]}"
    return None


def _other_scenario(old: Manifest, new: Manifest) -> str | None:
    for name, entry in old.scenarios.items():
        if name not in new.scenarios:
            return f"it flies '{name}' too"
        if new.scenarios[name].digest != entry.digest:
            return f"'{name}' ({entry.source}) or a file that it names has changed"
    return None
