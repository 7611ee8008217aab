"""`biodyn info`: the content of a bag."""
