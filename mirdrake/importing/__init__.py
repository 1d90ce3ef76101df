"""Convert vehicles and worlds of ROS, Gazebo and OpenDRIVE into mirdrake's own folders and files."""
