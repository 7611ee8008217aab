"""`biodyn fit` and `biodyn compare`: bags to a subject, one or a campaign of many."""
