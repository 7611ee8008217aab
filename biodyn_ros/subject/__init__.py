"""`biodyn subject`: from recorded sessions to a fitted, validated and traced subject, step by step."""
