"""The blind study of tracing: what the world hides, and what the tracer says of it before anybody looks it up."""
