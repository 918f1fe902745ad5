"""Expert of the dual-arm domain: time-invariant reference spreading."""

EXPERT = "planners.dual_arm.expert:make_dual_arm_expert"
VARIANTS = ("published", "no_impact_map", "no_interim_phase", "no_synchronisation")
