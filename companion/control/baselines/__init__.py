"""What the MPC is compared with: PID and the paper's Riccati recursion."""
