"""ROS 2 node of boxgrasp."""
