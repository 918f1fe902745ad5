"""The impact law of two discs as the planner uses it: velocities after from velocities before."""

from impact_envs.physics.impact import compute_mass_fractions, compute_velocity_gain

__all__ = ["compute_mass_fractions", "compute_velocity_gain"]
