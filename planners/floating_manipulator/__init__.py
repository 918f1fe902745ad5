"""Expert of the floating manipulator: output- and state-dependent Riccati control, safety pause, thruster recovery."""

EXPERT = "planners.floating_manipulator.expert:FloatingManipulatorExpert"
EXPERT_BATCH = "planners.floating_manipulator.expert_batch:FloatingManipulatorExpertBatch"
OPTIONS = "planners.floating_manipulator.options:get_options"
VARIANTS = "planners.floating_manipulator.options:VARIANTS"
