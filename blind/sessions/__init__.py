"""The study of sessions: planted events that are found, and fits from found events beside those by hand."""
