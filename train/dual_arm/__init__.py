"""What two arms bring to runs: metrics of a grasp, its picture, and the links of replays."""

RECORD = "train.dual_arm.grasp_picture:GraspRecord"
PICTURE = "train.dual_arm.grasp_picture:save_grasp_picture"
METRICS = "train.dual_arm.grasp_metrics:METRICS"
LINKS = "train.dual_arm.grasp_replay:describe_links"
UNITS = {"effort": "N m s", "robustness": ""}  # that is the least of lengths, torques and times
