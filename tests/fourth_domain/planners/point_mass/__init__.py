"""Expert of the point mass."""

EXPERT = "planners.point_mass.expert:PointMassExpert"
