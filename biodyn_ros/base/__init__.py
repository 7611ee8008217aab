"""What every part of the node package uses: files, topics, wording, the environment of ROS."""
