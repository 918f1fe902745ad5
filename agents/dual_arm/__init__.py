"""Dual arm: from decision to decision of many worlds in one compiled call."""

DECISIONS = "agents.dual_arm.decisions:DualArmDecisions"
