"""Two arms and a box: from decision to decision of many worlds in one compiled call."""

LOOP = "agents.dual_arm.decision_loop:DualArmLoop"
ITERATION_EPISODES = 128  # that a policy is improved from
TRAINING_CORRECTIONS = 60_000  # that a training run answers
