"""How the vehicle answers setpoints: model, identification, margins."""
