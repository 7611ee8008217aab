"""From recordings to a subject: two-phase fits per case, fused into one subject, with what is known of every number."""
