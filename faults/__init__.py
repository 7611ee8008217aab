"""The fault bench: what is injected, what is detected, how long recovery takes, what is lost; a row for each fault."""
