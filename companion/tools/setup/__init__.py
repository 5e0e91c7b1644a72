"""`companion setup`: switches on, on a Raspberry Pi, what the wiring needs."""
