"""ROS 2 nodes, bags and the command line of biodyn, around `biodyn_core`."""

__version__ = "0.1.0"
