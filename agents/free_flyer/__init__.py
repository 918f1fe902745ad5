"""Free-flyers: from decision to decision of many worlds in one compiled call."""

DECISIONS = "agents.free_flyer.decisions:FreeFlyerDecisions"
