"""The loop as a node of ROS 2: messages in, messages out.

``bridge.py`` is all of it but ROS: it takes messages as any library has them that uses ROS's own
names, and gives plain values. ``node.py`` is the node, with rclpy.
"""
