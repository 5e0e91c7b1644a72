"""The vehicle's state: the 31-state EKF and what watches over it."""
