"""Free-flyers: from decision to decision of many worlds in one compiled call."""

LOOP = "agents.free_flyer.decision_loop:FreeFlyerLoop"
ITERATION_EPISODES = 512  # that a policy is improved from
TRAINING_CORRECTIONS = 120_000  # that a training run answers
