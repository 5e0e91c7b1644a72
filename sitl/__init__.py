"""The bundled simulator: a quadrotor with camera, sensors and a moving pad that speaks MAVLink."""
