"""Simulated drives: traffic, a sensor, a detector's faults, and the log they would have left."""
