"""Two arms that grasp a box by hitting it from both sides at once (van Steen, Coşgun, van de Wouw & Saccon)."""

SCHEMA = "impact_envs.dual_arm.schema:DualArmScenario"
MODEL = "impact_envs.dual_arm.model:DualArmModel"
TASK = "impact_envs.dual_arm.task:DualArmTask"
BATCH = "impact_envs.dual_arm.batch:make_batch"
JOIN = "impact_envs.dual_arm.observation:join_observations"
