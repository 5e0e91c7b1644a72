"""Baselines for the MPC: a PID and the paper's Riccati recursion."""
