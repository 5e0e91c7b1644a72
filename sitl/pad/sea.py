"""Sea motion of a deck, in addition to its path: heave, roll and pitch, each a sum of waves.

SI; roll and pitch are the deck's own (aerospace angles after its heading), about the pad's centre. The waves
of each share a Pierson-Moskowitz spectrum's energy equally. "Significant" is the mean of the highest third of
the swings from one side to the other, 4 standard deviations, as with the height of waves.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from pydantic import Field

from companion.config import StrictModel
from sitl.pad.curves import Wave, sum_of_waves, wave_frequency

WAVES: Final = 6


class DeckSettings(StrictModel):
    """How a deck moves in the sea; its way is the pad's motion."""

    significant_height_m: float = Field(default=0.0, ge=0.0, le=4.0, description="Heave, trough to crest")
    significant_roll_deg: float = Field(
        default=0.0, ge=0.0, le=30.0, description="Roll, from one side to the other"
    )
    significant_pitch_deg: float = Field(
        default=0.0, ge=0.0, le=30.0, description="Pitch, from bow up to bow down"
    )
    peak_period_s: float = Field(default=6.0, ge=2.0, le=20.0, description="Period of heave and pitch")
    roll_period_s: float = Field(default=8.0, ge=2.0, le=30.0, description="Period of roll, a ship's own")

    def largest_excursion_m(self, half_diagonal_m: float) -> float:
        """How far the lowest corner of a board goes below the mean, all crests at once."""
        tilt = math.radians(peak(self.significant_roll_deg) + peak(self.significant_pitch_deg))
        return peak(self.significant_height_m) + half_diagonal_m * math.sin(min(tilt, 0.5 * math.pi))


class DeckState(NamedTuple):
    """Heave (m, down), roll and pitch (rad), each with its speed; the heave with its acceleration too."""

    heave: tuple[float, float, float]
    roll: tuple[float, float]
    pitch: tuple[float, float]


def peak(significant: float) -> float:
    """The largest excursion of a sum of waves: all crests at once."""
    return 0.25 * significant * math.sqrt(2.0 * WAVES)


def draw_waves(significant: float, peak_period_s: float, rng: np.random.Generator) -> tuple[Wave, ...]:
    """Amplitude, frequency (rad/s) and drawn phase of each wave."""
    amplitude = peak(significant) / WAVES
    return tuple(
        (amplitude, wave_frequency((i + 0.5) / WAVES, peak_period_s), phase)
        for i, phase in enumerate(rng.uniform(0.0, math.tau, WAVES).tolist())
    )


class DeckMotion:
    """A deck under one seed."""

    def __init__(self, settings: DeckSettings, rng: np.random.Generator) -> None:
        s = settings
        self._heave = draw_waves(s.significant_height_m, s.peak_period_s, rng)
        self._roll = draw_waves(math.radians(s.significant_roll_deg), s.roll_period_s, rng)
        self._pitch = draw_waves(math.radians(s.significant_pitch_deg), s.peak_period_s, rng)

    def at(self, time_s: float) -> DeckState:
        """The deck at a time (s)."""
        return DeckState(
            sum_of_waves(self._heave, time_s, 0.0),
            sum_of_waves(self._roll, time_s, 0.0)[:2],
            sum_of_waves(self._pitch, time_s, 0.0)[:2],
        )
