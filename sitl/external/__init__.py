"""The world around an external vehicle (a real SITL), in real time."""
