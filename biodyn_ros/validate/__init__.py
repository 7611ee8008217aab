"""`biodyn validate`: the forward prediction of an event that was not fitted to."""
