"""The pad's state relative to the vehicle: the Kalman filter of relative motion."""
