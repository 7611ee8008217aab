"""Reads sensors, stamps and recordings from a bag, for identification, tracing and replay; no ROS."""
