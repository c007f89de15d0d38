"""Tracks held against labels, through TrackEval."""
