"""Learned policies: bounded corrections to an expert, and their checkpoints."""

from agents.residual import CorrectableExpert, ResidualEnv, ResidualPolicy
from agents.residual_vector import ResidualVectorEnv

__all__ = ["CorrectableExpert", "ResidualEnv", "ResidualPolicy", "ResidualVectorEnv"]
