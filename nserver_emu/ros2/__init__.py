"""Robots as ROS 2 topics by DDS, without ROS on this machine."""
