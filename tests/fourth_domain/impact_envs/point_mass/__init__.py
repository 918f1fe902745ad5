"""A point mass that is pushed about in a box with hard walls."""

SCHEMA = "impact_envs.point_mass.schema:PointMassScenario"
MODEL = "impact_envs.point_mass.model:PointMassModel"
TASK = "impact_envs.point_mass.task:PointMassTask"
