"""Shared by every part of this package: files, topics, wording, the environment of ROS."""
