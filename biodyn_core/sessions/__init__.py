"""Sessions: long recordings; their rests, shocks, trains of shocks, steady stretches and faults become events."""
