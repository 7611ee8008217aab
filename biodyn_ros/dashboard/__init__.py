"""The live page: another process than the node's, which hears what anybody may hear, so that no visitor slows a ride.

settings: where it is served; child: started and ended with the node; feed: from ROS and back; hub: what newcomers and
streams are sent; door: who may come in; site: what is served.
"""
