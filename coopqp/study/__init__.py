"""What is asked of runs: why one was blocked, how many fare, what a robot's hands really hold."""
