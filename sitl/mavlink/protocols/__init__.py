"""MAVLink services with a protocol of their own: missions, parameters, logs and files. Sans I/O."""
