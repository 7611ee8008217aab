"""`biodyn validate`: forward prediction of an event that was not used for the fit."""
