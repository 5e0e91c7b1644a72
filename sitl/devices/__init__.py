"""The sensors as the onboard computer meets them: registers on a bus, bytes on a serial line."""
