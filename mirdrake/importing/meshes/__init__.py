"""Mesh files of ROS and Gazebo packages: reading, writing as glTF, and convex parts for collision."""
