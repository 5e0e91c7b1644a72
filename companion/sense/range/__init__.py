"""Ultrasonic rangefinders: echoes to distances."""
