"""A floating manipulator whose tip hits a floating box (Nekoo, Sharf & Ollero)."""

SCHEMA = "impact_envs.floating_manipulator.schema:FloatingManipulatorScenario"
MODEL = "impact_envs.floating_manipulator.model:FloatingManipulatorModel"
TASK = "impact_envs.floating_manipulator.task:FloatingManipulatorTask"
BATCH = "impact_envs.floating_manipulator.batch:make_batch"
SHOWN_AROUND = 0.5  # arms drift out of the world, slowly [m]
GROUPS = {"arm": ("arm",), "base": ("base",)}  # each is driven by something else, so they share no policy
