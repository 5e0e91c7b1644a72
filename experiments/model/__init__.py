"""The paper's 12-state quadrotor, its MPC and PID."""
