"""The vehicle's response to setpoints: model, identification, margins."""
