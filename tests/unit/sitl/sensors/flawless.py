"""Sensors without errors."""

from sitl.sensors.sensors import GpsErrors, MagErrors, RangeErrors

NO_MAG_ERRORS = MagErrors(0.0, 0.0, 0.0, 0.0)
NO_GPS_ERRORS = GpsErrors(0.0, 0.0, 60.0, 0.0, 0.0, 0.0)
NO_RANGE_ERRORS = RangeErrors(0.0, 0.0, 0.0, 0.0)
