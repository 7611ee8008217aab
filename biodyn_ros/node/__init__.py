"""The parts of the live node: its ears, its voice, its health, and what it keeps."""
