"""Free-flyers: plans by mixed-integer programming, their execution by replanning and tracking."""

# By objective.
PLANNERS = {
    "robustness": "planners.free_flyer.nominal.planner:make_free_flyer_plan",
    "impact_uncertainty": "planners.free_flyer.robust.planner:make_impact_robust_plan",
}
EXPERT = "planners.free_flyer.expert:FreeFlyerExpert"
EXPERT_BATCH = "planners.free_flyer.expert_batch:FreeFlyerExpertBatch"
ORACLE = "planners.free_flyer.oracle:FreeFlyerOracle"
ORACLE_BATCH = "planners.free_flyer.oracle:FreeFlyerOracleBatch"
OPTIONS = "planners.free_flyer.belief.options:get_options"
VARIANTS = "planners.free_flyer.belief.options:VARIANTS"
CERTIFICATE = "planners.free_flyer.certificate.certificate:certify_plan"
CHECK_PLAN = "planners.free_flyer.expert:check_plan"
# What the options' kinds and limits do not say.
CHECK_OPTIONS = "planners.free_flyer.expert:check_options"
# How many of the first features are the one-hot number of the impact in the plan.
IMPACT_NUMBERS = "planners.free_flyer.closed_loop.features:ONE_HOT"
# What the expert counts and does on purpose: all else is a fallback.
ROUTINE = "planners.free_flyer.expert:ROUTINE"
