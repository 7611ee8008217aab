"""`biodyn info`: what a bag holds."""
