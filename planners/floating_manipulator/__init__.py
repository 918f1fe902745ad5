"""The floating manipulator: output- and state-dependent Riccati control, safety pause, recovery by thrusters."""

EXPERT = "planners.floating_manipulator.expert:make_floating_manipulator_expert"
VARIANTS = ("published", "printed", "measured_base")
