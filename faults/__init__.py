"""The fault bench: for each fault the diagnostic message, the recovery time and the lost data."""
