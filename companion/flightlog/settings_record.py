"""The settings and versions that a flight is flown with, as a log holds them."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping

import yaml
from pydantic import BaseModel

from companion.flightlog.version import versions


@dataclasses.dataclass(frozen=True, slots=True)
class SettingsRecord:
    """Settings and versions as a log holds them: `models` as JSON by name, `text` the YAML for people."""

    settings: Mapping[str, BaseModel]
    models: dict[str, str]
    versions: dict[str, str]
    text: str

    @classmethod
    def of(cls, settings: Mapping[str, BaseModel]) -> SettingsRecord:
        """Asks git for the revision and writes YAML: 0.05 s on a desktop."""
        known = versions()
        models = {name: model.model_dump_json() for name, model in settings.items()}
        plain = {"versions": known, **{name: json.loads(text) for name, text in models.items()}}
        text = yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, width=110)
        return cls(settings, models, known, text)
