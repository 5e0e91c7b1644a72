"""The state machine: its table, requests and failsafes."""
