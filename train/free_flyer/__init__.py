"""What free-flyers bring to runs: estimates of the expert, pictures of plans and flights."""

RECORD = "train.free_flyer.flight_record:FlightRecord"
FIGURES = "train.free_flyer.estimates:compute_figures"
PICTURE = "train.free_flyer.flight_picture:save_flight_picture"
PLAN_PICTURE = "train.free_flyer.plan_picture:save_plan_picture"
