"""Learned policies: bounded corrections to an expert, and their checkpoints."""

from agents.residual import CorrectableExpert, ResidualEnv, ResidualPolicy

__all__ = ["CorrectableExpert", "ResidualEnv", "ResidualPolicy"]
