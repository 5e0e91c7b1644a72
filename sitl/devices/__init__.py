"""The sensors' digital interfaces: registers on a bus, bytes on a serial line."""
