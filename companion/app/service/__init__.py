"""The app as a service: orders, its state for who asks, the latch, systemd."""
