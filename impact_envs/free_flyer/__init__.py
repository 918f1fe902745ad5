"""Free-flyers that move passive objects by impacts (Verhagen & Tumova)."""

SCHEMA = "impact_envs.free_flyer.schema:FreeFlyerScenario"
MODEL = "impact_envs.free_flyer.disc_model:make_model"
TASK = "impact_envs.free_flyer.task:FreeFlyerTask"
BATCH = "impact_envs.free_flyer.batch:make_batch"
# A body's signals to their rates of change: how it flies on by itself, for reward "progress".
RATES = {"x": "vx", "y": "vy", "heading": "omega"}
JOIN = "impact_envs.free_flyer.observation:join_observations"
