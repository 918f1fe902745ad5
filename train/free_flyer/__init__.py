"""What free-flyers bring to runs: pictures, the expert's estimates, and how well a flight kept its plan."""

RECORD = "train.free_flyer.flight_record:FlightRecord"
FIGURES = "train.free_flyer.estimates:compute_figures"
PICTURE = "train.free_flyer.flight_picture:save_flight_picture"
PLAN_PICTURE = "train.free_flyer.plan_picture:save_plan_picture"
METRICS = "train.free_flyer.plan_metrics:METRICS"
PINNED = "train.free_flyer.pinned_worlds:PinnedScenario"
