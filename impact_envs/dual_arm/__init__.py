"""Two arms that grasp a box by hitting it from both sides at once (van Steen, Coşgun, van de Wouw & Saccon)."""

SCHEMA = "impact_envs.dual_arm.schema:DualArmScenario"
MODEL = "impact_envs.dual_arm.model:DualArmModel"
TASK = "impact_envs.dual_arm.task:DualArmTask"
BATCH = "impact_envs.dual_arm.batch:make_batch"
SHOWN_AROUND = 0.2  # elbows reach 0.11 m below the world [m]
JOIN = "impact_envs.dual_arm.observation:join_observations"
