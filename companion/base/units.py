"""The units that names end in, for tables, schemas and plots."""

from typing import Final

# longest first: a name ends in its unit
_UNITS: Final = {
    "rad_s2_rthz": "rad/s²/√Hz",
    "m_s4_rthz": "m/s⁴/√Hz",
    "m_s2_rthz": "m/s²/√Hz",
    "m_s3_rthz": "m/s³/√Hz",
    "rad_s_rts": "rad/s/√s",
    "m_s2_rts": "m/s²/√s",
    "ut_rts": "µT/√s",
    "n_m_s2": "N·m·s²",
    "rad_s2": "rad/s²",
    "n_s2": "N·s²",
    "kg_m2": "kg·m²",
    "mrad": "mrad",
    "deg_s": "°/s",
    "rad_s": "rad/s",
    "m_s2": "m/s²",
    "m_s3": "m/s³",
    "m_s": "m/s",
    "1_s2": "1/s²",
    "1_s3": "1/s³",
    "1_s": "1/s",
    "grey": "grey values",
    "deg": "°",
    "rad": "rad",
    "lux": "lx",
    "kg": "kg",
    "hz": "Hz",
    "px": "px",
    "mb": "MB",
    "m2": "m²",
    "ut": "µT",
    "c": "°C",
    "g": "g",
    "m": "m",
    "s": "s",
}


def without_unit(name: str) -> tuple[str, str]:
    """A name's words, and its unit ("" for none): touchdown_m_s is "touchdown" in m/s."""
    suffix = next((suffix for suffix in _UNITS if name.endswith(f"_{suffix}")), "")
    return name.removesuffix(f"_{suffix}").replace("_", " "), _UNITS.get(suffix, "")
