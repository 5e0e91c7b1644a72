"""Units of the magnetic field: by name, by a column's heading, or worked out from the field's size.

The Earth's field is between 22 and 67 µT everywhere on the ground.
"""

from __future__ import annotations

from typing import Final

# µT in one of each
UT_PER: Final = {"T": 1e6, "G": 100.0, "mT": 1e3, "uT": 1.0, "mG": 0.1, "nT": 1e-3}
_SPELLINGS: Final = {
    "t": "T", "tesla": "T", "g": "G", "gs": "G", "gauss": "G", "ga": "G", "mt": "mT", "millitesla": "mT",
    "ut": "uT", "µt": "uT", "μt": "uT", "microtesla": "uT", "mg": "mG", "mgauss": "mG", "mga": "mG",
    "milligauss": "mG", "nt": "nT", "nanotesla": "nT",
    "counts": "counts", "count": "counts", "lsb": "counts", "raw": "counts", "adc": "counts",
}  # fmt: skip
COUNTS: Final = "counts"
EARTH_UT: Final = (22.0, 67.0)
_SENSOR_TOLERANCE: Final = 1.3  # a sensor's own scale may be off by so much


def unit_called(name: str) -> str | None:
    """The unit of a spelling ("µT", "gauss", "LSB"); None when it is none."""
    return _SPELLINGS.get(name.strip().lower())


def infer_unit(radius: float, field_ut: float | None, *, whole_numbers: bool) -> str:
    """The unit in which a field of this size (the ellipsoid's mean radius) is the Earth's; else counts.

    Whole numbers are an ADC's as likely as anything's: without `field_ut`, the field's known size, they stay
    counts.
    """
    low, high = (field_ut, field_ut) if field_ut is not None else EARTH_UT
    if whole_numbers and field_ut is None:
        return COUNTS
    for unit in ("uT", "G", "mG", "nT", "T", "mT"):
        if low / _SENSOR_TOLERANCE <= radius * UT_PER[unit] <= high * _SENSOR_TOLERANCE:
            return unit
    return COUNTS
