"""The floating manipulator: output- and state-dependent Riccati control, safety pause, recovery by thrusters."""
