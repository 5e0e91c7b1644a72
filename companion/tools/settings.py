"""`companion settings`: what each setting means, offline, from the models that check the files."""

import json
import shutil
import textwrap
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Annotated, Final, Literal

import typer
from pydantic import BaseModel

from companion.base.errors import ConfigError
from companion.config import CameraConfig, CompanionConfig, VehicleConfig
from companion.config.catalogue import Setting, settings_of
from companion.pad import Pad

SettingsFile = Literal["app", "camera", "vehicle", "pad"]
MODELS: Final[dict[SettingsFile, type[BaseModel]]] = {
    "app": CompanionConfig,
    "camera": CameraConfig,
    "vehicle": VehicleConfig,
    "pad": Pad,
}
SETTINGS_HELP: Final = """Explain settings: unit, default, bounds, meaning, and when to change them.

WORD is a key, a part of the tree, or any word of a key. Without one: the settings that an operator sets.

\b
companion settings
companion settings plan.mission
companion settings fence
companion settings --of camera

Exit codes: 0 shown, 2 no such setting.
"""
WIDEST: Final = 100


def settings_command(
    word: Annotated[str | None, typer.Argument(metavar="[WORD]", show_default=False)] = None,
    *,
    of: Annotated[SettingsFile, typer.Option("--of", help="Of which file.")] = "app",
    everything: Annotated[bool, typer.Option("--all", help="Those for experts too.")] = False,
    schema: Annotated[bool, typer.Option("--schema", help="Print the file's JSON schema instead.")] = False,
) -> None:
    if schema:
        typer.echo(json.dumps(MODELS[of].model_json_schema(), indent=2, ensure_ascii=False))
        return
    listed = chosen(list(settings_of(MODELS[of])), word, everything=everything or of != "app")
    width = min(WIDEST, shutil.get_terminal_size().columns)
    typer.echo("\n".join(line for setting in listed for line in paragraph(setting, of, width)))


def chosen(settings: list[Setting], word: str | None, *, everything: bool) -> Iterable[Setting]:
    """The settings to show; a word finds those for experts too."""
    if word is None:
        return [setting for setting in settings if everything or setting.for_operators]
    key = word.strip(".").lower()
    below = [setting for setting in settings if f"{setting.key}.".startswith(f"{key}.")]
    found = below or [setting for setting in settings if key in setting.key]
    if not found:
        names = sorted({part for setting in settings for part in setting.key.split(".")})
        near = get_close_matches(key.rpartition(".")[2], names, 1)
        hint = f", for example {near[0]}" if near else ""
        raise ConfigError(f"settings: {word}: no such setting; expected a key or a part of one{hint}")
    return found


def paragraph(setting: Setting, of: SettingsFile, width: int) -> list[str]:
    facts = [setting.unit, f"default {setting.default}", setting.bounds]
    audience = "" if of != "app" else "operator" if setting.for_operators else "expert"
    head = f"{setting.key}  ({', '.join(part for part in (*facts, audience) if part)})"
    return [
        head,
        *textwrap.wrap(
            setting.meaning, width, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False
        ),
    ]
