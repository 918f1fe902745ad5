"""What free-flyers bring to runs: pictures of plans and flights."""

RECORD = "train.free_flyer.flight_record:FlightRecord"
PICTURE = "train.free_flyer.flight_picture:save_flight_picture"
PLAN_PICTURE = "train.free_flyer.plan_picture:save_plan_picture"
