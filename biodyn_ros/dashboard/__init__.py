"""The live page: a process of its own that subscribes to the node's topics, so that clients do not slow the node.

settings: address and token; child: start and end with the node; feed: ROS subscription and services; hub: events for
clients; connection_limiter: checks of connections; site: HTTP server.
"""
