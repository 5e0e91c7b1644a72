"""The application: wires the stages to the hardware."""
