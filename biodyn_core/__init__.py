"""The mathematics of biodyn: arrays and floats in, arrays and frozen results out; never ROS, bags, plots or network."""
