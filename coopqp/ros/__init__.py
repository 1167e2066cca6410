"""The online loop as a ROS 2 node: ``bridge.py`` without ROS, ``node.py`` with rclpy."""
