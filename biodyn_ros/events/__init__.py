"""`biodyn events`: finds the events of recorded sessions, as a file, text and a page."""
