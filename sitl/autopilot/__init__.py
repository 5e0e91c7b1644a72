"""The simulator's flight controller: the profile of PX4 or ArduPilot around one control cascade."""
