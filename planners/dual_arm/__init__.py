"""Expert of the dual-arm domain: time-invariant reference spreading."""

EXPERT = "planners.dual_arm.expert:DualArmExpert"
EXPERT_BATCH = "planners.dual_arm.expert_batch:DualArmExpertBatch"
OPTIONS = "planners.dual_arm.options:get_options"
VARIANTS = "planners.dual_arm.options:VARIANTS"
