"""Robots as ROS topics for programs that speak rosbridge v2: JSON over a websocket, without ROS on this machine."""
