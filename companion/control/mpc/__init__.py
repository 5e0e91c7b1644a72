"""The constrained MPC."""
