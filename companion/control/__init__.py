"""Control: the reference to a setpoint, by a constrained MPC and a last gate of limits."""
