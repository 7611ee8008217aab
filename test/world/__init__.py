"""A world that is not ours: people, vehicles and sensors written from the paper and from physics, without biodyn."""
