"""Tracks written in other programs' formats."""
