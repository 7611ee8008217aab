"""`biodyn trace`: bags to the effect that a subject's model lacks."""
