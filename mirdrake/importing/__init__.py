"""Importers of vehicles and worlds of ROS and Gazebo, over one XML reader, one SDF layer and one mesh reader."""
