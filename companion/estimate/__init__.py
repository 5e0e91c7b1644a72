"""Estimate: samples to the vehicle's state (31-state EKF) and the pad's (relative-motion Kalman filter)."""
