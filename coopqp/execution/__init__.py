"""Running a scenario: phases, rollouts, one controller, all of them side by side."""
