"""The population: derived from published groups of people, and compared with them."""
