"""The MPU9250 and its AK8963: registers to SI units."""
