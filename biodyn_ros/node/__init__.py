"""The parts of the live node: subscriptions, publications, health, stored exposure, snapshots."""
