"""What the floating manipulator brings to runs: the paper's figures of an episode, and its picture."""

RECORD = "train.floating_manipulator.motion_record:ManipulatorRecord"
FIGURES = "train.floating_manipulator.motion_record:compute_figures"
PICTURE = "train.floating_manipulator.motion_picture:save_manipulator_picture"
UNITS = {
    "impact_time": "s",
    "impact_point": "m",
    "impulse": "N s",
    "angular_impulse": "N m s",
    "object_velocity": "m/s, m/s, rad/s",
    "base_velocity_after": "m/s, m/s, rad/s",
    "joint_velocity_after": "rad/s",
    "base_travel": "m",
    "box_travel": "m",
    "start_error": "m",
    "min_error": "m",
    "min_error_after_pause": "m",
    "final_error": "m",
}
_DRIFTS = "published outcome: the impact sets the free-floating base moving and nothing stops it, so that the arm"
OUTCOMES = {
    "floating_manipulator": f"{_DRIFTS} loses its goal again; floating_manipulator_thrusters stops it",
    "floating_manipulator_passive": f"{_DRIFTS}, which is not driven any more, drifts off with it",
}
