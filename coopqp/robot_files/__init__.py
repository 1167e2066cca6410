"""From a file or a table to a :class:`coopqp.robot.RobotModel`."""
