"""Robots as ROS topics, without ROS on this machine: rosbridge v2 (JSON over a websocket), and ROS 2 by DDS."""
