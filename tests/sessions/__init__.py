"""Random sessions of the loop for robots, each with one fault of the robot or with none."""
