"""The borders of biodyn: ROS 2 nodes, bags and the command line around `biodyn_core`."""

__version__ = "0.1.0"
