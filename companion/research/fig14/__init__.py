"""The paper's figure 14: MPC, Riccati recursion and PID under disturbances."""
