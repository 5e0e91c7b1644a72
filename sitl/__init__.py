"""The bundled simulator: a quadrotor with camera and sensors, a moving pad, and MAVLink."""
