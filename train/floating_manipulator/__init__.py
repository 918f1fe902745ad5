"""What the floating manipulator brings to runs: the paper's figures of an episode, and its picture."""

RECORD = "train.floating_manipulator.motion_record:ManipulatorRecord"
FIGURES = "train.floating_manipulator.motion_record:compute_figures"
PICTURE = "train.floating_manipulator.motion_picture:save_manipulator_picture"
