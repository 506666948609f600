"""Driving on an estimate to way-points, without a plan.

navigation > control, groping    the thesis' control law on a real robot's axes; driving without an estimate
obstruction                      whether it gets anywhere; steadying, pace: what a live robot takes besides
"""
