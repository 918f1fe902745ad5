"""Floating manipulators: from decision to decision of many worlds in one compiled call."""

LOOP = "agents.floating_manipulator.decision_loop:FloatingManipulatorLoop"
ITERATION_EPISODES = 128  # that a policy is improved from
TRAINING_CORRECTIONS = 60_000  # that a training run answers
