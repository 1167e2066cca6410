"""What is asked of runs: why a tick was blocked, random trials, what a grasp allows."""
