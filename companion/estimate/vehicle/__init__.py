"""The vehicle's state: the 31-state EKF and its monitors."""
