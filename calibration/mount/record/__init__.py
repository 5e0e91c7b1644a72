"""IMU samples and pad observations: live, from a log, from a table."""
