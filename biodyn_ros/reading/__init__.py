"""From a bag to what identification, tracing and replay read: sensors, stamps, recordings; no ROS."""
